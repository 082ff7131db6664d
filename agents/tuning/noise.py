"""What static tuning may choose of Q and R: factors on what the filter is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from kfenv.envs.knobs import NOISE_RANGE, PROCESS_NOISE
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording

from ..contestants.optimised import initial_noise_factor

Array = NDArray[np.float64]

SHAPES = GROUPS, SOURCES, CHANNELS, FULL = "groups", "sources", "channels", "full"
MOST_COUPLING = 2.0  # of two states' process noise, their deviations being one


@dataclass(frozen=True)
class NoiseShape:
    """Parameters theta (p,) of Q and R, zero being the nominal filter.

    Q's lower factor becomes L times the model's, R's deviations r times the told ones. With
    ``"groups"`` L is sqrt(process_noise), times that of a group of states, and r one factor per
    channel group: the environment's knobs, as logarithms. ``"sources"`` has a process_noise for
    each set of states that share noise (an axis, a clock), ``"channels"`` an r for each channel
    besides; ``"full"`` a whole lower L besides (Greenberg et al. 2023), whose off-diagonals are
    no logarithms but relative to the states' deviations.

    Attributes:
        names: of the parameters.
        low, high: (p,) their bounds.
        logarithmic: (p,) whether it is the logarithm of a factor.
    """

    shape: str
    scenario: Any
    names: tuple[str, ...]
    low: Array
    high: Array
    logarithmic: NDArray[np.bool_]
    size: Array  # (n,) deviations of the model's process noise, for couplings

    @classmethod
    def of(cls, shape: str, scenario: Any, recording: Recording) -> NoiseShape:
        """Of a scenario's models.

        Raises:
            ValueError: for an unknown shape.
        """
        if shape not in SHAPES:
            raise ValueError(unknown("shape of the noise", shape, SHAPES))
        sensor, motion = scenario.sensor, scenario.motion
        own = initial_noise_factor(scenario, recording)[0]
        size = np.sqrt(np.sum(own**2, axis=1))
        process = np.log([PROCESS_NOISE.low, PROCESS_NOISE.high])
        rows = [(name, *process, True) for name in _process_names(shape, motion, size)]
        if shape == FULL:
            rows += [
                (f"{b.name} into {a.name}", -MOST_COUPLING, MOST_COUPLING, False)
                for i, a in enumerate(motion.states)
                for j, b in enumerate(motion.states[:i])
                if size[i] > 0.0 and size[j] > 0.0
            ]
        measured = (
            sensor.groups if shape in (GROUPS, SOURCES) else [c.name for c in sensor.channels]
        )
        rows += [(f"{name}_noise", *np.log(NOISE_RANGE), True) for name in measured]
        names, low, high, logarithmic = zip(*rows, strict=True)
        bounds = np.array(low), np.array(high)
        return cls(shape, scenario, names, *bounds, np.array(logarithmic), size)

    def factors(self, theta: Array) -> tuple[Array, Array]:
        """L (S, n, n) and r (S, m) of parameters (S, p)."""
        values = np.where(self.logarithmic, np.exp(theta), theta)
        told = {name: values[:, i] for i, name in enumerate(self.names)}
        states, sensor = self.scenario.motion.states, self.scenario.sensor
        sources = _sources(self.shape, self.scenario.motion)
        left = np.zeros((len(theta), len(states), len(states)))
        for i, state in enumerate(states):
            own = f"{sources[i]}_process_noise" if self.shape != GROUPS else "process_noise"
            variance = told.get(own, np.ones(len(theta)))
            left[:, i, i] = np.sqrt(variance * told.get(f"{state.group}_process_noise", 1.0))
        for i, a in enumerate(states):
            for j, b in enumerate(states[:i]):
                if f"{b.name} into {a.name}" in told:
                    ratio = self.size[i] / self.size[j]
                    left[:, i, j] = left[:, i, i] * told[f"{b.name} into {a.name}"] * ratio
        by_group = self.shape in (GROUPS, SOURCES)
        names = [c.group if by_group else c.name for c in sensor.channels]
        return left, np.stack([told[f"{name}_noise"] for name in names], axis=1)


def _process_names(shape: str, motion: Any, size: Array) -> list[str]:
    if shape == GROUPS:
        return ["process_noise", *(f"{group}_process_noise" for group in motion.groups)]
    sources = _sources(shape, motion)
    moved = dict.fromkeys(name for name, s in zip(sources, size, strict=True) if s > 0.0)
    return [f"{name}_process_noise" for name in moved]


def _sources(shape: str, motion: Any) -> list[str]:
    """For each state the first one that it shares process noise with; itself of a full matrix."""
    names = [state.name for state in motion.states]
    if shape == FULL:
        return names
    n = len(names)
    shared = np.zeros((2 * n, 2 * n))  # states, then columns of the factor
    for row, column in motion.noise_pattern:
        shared[row, n + column] = 1.0
    _, piece = connected_components(shared, directed=False)
    return [names[int(np.flatnonzero(piece[:n] == own)[0])] for own in piece[:n]]
