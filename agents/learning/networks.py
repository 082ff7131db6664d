"""The networks that are taught, for torch: `contestants.networks.FactorNetwork` with gradients."""

from __future__ import annotations

from dataclasses import fields
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..contestants.networks import MEMORYLESS, MOST_DEVIATIONS, RECURRENT, FactorNetwork, Gru
from ..contestants.policy import NumpyPolicy

LEAK = 0.01  # share of the gradient that is left beyond the bounds


class RecurrentNetwork(torch.nn.Module):
    """From sequences of raw observations to the logarithms of the knobs' factors.

    The arithmetic and its order are those of `FactorNetwork`. The mean and deviation of the
    features and the bounds of the log factors are buffers, not trained.

    Args:
        mean, deviation: (D,) of the features, positive deviations.
        log_low, log_high: (K,) bounds of the log factors.
        hidden: H units in each layer.
        memory: whether there is a recurrent unit.
    """

    def __init__(
        self,
        mean: ArrayLike,
        deviation: ArrayLike,
        log_low: ArrayLike,
        log_high: ArrayLike,
        hidden: int = 96,
        memory: bool = True,
    ) -> None:
        super().__init__()
        buffers = {"mean": mean, "deviation": deviation, "log_low": log_low, "log_high": log_high}
        for name, value in buffers.items():
            self.register_buffer(name, torch.tensor(np.array(value, np.float32)))
        features, knobs = len(self.mean), len(self.log_low)
        self.memory_size = hidden if memory else 0
        self.input = torch.nn.Linear(features, hidden)
        self.gru = torch.nn.GRU(hidden, hidden) if memory else None
        self.middle = torch.nn.Linear(hidden + self.memory_size, hidden)
        self.head = torch.nn.Linear(hidden, knobs)

    def start(self, batch: int) -> Tensor:
        """The memory (B, H) of episodes that begin; (B, 0) without any."""
        return torch.zeros(batch, self.memory_size, device=self.mean.device)

    def forward(self, observations: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Log factors (T, B, K) and the memory after them (B, H) for observations (T, B, D)."""
        z = (observations - self.mean) / self.deviation
        x = torch.tanh(self.input(z.clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)))
        if self.gru is not None:
            remembered, last = self.gru(x, state[None])
            x, state = torch.cat((remembered, x), dim=-1), last[0]
        x = self.head(torch.tanh(self.middle(x)))
        return _leaky_clamp(x, self.log_low, self.log_high), state

    def standardise(self, seen: NDArray[np.float32], least: float) -> None:
        """Set mean and deviation of each feature to those of observations (N, D).

        Args:
            least: deviation, so that a feature that never moved is not blown up.
        """
        self.mean.copy_(torch.from_numpy(seen.mean(axis=0)))
        self.deviation.copy_(torch.from_numpy(np.maximum(seen.std(axis=0), least)))

    @torch.no_grad()
    def set_head(self, index: int, weight: float, bias: float) -> None:
        """Set all weights of one output, and its bias."""
        self.head.weight[index] = weight
        self.head.bias[index] = bias

    def arrays(self) -> dict[str, NDArray[np.float32] | str]:
        """For `write_policy`."""
        layers = {"in": self.input, "mid": self.middle, "out": self.head}
        tensors = dict(self.named_buffers())
        for name, layer in layers.items():
            tensors |= {f"weight_{name}": layer.weight.t(), f"bias_{name}": layer.bias}
        if self.gru is not None:
            tensors |= {i.name: getattr(self.gru, f"{i.name}_l0").t() for i in fields(Gru)}
        kind = MEMORYLESS if self.gru is None else RECURRENT
        return {"kind": kind} | {
            name: np.ascontiguousarray(tensor.detach().cpu().numpy())
            for name, tensor in tensors.items()
        }

    @classmethod
    def from_policy(cls, policy: NumpyPolicy) -> Self:
        """The network of a policy.

        Raises:
            ValueError: if it is none of this kind.
        """
        if not isinstance(policy.network, FactorNetwork):
            raise ValueError(
                f"a network of kind {policy.network.kind!r} is not the one to start from here"
            )
        return cls.from_network(policy.network)

    @classmethod
    def from_network(cls, source: FactorNetwork) -> Self:
        """The same network with gradients."""
        bounds = (source.mean, source.deviation, source.log_low, source.log_high)
        network = cls(*bounds, hidden=source.bias_in.size, memory=source.gru is not None)
        with torch.no_grad():
            for name, layer in (
                ("in", network.input), ("mid", network.middle), ("out", network.head)
            ):  # fmt: skip
                layer.weight.copy_(torch.tensor(getattr(source, f"weight_{name}").T))
                layer.bias.copy_(torch.tensor(getattr(source, f"bias_{name}")))
            if source.gru is not None:
                for name, array in vars(source.gru).items():
                    getattr(network.gru, f"{name}_l0").copy_(torch.tensor(array.T))
        return network


def _leaky_clamp(x: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The clamped values exactly, with a small gradient where they are clamped."""
    clamped = torch.minimum(torch.maximum(x, low), high)
    beyond = LEAK * (x - clamped)
    return clamped + (beyond - beyond.detach())
