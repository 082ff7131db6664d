"""One network for all satellites, for torch: `contestants.channelwise` with gradients."""

from __future__ import annotations

from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from kfenv.envs.core import Core

from ..contestants.channelwise import ChannelwiseNetwork, Places, sharing, siblings
from ..contestants.policy import NumpyPolicy
from .networks import RecurrentNetwork


class SharedNetwork(torch.nn.Module):
    """Applies one network to every set of siblings.

    Args:
        each: for d features and k knobs.
        inputs, outputs: as of `ChannelwiseNetwork`, (S, d) and (S, k).
    """

    def __init__(self, each: RecurrentNetwork, inputs: Places, outputs: Places) -> None:
        super().__init__()
        self.each, self._inputs, self._outputs = each, inputs, outputs
        self._sets, knobs = len(inputs), 1 + int(outputs.max())
        self._seen = torch.from_numpy(inputs.ravel())
        self._sharing = torch.from_numpy(sharing(outputs, knobs))
        self.memory_size = self._sets * each.memory_size

    @property
    def log_low(self) -> Tensor:
        """(K,) the least log factors."""
        return self.each.log_low.repeat(self._sets) @ self._sharing

    @property
    def log_high(self) -> Tensor:
        """(K,) the greatest log factors."""
        return self.each.log_high.repeat(self._sets) @ self._sharing

    def start(self, batch: int) -> Tensor:
        """The memory (B, S H) of episodes that begin."""
        return self.each.start(batch * self._sets).view(batch, -1)

    def standardise(self, seen: NDArray[np.float32], least: float) -> None:
        """As of `RecurrentNetwork`, over all sets of siblings."""
        self.each.standardise(seen[:, self._inputs].reshape(-1, self._inputs.shape[1]), least)

    def forward(self, observations: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Log factors (T, B, K) and the memory after them for observations (T, B, D)."""
        steps, batch = observations.shape[:2]
        seen = observations.index_select(2, self._seen).view(steps, batch * self._sets, -1)
        logs, state = self.each(seen, state.reshape(batch * self._sets, -1))
        return logs.reshape(steps, batch, -1) @ self._sharing, state.reshape(batch, -1)

    def arrays(self) -> dict[str, NDArray | str]:
        """For `write_policy`."""
        places = {"inputs": self._inputs, "outputs": self._outputs}
        return self.each.arrays() | {"kind": ChannelwiseNetwork.kind} | places

    @classmethod
    def from_network(cls, source: ChannelwiseNetwork) -> Self:
        """The network of a policy."""
        return cls(RecurrentNetwork.from_network(source.each), source.inputs, source.outputs)


Network = RecurrentNetwork | SharedNetwork


def new_network(core: Core, bounds: NDArray[np.float64], units: int, memory: bool) -> Network:
    """An untrained network for what a core shows and takes: shared where channels have knobs.

    Args:
        bounds: (K, 2) of the log factors.
        units: in each layer.
        memory: whether there is a recurrent unit.
    """
    features, knobs = core.feature_names(), [knob.name for knob in core.knobs]
    found = siblings(features, knobs, core.scenario.sensor)
    size = len(features) if found is None else found[0].shape[1]
    chosen = slice(None) if found is None else found[1][0]
    each = RecurrentNetwork(np.zeros(size), np.ones(size), *bounds[chosen].T, units, memory)
    return each if found is None else SharedNetwork(each, *found)


def trainable(policy: NumpyPolicy) -> Network:
    """The network of a policy, with gradients.

    Raises:
        ValueError: if it does not set log factors.
    """
    if isinstance(policy.network, ChannelwiseNetwork):
        return SharedNetwork.from_network(policy.network)
    return RecurrentNetwork.from_policy(policy)
