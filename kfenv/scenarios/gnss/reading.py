"""RINEX logs as `GnssLog`: cleared of all that is known, checked, beside their truth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import ceil
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT
from kfenv.models.gnss.pseudorange import BIAS, DRIFT
from kfenv.models.kinematics import ACCELERATION, POSITION, VELOCITY
from kfenv.scenarios.gnss.calibration import calibrated
from kfenv.scenarios.gnss.ephemeris import read_navigation
from kfenv.scenarios.gnss.fix import Fixes, Signals, View, clock_bias, fix, signals, view
from kfenv.scenarios.gnss.log import GnssLog, idle_noise
from kfenv.scenarios.gnss.rinex import Observations, read_observations
from kfenv.scenarios.gnss.satellite_channels import assign_channels, by_channel
from kfenv.scenarios.gnss.truth import true_path
from kfenv.scenarios.windows import PARTS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STATES = 11
MAX_STEP = 1.0  # s: the longest that the motion models take
OFF_GRID = 0.05  # of a step: how far an epoch may lie from the instant that stands for it
MILLISECOND = 1e-3 * SPEED_OF_LIGHT  # m: by multiples of this receivers set their clocks
JUMP_TOLERANCE = 0.05  # of a millisecond
MANOEUVRE = 3.0  # m/s^2: acceleration between two epochs, 1 sigma
CLOCK_DENSITY = 0.1  # (m/s)^2/s: of the clock's drift between two epochs
WRONG_POSITION = 25.0  # m: a mean fix is nearer to a header's position that is right


def read_log(
    observations: str | PathLike[str],
    navigation: str | PathLike[str],
    truth: str | PathLike[str] | None = None,
    moving: bool = False,
) -> GnssLog:
    """Read a RINEX 2 or 3 pair: GPS, and Galileo, BeiDou and QZSS beside it; one frequency.

    A receiver that stood still has the position in the observation file's header as its truth.
    One that moved has that of a third file, or else its fixes where the filter misses them.

    Args:
        observations, navigation: paths of the files.
        truth: of a file with the receiver's positions, see `kfenv.scenarios.positions`.
        moving: whether the receiver moved; a truth, or an event in the file, says so too.

    Raises:
        FileNotFoundError: if a file does not exist.
        ValueError: if a file cannot be used, they do not belong together, epochs are
            too irregular, or a static receiver's header has no position or a wrong one.
    """
    observed = read_observations(observations)
    moving = moving or truth is not None or observed.moved
    tuning = slice(0, max(1, int(PARTS["tuning"][1] * len(observed.time))))
    raw = calibrated(signals(observed, read_navigation(navigation)), tuning)
    fixes = fix(raw)
    _check_fixes(observed, fixes)
    fixed = _filled(observed.time, np.column_stack((fixes.position, fixes.bias)))
    told = None if truth is None else true_path(truth, observed.path, observed.time, fixed)
    if told is not None:
        place = told.position
    elif moving:
        place = fixed[:, :3]
    else:
        place = np.broadcast_to(_station(observed, fixes), (len(observed.time), 3))
    seen = view(raw, place)
    clock = _filled(observed.time, clock_bias(raw, place)[:, None])[:, 0]
    step, row = _grid(observed, clock)
    jumps = _clock_jumps(observed.time, clock)
    shift = jumps * MILLISECOND
    start, mean, factor = _initial_states(observed.time, fixes, shift)
    channel = assign_channels(np.isfinite(seen.pseudorange), seen.elevation)
    instants = np.arange(row[-1] + 1)
    if told is not None:
        began = observed.time[0] - clock[0] / SPEED_OF_LIGHT
        path, known = told.at(began + instants * step)
    else:
        path = np.stack([np.interp(instants, row, axis) for axis in place.T], axis=-1)
        known = np.full(len(instants), not moving)
        known[row] |= np.isfinite(fixes.bias)
    return GnssLog(
        path=str(observations),
        began=float(observed.time[0]),
        step=step,
        row=row,
        measurement=_measurement(raw, seen, channel, shift),
        noise=_noise(raw, seen, channel),
        sensor_inputs=_inputs(seen, channel),
        start=start,
        mean=mean,
        factor=factor,
        truth=_true_states(path, np.interp(instants, row, clock - shift), step),
        known=known,
        moving=moving,
        told=told is not None or not moving,
        clock_jumps=tuple(int(jump) for jump in np.diff(jumps)[np.diff(jumps) != 0]),
    )


def log_of(paths: Sequence[str | PathLike[str]], moving: bool = False) -> GnssLog:
    """Read a log from the paths of an observation, a navigation and perhaps a truth's file.

    Raises:
        FileNotFoundError, ValueError: as `read_log`, or if they are no such paths.
    """
    right = isinstance(paths, Sequence) and not isinstance(paths, str) and len(paths) in (2, 3)
    if not right or not all(isinstance(path, str | PathLike) for path in paths):
        raise ValueError(
            "rinex must be the paths of an observation and a navigation file, and of the truth of "
            f"a receiver that moved, got {paths!r}."
        )
    files = [Path(path).resolve() for path in paths]
    state = [file.stat() for file in files if file.is_file()]
    written = tuple((found.st_size, found.st_mtime_ns) for found in state)
    return _read_once(tuple(map(str, files)), moving, written)


@lru_cache(maxsize=4)
def _read_once(files: tuple[str, ...], moving: bool, written: tuple) -> GnssLog:
    """The log, read anew when its files have changed."""
    observations, navigation, *truth = files
    return read_log(observations, navigation, *truth, moving=moving)


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
    if observed.position is None:
        raise ValueError(
            f"{observed.path}: its header has no APPROX POSITION XYZ, which is the truth of a "
            "static receiver; add it, or say that the receiver moved (moving=True)."
        )
    away = np.linalg.norm(np.nanmedian(fixes.position, axis=0) - observed.position)
    if away > WRONG_POSITION:
        raise ValueError(
            f"{observed.path}: the position in its header lies {away:.0f} m from the median fix; "
            "correct it, or say that the receiver moved (moving=True)."
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


def _true_states(path: Array, bias: Array, step: float) -> Array:
    """States (N, 11) from positions (N, 3) and clock bias (N,)."""
    states = np.zeros((len(path), STATES))
    states[:, POSITION], states[:, BIAS] = path, bias
    if len(path) > 1:
        states[:, VELOCITY] = np.gradient(path, step, axis=0)
        states[:, DRIFT] = np.gradient(bias, step)
    return states


def _measurement(raw: Signals, seen: View, channel: Indices, shift: Array) -> Array:
    ranges = by_channel(seen.pseudorange - shift[:, None], channel, np.nan)
    return np.concatenate((ranges, by_channel(raw.rate, channel, np.nan)), axis=1)


def _noise(raw: Signals, seen: View, channel: Indices) -> Array:
    idle_range, *_, idle_rate = idle_noise()
    ranges = by_channel(seen.deviation, channel, idle_range)
    return np.concatenate((ranges, by_channel(raw.rate_noise, channel, idle_rate)), axis=1)


def _inputs(seen: View, channel: Indices) -> Array:
    states = np.concatenate((seen.position, seen.velocity), axis=-1)
    return by_channel(states, channel, 0.0).reshape(len(channel), -1)
