"""Real GPS logs as Recordings: a RINEX pair, cleared of all that is known, cut into windows.

A log's time is divided, in its order, into a part to train and tune on, one to validate
and one to test on, so that no agent is tested on what it was tuned on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT
from kfenv.models.gnss.pseudorange import BIAS, CHANNELS, DRIFT
from kfenv.models.gnss.receiver import RATE_NOISE, range_deviation
from kfenv.models.kinematics import ACCELERATION, POSITION, VELOCITY
from kfenv.scenarios.gnss.ephemeris import read_navigation
from kfenv.scenarios.gnss.fix import Fixes, Signals, View, clock_bias, fix, signals, view
from kfenv.scenarios.gnss.rinex import Observations, read_observations
from kfenv.scenarios.gnss.satellite_channels import assign_channels, by_channel
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Shares of the log's time; "tuning" is for training too
PARTS = {"tuning": (0.0, 0.3), "validation": (0.3, 0.5), "test": (0.5, 1.0)}

STATES = 11
MAX_STEP = 1.0  # s: the longest that the motion models take
OFF_GRID = 0.05  # of a step: how far an epoch may lie from the instant that stands for it
MILLISECOND = 1e-3 * SPEED_OF_LIGHT  # m: by multiples of this receivers set their clocks
JUMP_TOLERANCE = 0.05  # of a millisecond
MANOEUVRE = 3.0  # m/s^2: acceleration between two epochs, 1 sigma
CLOCK_DENSITY = 0.1  # (m/s)^2/s: of the clock's drift between two epochs
WRONG_POSITION = 25.0  # m: a mean fix is nearer to a header's position that is right


@dataclass(frozen=True, eq=False)
class GnssLog:
    """E epochs of a GPS receiver, placed on evenly spaced instants.

    Attributes:
        path: of the observation file.
        step: between two instants, s; instants without an epoch have no measurement.
        row: (E,) the instant of each epoch, increasing from 0.
        measurement, noise: (E, 24) as `kfenv.models.gnss.pseudorange` expects them.
        sensor_inputs: (E, 72) likewise.
        start: epochs at which a window may begin, increasing.
        mean, factor: initial states (E, 11) and factors (E, 11, 11) there.
        clock: (E,) bias of the receiver's clock with the position held, m.
        position: (3,) of a receiver that stood still, or None.
        clock_jumps: milliseconds by which the receiver set its clock; they are taken out.
    """

    path: str
    step: float
    row: Indices
    measurement: Array
    noise: Array
    sensor_inputs: Array
    start: Indices
    mean: Array
    factor: Array
    clock: Array
    position: Array | None
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
            raise self._too_short(duration, part, "two windows")
        return np.array(chosen)

    def recording(self, starts: Indices, duration: float) -> Recording:
        """The windows that begin at the given epochs.

        The first instant's measurement is spent on the initial state.
        """
        time = self.time(duration)
        shape = (len(starts), len(time))
        measurement = np.full((*shape, 2 * CHANNELS), np.nan)
        noise = np.tile(_idle_noise(), (*shape, 1))
        inputs = np.zeros((*shape, self.sensor_inputs.shape[1]))
        truth = None if self.position is None else np.zeros((*shape, STATES))
        for episode, start in enumerate(starts):
            inside = slice(start, np.searchsorted(self.row, self.row[start] + len(time)))
            rows = self.row[inside] - self.row[start]
            measurement[episode, rows] = self.measurement[inside]
            noise[episode, rows] = self.noise[inside]
            inputs[episode, rows] = self.sensor_inputs[inside]
            if truth is not None:
                truth[episode] = self._truth(self.row[start] + np.arange(len(time)))
        measurement[:, 0] = np.nan
        return Recording(
            time, measurement, noise, self.mean[starts], self.factor[starts],
            np.empty((*shape, 0)), inputs, truth,
        )  # fmt: skip

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
            raise self._too_short(duration, part, "a window")
        return self.start[inside]

    def _too_short(self, duration: float, part: str, what: str) -> ValueError:
        low, high = PARTS[part]
        return ValueError(
            f"{self.path}: the part for {part} ({100 * (high - low):.0f} % of {self.duration:g} s) "
            f"has no room for {what} of {duration:g} s; give a longer log or a shorter duration."
        )

    def _truth(self, rows: Indices) -> Array:
        truth = np.zeros((len(rows), STATES))
        truth[:, POSITION] = self.position
        truth[:, BIAS] = np.interp(rows, self.row, self.clock)
        truth[:, DRIFT] = np.gradient(truth[:, BIAS], self.step)
        return truth


def read_log(
    observations: str | PathLike[str], navigation: str | PathLike[str], static: bool = True
) -> GnssLog:
    """Read a RINEX 2 or 3 pair: GPS, one frequency.

    A static receiver's log goes to the environment as ``rinex=(OBS, NAV)``. For one that
    moved, ``log.recording(log.starts(duration, part), duration)`` is its ``recording``.

    Args:
        observations, navigation: paths of the files.
        static: whether the receiver stood still at the position in the observation file's
            header, which is then the truth; without it there is none.

    Raises:
        FileNotFoundError: if a file does not exist.
        ValueError: if a file cannot be used, the two do not belong together, epochs are
            too irregular, or a static receiver's header has no position or a wrong one.
    """
    observed = read_observations(observations)
    raw = signals(observed, read_navigation(navigation))
    fixes = fix(raw)
    _check_fixes(observed, fixes)
    position = _station(observed, fixes) if static else None
    place = _filled(observed.time, fixes.position) if position is None else position
    place = np.broadcast_to(place, (len(observed.time), 3))
    seen = view(raw, place)
    clock = _filled(observed.time, clock_bias(raw, place)[:, None])[:, 0]
    step, row = _grid(observed, clock)
    jumps = _clock_jumps(observed.time, clock)
    shift = jumps * MILLISECOND
    start, mean, factor = _initial_states(observed.time, fixes, shift)
    channel = assign_channels(np.isfinite(seen.pseudorange), seen.elevation)
    return GnssLog(
        path=str(observations),
        step=step,
        row=row,
        measurement=_measurement(raw, seen, channel, shift),
        noise=_noise(seen, channel),
        sensor_inputs=_inputs(seen, channel),
        start=start,
        mean=mean,
        factor=factor,
        clock=clock - shift,
        position=position,
        clock_jumps=tuple(int(jump) for jump in np.diff(jumps)[np.diff(jumps) != 0]),
    )


def log_of(pair: Sequence[str | PathLike[str]]) -> GnssLog:
    """Read the log of a static receiver from the paths of an observation and a navigation file.

    Raises:
        FileNotFoundError, ValueError: as `read_log`, or if it is no pair of paths.
    """
    right = isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2
    if not right or not all(isinstance(path, str | PathLike) for path in pair):
        raise ValueError(
            f"rinex must be the paths of an observation and a navigation file, got {pair!r}."
        )
    paths = [Path(path) for path in pair]
    written = [path.stat().st_mtime_ns if path.is_file() else 0 for path in paths]
    return _read_once(*map(str, paths), *written)


@lru_cache(maxsize=4)
def _read_once(observations: str, navigation: str, *written: int) -> GnssLog:
    """The log, read anew when its files have changed."""
    return read_log(observations, navigation)


# ----- checks -----------------------------------------------------------------------------


def _check_fixes(observed: Observations, fixes: Fixes) -> None:
    found = np.isfinite(fixes.bias).sum()
    if found < 2:
        raise ValueError(
            f"{observed.path}: only {found} of its {len(observed.time)} epochs have four usable "
            "satellites above 10 deg, so there is nowhere to begin."
        )


def _station(observed: Observations, fixes: Fixes) -> Array:
    """The position in the header, checked against the fixes."""
    if observed.moved:
        raise ValueError(
            f"{observed.path}: the receiver moved, so its header's position is not the truth; "
            "read the log with static=False."
        )
    if observed.position is None:
        raise ValueError(
            f"{observed.path}: its header has no APPROX POSITION XYZ, which is the truth of a "
            "static receiver; add it, or read the log with static=False."
        )
    away = np.linalg.norm(np.nanmedian(fixes.position, axis=0) - observed.position)
    if away > WRONG_POSITION:
        raise ValueError(
            f"{observed.path}: the position in its header lies {away:.0f} m from the median fix; "
            "correct it, or read the log with static=False if the receiver moved."
        )
    return observed.position


def _grid(observed: Observations, clock: Array) -> tuple[float, Indices]:
    """Step and number of the evenly spaced instant of each epoch.

    It is true time that is evenly spaced: a receiver's time tags carry its clock's offset.
    """
    time = observed.time - observed.time[0] - clock / SPEED_OF_LIGHT
    interval = round(float(np.median(np.diff(time))), 2)
    if not interval > 0.0:
        raise ValueError(f"{observed.path}: its epochs come faster than a hundred a second.")
    step = interval / ceil(interval / MAX_STEP - 1e-6)
    place = (time - time[0]) / step
    row = np.round(place).astype(np.int64)
    off = np.abs(place - row - np.median(place - row))
    wrong = np.flatnonzero((off > OFF_GRID) | (np.diff(row, prepend=-1) < 1))
    if wrong.size:
        raise ValueError(
            f"{observed.path}: epoch {wrong[0] + 1} comes {time[wrong[0]] - time[0]:.3f} s after "
            f"the first, off the {step:g} s grid of the others; resample the log."
        )
    return step, row


def _clock_jumps(time: Array, clock: Array) -> Indices:
    """Milliseconds (E,) by which the receiver had set its clock until each epoch."""
    passed = np.diff(time)
    drift = np.median(np.diff(clock) / passed)
    excess = (np.diff(clock) - drift * passed) / MILLISECOND
    jump = np.round(excess)
    jump[np.abs(excess - jump) > JUMP_TOLERANCE] = 0.0
    return np.concatenate(([0], np.cumsum(jump))).astype(np.int64)


# ----- the parts of a Recording -----------------------------------------------------------


def _filled(time: Array, values: Array) -> Array:
    """The values (E, k) with those that are NaN interpolated, or held at the ends."""
    known = np.isfinite(values[:, 0])
    return np.stack([np.interp(time, time[known], column[known]) for column in values.T], axis=-1)


def _initial_states(time: Array, fixes: Fixes, shift: Array) -> tuple[Indices, Array, Array]:
    """Where a window may begin, and mean and factor at every epoch, from its fix.

    Velocity and drift come from the Doppler, or else from the fix one epoch before, which
    is then outside of the window.
    """
    place = np.concatenate((fixes.position, (fixes.bias - shift)[:, None]), axis=1)
    speed = np.concatenate((fixes.velocity, fixes.drift[:, None]), axis=1)
    joint = np.zeros((len(time), 8, 8))
    joint[:, :4, :4] = fixes.covariance
    joint[:, 4:, 4:] = fixes.rate_covariance
    passed = np.diff(time, prepend=np.nan)[:, None]
    silent = np.isnan(speed[:, 0])  # no Doppler
    speed[silent] = (np.diff(place, axis=0, prepend=np.nan) / passed)[silent]
    joint[silent] = _of_difference(fixes.covariance, passed[..., None])[silent]

    mean = np.zeros((len(time), STATES))
    order = [*POSITION, BIAS, *VELOCITY, DRIFT]
    mean[:, order] = np.concatenate((place, speed), axis=1)
    covariance = np.zeros((len(time), STATES, STATES))
    covariance[:, ACCELERATION, ACCELERATION] = MANOEUVRE**2
    covariance[np.ix_(range(len(time)), order, order)] = joint
    start = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    start = start[start > 0]
    factor = np.tile(np.eye(STATES), (len(time), 1, 1))
    factor[start] = np.linalg.cholesky(covariance[start])
    return start, mean, factor


def _of_difference(covariance: Array, passed: Array) -> Array:
    """Covariance (E, 8, 8) of each fix beside the rate of change since the fix before."""
    before = np.concatenate((np.full((1, 4, 4), np.nan), covariance[:-1]))
    change = np.zeros_like(covariance)
    change[:, range(3), range(3)] = (0.5 * MANOEUVRE * passed[:, 0]) ** 2
    change[:, 3, 3] = CLOCK_DENSITY * passed[:, 0, 0] / 3.0
    rate = (covariance + before) / passed**2 + change
    return np.block([[covariance, covariance / passed], [covariance / passed, rate]])


def _measurement(raw: Signals, seen: View, channel: Indices, shift: Array) -> Array:
    ranges = by_channel(seen.pseudorange - shift[:, None], channel, np.nan)
    return np.concatenate((ranges, by_channel(raw.rate, channel, np.nan)), axis=1)


def _noise(seen: View, channel: Indices) -> Array:
    ranges = by_channel(seen.deviation, channel, _idle_noise()[0])
    return np.concatenate((ranges, np.full_like(ranges, RATE_NOISE)), axis=1)


def _inputs(seen: View, channel: Indices) -> Array:
    states = np.concatenate((seen.position, seen.velocity), axis=-1)
    return by_channel(states, channel, 0.0).reshape(len(channel), -1)


def _idle_noise() -> Array:
    """What a channel without a satellite is told (24,): no matter what."""
    return np.repeat((float(range_deviation(np.pi / 2.0)), RATE_NOISE), CHANNELS)
