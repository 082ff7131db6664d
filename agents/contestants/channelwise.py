"""One network for all satellites: each has a memory of its own, and all have the same numbers.

Channels that stand side by side in their groups (range and rate of a satellite) are siblings.
What a network learns of one set of siblings serves every other, so that it needs neither as many
units nor as many episodes as one that sees all channels at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import Knob
from kfenv.models.model import Sensor

from .networks import MEMORYLESS, RECURRENT, Array, FactorNetwork, actions_of

Places = NDArray[np.int64]


@dataclass(frozen=True)
class ChannelwiseNetwork:
    """A network that looks at each of S sets of siblings, beside what is common to all.

    A knob that several of them set (the fading of the whole filter) takes the mean of what they
    ask for.
    """

    kind: ClassVar[str] = "gru-by-channel"
    each: FactorNetwork  # for d features and k knobs
    inputs: Places  # (S, d) which features of the D it sees
    outputs: Places  # (S, k) which knobs of the K it sets
    knob_low: Array  # (K,) logarithms of the knobs' ends
    knob_high: Array

    def __post_init__(self) -> None:
        """Raise ValueError unless the parts fit each other."""
        for what, places, size in (
            ("inputs", self.inputs, self.each.observation_size),
            ("outputs", self.outputs, self.each.action_size),
        ):
            if places.ndim != 2 or places.shape[1] != size or len(places) < 2:
                raise ValueError(f"the {what} have the shape {places.shape}, not (S, {size})")
        if not np.array_equal(np.unique(self.inputs), np.arange(self.observation_size)):
            raise ValueError("some of its features are seen by nobody")
        if not np.array_equal(np.unique(self.outputs), np.arange(self.action_size)):
            raise ValueError("some of its knobs are set by nobody")

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], knobs: Sequence[Knob]) -> ChannelwiseNetwork:
        """Take the network out of a file's arrays."""
        inputs, outputs = (_places(arrays, name) for name in ("inputs", "outputs"))
        if not knobs or outputs.min() < 0 or outputs.max() >= len(knobs):
            raise ValueError("it sets knobs that it does not name")
        kind = {"kind": RECURRENT if "weight_ih" in arrays else MEMORYLESS}
        each = FactorNetwork.from_arrays(dict(arrays) | kind, [knobs[i] for i in outputs[0]])
        low, high = np.log([[knob.low, knob.high] for knob in knobs]).astype(np.float32).T
        return cls(each, inputs, outputs, low, high)

    @property
    def memory_size(self) -> int:
        """S H, or 0 without memory."""
        return len(self.inputs) * self.each.memory_size

    @property
    def observation_size(self) -> int:
        """D."""
        return 1 + int(self.inputs.max())

    @property
    def action_size(self) -> int:
        """K."""
        return len(self.knob_low)

    @property
    def parameters(self) -> tuple[NDArray[Any], ...]:
        """All that training chose, and where it belongs."""
        return (*self.each.parameters, self.inputs, self.outputs)

    def decide(self, observations: Array, memory: Array) -> tuple[Array, Array]:
        """Deterministic actions (B, K) and the next memory."""
        batch, sets = len(observations), len(self.inputs)
        seen = observations[:, self.inputs].reshape(batch * sets, -1)
        held = memory.reshape(batch * sets, self.each.memory_size)
        wanted, held = self.each.log_factors(seen, held)
        logs = wanted.reshape(batch, -1) @ sharing(self.outputs, self.action_size)
        return actions_of(logs, self.knob_low, self.knob_high), held.reshape(batch, -1)


def sharing(outputs: Places, knobs: int) -> Array:
    """The matrix (S k, K) that takes to each knob the mean of what is asked for it."""
    matrix = np.zeros((outputs.size, knobs), np.float32)
    matrix[np.arange(outputs.size), outputs.ravel()] = 1.0
    return matrix / matrix.sum(axis=0)


def siblings(
    features: Sequence[str], knobs: Sequence[str], sensor: Sensor
) -> tuple[Places, Places] | None:
    """Which features (S, d) each set of siblings sees, and which knobs (S, k) it sets.

    None where the knobs are not those of single channels, or the groups differ in size.

    Args:
        features, knobs: names, in their order.
        sensor: whose channels they are.
    """
    groups = [[c.name for c in sensor.channels if c.group == group] for group in sensor.groups]
    owner = {name: s for group in groups for s, name in enumerate(group)}
    sizes = {len(group) for group in groups}
    if len(sizes) > 1 or sizes == {1} or not owner.keys() <= set(knobs):
        return None

    def places(names: Sequence[str]) -> Places:
        whose = [next((owner[w] for w in name.split() if w in owner), None) for name in names]
        return np.array([
            [i for i, one in enumerate(whose) if one in (None, s)] for s in range(len(groups[0]))
        ])  # fmt: skip

    return places(features), places(knobs)


def _places(arrays: Mapping[str, Any], name: str) -> Places:
    given = np.asarray(arrays[name])
    if given.dtype.kind not in "iu" or given.ndim != 2 or not given.size or given.min() < 0:
        raise ValueError(f"{name} are not a table of places")
    return given.astype(np.int64)
