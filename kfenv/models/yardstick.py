"""What errors are measured of: some of the states, or what a sensor of them would tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Component, Motion, Sensor
from kfenv.models.namespaces import batch

Array = NDArray[np.float64]

TWO_PI = 2.0 * pi


@dataclass(frozen=True)
class Yardstick:
    """The d quantities whose error counts; the error is the root of their summed squares.

    Attributes:
        name: of them together, e.g. ``"position"``.
        components: their names and units, and which of them are angles.
        states: their places in the state; () where `sensor` tells them.
        rates: places of the states that are their rates of change, d of them or none.
        weights: (d,) by which differences are multiplied; () for ones.
        sensor: without inputs, whose channels are the quantities; None where they are states.
    """

    name: str
    components: tuple[Component, ...]
    states: tuple[int, ...] = ()
    rates: tuple[int, ...] = ()
    weights: tuple[float, ...] = ()
    sensor: Sensor | None = None

    @classmethod
    def position(cls, motion: Motion) -> Yardstick:
        """That of a target: the three components of its position, and its velocity."""
        states = tuple(motion.states[i] for i in motion.position)
        return cls("position", states, motion.position, motion.velocity)

    def __reduce__(self):
        return Yardstick, (
            self.name, self.components, self.states, self.rates, self.weights, self.sensor,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.components)

    @property
    def error_name(self) -> str:
        """Of the error among what an environment tells."""
        return f"{self.name}_error"

    @property
    def unit(self) -> str:
        """Of the error; with weights it is a pure number."""
        return "scales" if self.weights else self.components[0].unit

    @cached_property
    def weight(self) -> Array:
        """(d,) by which differences are multiplied."""
        return np.array(self.weights) if self.weights else np.ones(len(self))

    @cached_property
    def angles(self) -> NDArray[np.bool_]:
        """(d,) whose differences are wrapped."""
        return np.array([component.angle for component in self.components])

    def lines(self, size: int) -> NDArray[np.int64]:
        """Where `vector` and `matrix` have the quantities, see `lines_of`.

        Args:
            size: n, of the state.
        """
        if self.sensor is None:
            return lines_of(self.states, [place + 1 for place in self.states], self.angles)
        return lines_of(range(len(self)), [size] * len(self), self.angles)

    def vector(self, states: Array) -> Array:
        """What `lines` finds the quantities of states (B, n) in; for states no work."""
        if self.sensor is None:
            return states
        with np.errstate(all="ignore"):  # of filters that have failed
            return self.values(states)

    def matrix(self, mean: Array, factor: Array) -> Array:
        """What `lines` finds their rows of a factor (B, n, n) in; for states no work."""
        if self.sensor is None:
            return factor
        with np.errstate(all="ignore"):
            return np.ascontiguousarray(self.rows(mean, factor))

    def values(self, states: Array) -> Array:
        """The quantities (..., d) of states (..., n)."""
        if self.sensor is None:
            return states[..., list(self.states)]
        return _told(self._measure, states)

    def off(self, estimate: Array, truth: Array) -> Array:
        """Weighted differences (..., d) of estimates from truths, both (..., n)."""
        if self.sensor is None:
            difference = (estimate - truth)[..., list(self.states)]
        else:
            difference = self.values(estimate) - self.values(truth)
        return self._wrapped(difference) * self.weight

    def rows(self, mean: Array, factor: Array) -> Array:
        """Rows (..., d, n) of a factor of the quantities' covariance, without their weights.

        Of a function those of its statistical linearisation at a deviation each way.

        Args:
            mean: (..., n).
            factor: (..., n, n) of its covariance.
        """
        if self.sensor is None:
            return factor[..., list(self.states), :]
        columns = np.swapaxes(factor, -1, -2)
        high, low = (self.values(mean[..., None, :] + side * columns) for side in (1.0, -1.0))
        return 0.5 * np.swapaxes(self._wrapped(high - low), -1, -2)

    def _wrapped(self, difference: Array) -> Array:
        if self.angles.any():
            turns = np.floor(difference / TWO_PI + 0.5)
            difference = difference - np.where(self.angles, TWO_PI * turns, 0.0)
        return difference

    @cached_property
    def _measure(self):
        return self.sensor.build(batch)


def _told(measure: Callable, states: Array) -> Array:
    """What a sensor without inputs tells of states (..., n), as (..., d)."""
    shape = states.shape[:-1]
    components = measure(tuple(np.moveaxis(states, -1, 0)), ())
    return np.stack([np.broadcast_to(component, shape) for component in components], axis=-1)


def lines_of(
    places: Sequence[int], widths: Sequence[int], angles: Sequence[bool]
) -> NDArray[np.int64]:
    """A table (3, d): place of each quantity, how much of its factor's row counts, if an angle."""
    return np.array([list(places), list(widths), list(angles)], np.int64).reshape(3, -1)
