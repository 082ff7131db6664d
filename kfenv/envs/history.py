"""What a film has to show: the episode's recording and the filter's run so far."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.recording import FaultInterval, Recording

Array = NDArray[np.float64]

# Pale tints, for the shades behind the curves and the track.
FAULT_COLOURS = ("#F6CDB4", "#D5D9EE", "#F3E7A6", "#CDE8DD", "#EBD3E2")


class History:
    """What the film knows: the episode's recording and the filter's run so far.

    Attributes:
        time: (T,) the instants of the episode, s.
        truth, measured: true and measured positions (T, 3), or None.
            All positions are east, north and up (see the scenario's `local_frame`).
        guessed: whether the truth is only what withheld measurements suggest.
        lasting, passing: faults that last the whole episode and those that do not.
        colours: of the passing faults' labels.
        stride: filter steps from one measurement to the next.
        steps: the times of the updates so far.
        position, covariance, error, factors: of the updates so far.
        centre, spread: the latest estimate (3,) and covariance (3, 3), first the initial one.
    """

    def __init__(self, scenario: Any, recording: Recording, knobs: int) -> None:
        yardstick = scenario.yardstick
        self.stride = scenario.steps_per_measurement
        self.time = recording.times[0]
        start = yardstick.values(recording.mean[0])
        self._origin, self._rotation = scenario.local_frame(start)
        truth = recording.truth
        self.truth = None if truth is None else self._local(yardstick.values(truth[0]))
        self.guessed = recording.scored is not None
        self.measured = measured_positions(scenario.sensor, recording.measurement[0])
        first, last = self.time[0], self.time[-1]
        faults = merged(recording.faults[0])
        self.lasting = [fault for fault in faults if fault.start <= first and fault.stop >= last]
        self.passing = [fault for fault in faults if fault not in self.lasting]
        labels = sorted({fault.label for fault in self.passing})
        self.colours = dict(zip(labels, cycle(FAULT_COLOURS), strict=False))
        rows = self._rotation @ yardstick.rows(recording.mean[0], recording.factor[0])
        self.centre, self.spread = self._local(start), rows @ rows.T
        size = len(self.time)
        self._count = 0
        self._steps, self._error = np.empty((2, size))
        d = len(yardstick)
        self._position, self._covariance = np.empty((size, d)), np.empty((size, d, d))
        self._factors = np.empty((size, knobs))

    def _local(self, position: Array) -> Array:
        """Positions (..., 3) of the state's frame as east, north, up."""
        return (position - self._origin) @ self._rotation.T

    def append(
        self, time: float, position: Array, covariance: Array, error: float, factors: Array
    ) -> None:
        """Take in an update; position and covariance are in the state's frame."""
        i = self._count
        self._steps[i], self._error[i], self._factors[i] = time, error, factors
        self._position[i] = position = self._local(position)
        self._covariance[i] = self._rotation @ covariance @ self._rotation.T
        self._count += 1
        if np.all(np.isfinite(position)) and np.all(np.isfinite(covariance)):
            self.centre, self.spread = self._position[i], self._covariance[i]

    def __len__(self) -> int:
        return self._count

    steps = property(lambda self: self._steps[: self._count])
    position = property(lambda self: self._position[: self._count])
    covariance = property(lambda self: self._covariance[: self._count])
    error = property(lambda self: self._error[: self._count])
    factors = property(lambda self: self._factors[: self._count])

    @property
    def now(self) -> int:
        """Index of the latest update's instant."""
        return int(np.searchsorted(self.time, self.steps[-1])) if len(self) else 0

    @property
    def true_position(self) -> Array | None:
        """The truth (3,) at the latest update."""
        return None if self.truth is None else self.truth[self.now]

    @property
    def seen(self) -> Array:
        """Positions measured so far (k, 3), NaN where nothing arrived."""
        if self.measured is None or not len(self):
            return np.empty((0, 3))
        return self.measured[: self.now + 1]


def merged(faults: Sequence[FaultInterval]) -> tuple[FaultInterval, ...]:
    """The intervals in time order, overlapping ones of one label joined."""
    joined: list[FaultInterval] = []
    for fault in sorted(faults, key=lambda fault: (fault.label, fault.start)):
        last = joined[-1] if joined else None
        if last is not None and last.label == fault.label and fault.start <= last.stop:
            joined[-1] = FaultInterval(last.label, last.start, max(last.stop, fault.stop))
        else:
            joined.append(fault)
    return tuple(sorted(joined, key=lambda fault: fault.start))
