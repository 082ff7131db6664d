"""A real log of a GNSS receiver, cut into windows that are Recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.models.gnss.receiver import RATE_NOISE, range_deviation
from kfenv.models.kinematics import POSITION
from kfenv.scenarios.recording import Recording, Whole
from kfenv.scenarios.windows import PARTS, no_room, withheld

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class GnssLog:
    """E epochs of a GNSS receiver, placed on N evenly spaced instants.

    Attributes:
        path: of the observation file.
        began: its first epoch by the receiver's clock, GPS seconds since 1980.
        step: between two instants, s; instants without an epoch have no measurement.
        row: (E,) the instant of each epoch, increasing from 0.
        measurement, noise: (E, 24) as `kfenv.models.gnss.pseudorange` expects them.
        sensor_inputs: (E, 72) likewise.
        start: epochs at which a window may begin, increasing.
        mean, factor: initial states (E, 11) and factors (E, 11, 11) there.
        truth: states (N, 11) at every instant, where nobody told them those of the fixes.
        known: (N,) whether the truth counts there.
        moving: whether the receiver moved.
        told: whether the truth was told; otherwise fixes that the filter misses stand for it.
        clock_jumps: milliseconds by which the receiver set its clock; they are taken out.
    """

    path: str
    began: float
    step: float
    row: Indices
    measurement: Array
    noise: Array
    sensor_inputs: Array
    start: Indices
    mean: Array
    factor: Array
    truth: Array
    known: NDArray[np.bool_]
    moving: bool
    told: bool
    clock_jumps: tuple[int, ...]

    @property
    def duration(self) -> float:
        """From the first epoch to the last, s."""
        return float(self.row[-1] * self.step)

    @property
    def steps_per_epoch(self) -> int:
        """Of how many steps all times between epochs are multiples."""
        return int(np.gcd.reduce(np.diff(self.row)))

    def time(self, duration: float) -> Array:
        """The instants of a window, s."""
        return np.arange(round(duration / self.step) + 1) * self.step

    def random_starts(self, rngs: Sequence[Generator], duration: float, part: str) -> Indices:
        """Draw from each generator at which epoch a window of that part begins."""
        possible = self._possible(duration, part)
        return np.array([possible[rng.integers(len(possible))] for rng in rngs], np.int64)

    def starts(self, duration: float, part: str) -> Indices:
        """The epochs at which that part's windows begin, as many as fit without overlap.

        Raises:
            ValueError: if not even two fit.
        """
        chosen: list[int] = []
        for epoch in self._possible(duration, part):
            if not chosen or self.row[epoch] > self.row[chosen[-1]] + round(duration / self.step):
                chosen.append(int(epoch))
        if len(chosen) < 2:
            raise no_room(self.path, self.duration, part, duration, "two windows")
        return np.array(chosen)

    def recording(self, starts: Indices, duration: float, missing: bool = True) -> Recording:
        """The windows that begin at the given epochs.

        The first instant's measurement is spent on the initial state. Where no truth was told
        fixes are withheld at the last of every six stretches, and the truth counts only there;
        not so unless any shall be missing.
        """
        time = self.time(duration)
        shape = (len(starts), len(time))
        measurement = np.full((*shape, 2 * CHANNELS), np.nan)
        noise = np.tile(idle_noise(), (*shape, 1))
        inputs = np.zeros((*shape, self.sensor_inputs.shape[1]))
        instants = self.row[starts][:, None] + np.arange(len(time))
        for episode, start in enumerate(starts):
            inside = slice(start, np.searchsorted(self.row, self.row[start] + len(time)))
            rows = self.row[inside] - self.row[start]
            measurement[episode, rows] = self.measurement[inside]
            noise[episode, rows] = self.noise[inside]
            inputs[episode, rows] = self.sensor_inputs[inside]
        scored = self.known[instants]
        if not self.told and missing:
            missed = self._withheld(time)
            measurement[:, missed] = np.nan
            scored &= missed
        measurement[:, 0] = np.nan
        return Recording(
            time, measurement, noise, self.mean[starts], self.factor[starts],
            np.empty((*shape, 0)), inputs, self.truth[instants],
            scored=None if scored.all() else scored,
        )  # fmt: skip

    def whole(self, after: float | None = None) -> Whole | None:
        """All epochs from the first after a time (s of `began`'s clock) that tells a state."""
        fixes, told = None, self.began + self.row[self.start] * self.step
        start = self.start[told > (-np.inf if after is None else after)][:1]
        if not len(start) or start[0] == len(self.row) - 1:
            return None
        row = self.row[start[0]]
        recording = self.recording(start, (self.row[-1] - row) * self.step, missing=False)
        if not self.told:
            known = self.known[row:, None]
            fixes = np.where(known, recording.truth[0][:, POSITION], np.nan)
            recording = replace(recording, truth=None, scored=None)
        return Whole(recording, self.began + row * self.step, fixes)

    def _withheld(self, time: Array) -> NDArray[np.bool_]:
        """Instants of a window at which the filter gets nothing, so that it can be judged."""
        return withheld(time, self.steps_per_epoch * self.step)

    def _possible(self, duration: float, part: str) -> Indices:
        """Epochs at which windows may begin that lie, with the epoch before, in a part.

        Raises:
            ValueError: if there is none.
        """
        low, high = (share * self.row[-1] for share in PARTS[part])
        last = self.row[self.start] + round(duration / self.step)
        # Beside a gap the last epoch of a part may come earlier
        inside = (self.row[self.start - 1] >= low) & (last <= high)
        if not inside.any():
            raise no_room(self.path, self.duration, part, duration, "a window")
        judged = self._judged(self.start[inside], self.time(duration))
        if not judged.any():
            raise ValueError(
                f"{self.path}: no window of {duration:g} s in the part for {part} has an instant "
                "whose truth is known; give a longer duration."
            )
        return self.start[inside][judged]

    def _judged(self, starts: Indices, time: Array) -> NDArray[np.bool_]:
        """Whether the truth counts at any instant of the windows that begin at these epochs."""
        counts = np.ones(len(time), bool) if self.told else self._withheld(time)
        judged = np.zeros(len(starts), bool)
        for offset in np.flatnonzero(counts):
            judged |= self.known[self.row[starts] + offset]
        return judged


def idle_noise() -> Array:
    """What a channel without a satellite is told (24,): no matter what."""
    return np.repeat((float(range_deviation(np.pi / 2.0)), RATE_NOISE), CHANNELS)
