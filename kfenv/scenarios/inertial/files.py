"""Files of real inertial and GNSS logs: columns, units and axes, checked at the door.

An inertial file has the columns ``t`` (s), ``fx, fy, fz`` (specific force, m/s^2) and ``wx, wy,
wz`` (angular rate, rad/s) along forward, right and down; a sample stands for the interval
that ends at its time. A GNSS file has ``t`` (s, the same clock), ``lat, lon`` (deg), ``height``
(m above the ellipsoid), ``vn, ve, vd`` (m/s, north, east, down) and the standard deviations
``sd_n, sd_e, sd_d`` (m) and ``sd_vn, sd_ve, sd_vd`` (m/s). A file with the truth has the first
seven of these. Further columns are ignored. Fixes or truth in a file that ends in ``.pos`` are
RTKLIB's solution, with velocities; its times then are seconds of the GPS week that it begins in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import gathered
from kfenv.models.rotations import matrix_from_angles
from kfenv.models.strapdown import GRAVITY
from kfenv.scenarios.columns import read_columns
from kfenv.scenarios.inertial.solutions import read_fix_columns

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Path = str | PathLike[str]

IMU_COLUMNS = ("t", "fx", "fy", "fz", "wx", "wy", "wz")
TRUTH_COLUMNS = ("t", "lat", "lon", "height", "vn", "ve", "vd")
GNSS_COLUMNS = (*TRUTH_COLUMNS, "sd_n", "sd_e", "sd_d", "sd_vn", "sd_ve", "sd_vd")
MIN_ROWS = 10
DEVIATIONS = (1e-4, 1e4)  # m or m/s, least and greatest that can be meant
MAX_IMU_GAP = 0.5  # s without a sample
MAX_TRUTH_GAP = 5.0  # s without truth, which is interpolated
TRUTH_DISTANCE = 50.0  # m from the fixes, beyond ten of their standard deviations

SPAN = 5.0  # s over which the two files are compared, so that noise averages out
MIN_SPANS = 4
BRIDGED = 2.0  # s between fixes (or three of their intervals) that velocity may be summed over
MOVING = (1.0, 3.0)  # m/s: slower, the course is noise; between these by the deviation
CLEAR_COURSE = 10.0  # deviations of velocity that make a course
STANDS = 0.2  # m/s: slower it stands, or as slow as noise makes it look
WEEK = 604_800.0  # s of GPS, after which some receivers begin again
TURNING = 0.02  # rad/s rms: with less turning the gyroscopes cannot be checked by the course
CLIMBING = 0.5  # m/s rms, likewise for the sign of vd; with less by the correlation
OPPOSITE, ENOUGH = -0.8, 10  # correlation of heights with vd that is no chance in so many spans
FASTEST = 3.0  # rad/s rms: no vehicle turns so all the time


@dataclass(frozen=True, eq=False)
class ImuLog:
    """Inertial samples: time (N,) s, and (N, 6) specific force and angular rate."""

    path: str
    time: Array
    samples: Array

    def integral(self, time: Array) -> Array:
        """Integral (T, 6) of the samples from the first one to the times (T,)."""
        steps = np.diff(self.time, prepend=self.time[0])[:, None]
        total = np.cumsum(self.samples * steps, axis=0)
        return np.stack([np.interp(time, self.time, column) for column in total.T], axis=1)


@dataclass(frozen=True, eq=False)
class FixLog:
    """Fixes, or the truth: time (M,) s, latitude, longitude (deg) and height (m), velocity
    north, east, down (M, 3) m/s, and the standard deviations (M, 6) of position and velocity
    (none of the truth)."""

    path: str
    time: Array
    place: Array
    velocity: Array
    deviation: Array

    @property
    def interval(self) -> float:
        """Usual time between two fixes, s, however their times jitter: the mean without gaps."""
        steps = np.diff(self.time)
        usual = np.abs(steps / np.median(steps) - 1.0) < 0.5
        return float(steps[usual].mean())

    @property
    def moving(self) -> float:
        """Speed from which on the velocity has a course, m/s."""
        if not self.deviation.size:
            return MOVING[1]
        usual = float(np.median(np.hypot(*self.deviation[:, 3:5].T)))
        return float(np.clip(CLEAR_COURSE * usual, *MOVING))

    @property
    def stands(self) -> Mask:
        """Whether the vehicle stands (M,), as far as the fixes can tell."""
        noise = float(np.median(np.linalg.norm(self.deviation[:, 3:], axis=1)))
        return np.linalg.norm(self.velocity, axis=1) < max(STANDS, 2.5 * noise)


def read_imu(
    path: Path, mounting: Sequence[float] = (0.0, 0.0, 0.0), time_offset: float = 0.0
) -> ImuLog:
    """Read an inertial file and check its units and axes by what gravity must look like.

    Args:
        path: of the file.
        mounting: roll, pitch and yaw (rad) of the unit in the vehicle, which are taken out.
        time_offset: what is added to its times, s.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, the column or axis that is wrong, and the remedy.
    """
    columns = np.array(read_columns(path, "inertial log", IMU_COLUMNS))
    _check_rows(str(path), columns, IMU_COLUMNS)
    turned = np.kron(np.eye(2), matrix_from_angles(mounting))
    samples = columns[1:].T @ turned.T if any(mounting) else columns[1:].T.copy()
    log = ImuLog(str(path), _unrolled(columns[0]) + time_offset, samples)
    _check_clock(log.path, log.time, slowest=0.2)
    gap = int(np.argmax(np.diff(log.time)))
    if np.diff(log.time)[gap] > MAX_IMU_GAP:
        raise ValueError(
            f"{log.path}: no sample for {np.diff(log.time)[gap]:.3g} s after t = "
            f"{log.time[gap]:.12g} s; cut the log there and use the longer part."
        )
    gathered(partial(_check_force, log), partial(_check_fastest, log))
    return log


def read_fixes(path: Path, truth: bool = False) -> FixLog:
    """Read a GNSS file, or a file with the truth, which needs no standard deviations.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, the column that is wrong, and the remedy.
    """
    names = TRUTH_COLUMNS if truth else GNSS_COLUMNS
    if FilePath(path).suffix.lower() == ".pos":
        columns = read_fix_columns(path)[: len(names)]
    else:
        columns = np.array(read_columns(path, "truth" if truth else "GNSS log", names))
    _check_rows(str(path), columns, names)
    time = _unrolled(columns[0])
    log = FixLog(str(path), time, columns[1:4].T, columns[4:7].T, columns[7:].T)
    _check_clock(log.path, log.time, slowest=20.0)
    gathered(partial(_check_degrees, log), partial(_check_deviations, log, names))
    return log


def _check_degrees(log: FixLog) -> None:
    for name, degrees, most in (("lat", log.place[:, 0], 90.0), ("lon", log.place[:, 1], 360.0)):
        if np.abs(degrees).max() > most:
            raise ValueError(
                f"{log.path}: column {name!r} reaches {np.abs(degrees).max():g}; give degrees."
            )


def _check_deviations(log: FixLog, names: tuple[str, ...]) -> None:
    low, high = DEVIATIONS
    wrong = ((log.deviation < low) | (log.deviation > high)).any(axis=0)
    if wrong.any():
        name = names[7 + int(np.argmax(wrong))]
        raise ValueError(
            f"{log.path}: column {name!r} holds standard deviations: all must be positive, in m or "
            f"m/s between {low:g} and {high:g}; leave out fixes without."
        )


def check_together(imu: ImuLog, fixes: FixLog) -> None:
    """Complain if the two files cannot be of the same drive, or differ in units or axes.

    Over spans of some seconds the way between fixes must be the integral of their
    velocity, and the course must turn with the gyroscopes.

    Raises:
        ValueError: naming the file, what is wrong, and the remedy.
    """
    _check_common(imu, fixes)
    chosen = _spaced(fixes.time, imu.time[0], imu.time[-1])
    if len(chosen) <= MIN_SPANS:
        return
    gap = np.maximum.reduceat(np.diff(fixes.time)[: chosen[-1]], chosen[:-1])
    whole = gap <= max(BRIDGED, 3.0 * fixes.interval)
    if whole.any():
        arguments = fixes, chosen, whole
        gathered(partial(_check_velocity, *arguments), partial(_check_rates, imu, *arguments))


def check_truth(truth: FixLog, imu: ImuLog, fixes: FixLog) -> None:
    """Complain if a truth is of another clock or drive than the other files, or has gaps.

    Raises:
        ValueError: naming the file, what is wrong, and the remedy.
    """
    import pymap3d

    _check_common(truth, imu)
    _check_common(truth, fixes)
    begin, end = max(imu.time[0], fixes.time[0]), min(imu.time[-1], fixes.time[-1])
    steps = np.diff(truth.time)
    steps[(truth.time[1:] <= begin) | (truth.time[:-1] >= end)] = 0.0
    gap = int(np.argmax(steps))
    if steps[gap] > MAX_TRUTH_GAP:
        raise ValueError(
            f"{truth.path}: no truth for {steps[gap]:.3g} s after t = {truth.time[gap]:.12g} s, "
            f"and at most {MAX_TRUTH_GAP:g} s are bridged: cut the logs there and use the longer "
            "part, or leave the truth out."
        )
    both = (fixes.time >= truth.time[0]) & (fixes.time <= truth.time[-1])
    track = np.stack(pymap3d.geodetic2ned(*truth.place.T, *fixes.place[0]))
    fixed = np.stack(pymap3d.geodetic2ned(*fixes.place[both].T, *fixes.place[0]))
    known = np.stack([np.interp(fixes.time[both], truth.time, axis) for axis in track])
    distance = float(np.median(np.linalg.norm(fixed - known, axis=0)))
    deviation = float(np.median(np.linalg.norm(fixes.deviation[both, :3], axis=1)))
    if distance > 10.0 * deviation + TRUTH_DISTANCE:
        raise ValueError(
            f"{truth.path}: the truth is usually {distance:.3g} m away from the fixes of "
            f"{fixes.path}: give both on one clock, in degrees and metres above the ellipsoid."
        )


def _check_common(log: ImuLog | FixLog, other: ImuLog | FixLog) -> None:
    common = min(log.time[-1], other.time[-1]) - max(log.time[0], other.time[0])
    if common < SPAN * (MIN_SPANS + 1):
        raise ValueError(
            f"{log.path} and {other.path} have {max(common, 0.0):.3g} s in common, and "
            f"{SPAN * (MIN_SPANS + 1):g} s are needed: give times of one clock, in seconds."
        )


def _check_rows(path: str, columns: Array, names: tuple[str, ...]) -> None:
    rows = columns.shape[1]
    if rows < MIN_ROWS:
        raise ValueError(f"{path}: at least {MIN_ROWS} rows are needed, found {rows}.")
    bad = ~np.isfinite(columns)
    if bad.any():
        row = int(np.argmax(bad.any(axis=0)))
        name = names[int(np.argmax(bad[:, row]))]
        value = columns[names.index(name), row]
        raise ValueError(
            f"{path}: column {name!r} in data row {row + 1} is {value}; leave such rows out."
        )


def _unrolled(time: Array) -> Array:
    """Times that go on where seconds of the GPS week begin again."""
    return time + WEEK * np.cumsum(np.diff(time, prepend=time[0]) < -0.5 * WEEK)


def _check_fastest(log: ImuLog) -> None:
    if _rms(log.samples[:, 3:]) > FASTEST:
        raise ValueError(_degrees(log.path, f"their RMS is {_rms(log.samples[:, 3:]):.3g}"))


def _check_clock(path: str, time: Array, slowest: float) -> None:
    steps = np.diff(time)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0))
        raise ValueError(
            f"{path}: column 't' does not increase in data row {row + 2}: {time[row]:.12g} s, then "
            f"{time[row + 1]:.12g} s; sort the rows and keep one per time."
        )
    usual = float(np.median(steps))
    if usual > slowest:
        raise ValueError(
            f"{path}: column 't' advances by {usual:g} from row to row; if these are milliseconds "
            f"(or finer), divide it; more than {slowest:g} s is too slow."
        )


def _check_force(log: ImuLog) -> None:
    """At rest or in flight, mostly the specific force is gravity's reaction: up."""
    usual = np.median(log.samples[:, :3], axis=0)
    size, axis = float(np.linalg.norm(usual)), int(np.argmax(np.abs(usual)))
    numbers = ", ".join(f"{value:.3g}" for value in usual)
    told = f"{log.path}: the usual specific force is ({numbers})"
    if 0.6 < size < 2.0:
        raise ValueError(
            f"{told}, which looks like units of g: multiply it by {GRAVITY}, "
            "or gravity was taken out: leave it in."
        )
    if not 0.6 * GRAVITY < size < 2.0 * GRAVITY:
        raise ValueError(
            f"{told}, not about {GRAVITY} in size: give specific force, gravity included, in m/s^2."
        )
    if abs(usual[axis]) < 0.8 * size:
        raise ValueError(f"{told}: turn its axes to the vehicle's, forward, right and down.")
    if axis != 2:
        raise ValueError(
            f"{told}: gravity lies along {'xyz'[axis]}; order the axes forward, right, down."
        )
    if usual[2] > 0.0:
        raise ValueError(
            f"{told}: the z axis points up; axes forward, left, up become forward, right, down "
            "when fy, fz, wy and wz change sign."
        )


def _check_velocity(fixes: FixLog, chosen: Indices, whole: Mask) -> None:
    """The way between fixes against the integral of velocity, in spans without a gap."""
    import pymap3d

    lat, lon, height = fixes.place[chosen].T
    steps = pymap3d.geodetic2ned(lat[1:], lon[1:], height[1:], lat[:-1], lon[:-1], height[:-1])
    moved = np.stack(steps, axis=1)[whole]
    dt = np.diff(fixes.time)[:, None]
    way = np.cumsum(0.5 * dt * (fixes.velocity[1:] + fixes.velocity[:-1]), axis=0)
    driven = np.diff(np.vstack([np.zeros(3), way])[chosen], axis=0)[whole]
    span = np.diff(fixes.time[chosen])[whole]
    moving = np.linalg.norm(driven[:, :2], axis=1) > fixes.moving * span
    if moving.sum() >= MIN_SPANS:
        ratio = _slope(driven[moving, :2], moved[moving, :2])
        if not 0.7 < ratio < 1.4:
            raise ValueError(
                f"{fixes.path}: positions move {ratio:.3g} times as far as the velocities say: "
                "give lat and lon in degrees, vn and ve in m/s, and keep their order."
            )
    level = _rms(driven[:, 2] / span) < CLIMBING
    opposite = len(span) >= ENOUGH and _correlation(driven[:, 2], moved[:, 2]) < OPPOSITE
    if level and not opposite:
        return
    ratio = _slope(driven[:, 2], moved[:, 2])
    if ratio < -0.3:
        raise ValueError(
            f"{fixes.path}: height rises where 'vd' is positive; it must be the velocity down."
        )
    if ratio > 2.5 and not level:
        raise ValueError(
            f"{fixes.path}: height changes {ratio:.3g} times as much as 'vd' says: give height in "
            "m and vd in m/s."
        )


def _check_rates(imu: ImuLog, fixes: FixLog, chosen: Indices, whole: Mask) -> None:
    """The course's rate against the angular rate about the direction of gravity."""
    span = np.diff(fixes.time[chosen])
    north, east, _ = fixes.velocity[chosen].T
    course = np.arctan2(east, north)
    turned = np.diff(course)
    rate = np.arctan2(np.sin(turned), np.cos(turned)) / span
    mean = np.diff(imu.integral(fixes.time[chosen]), axis=0) / span[:, None]
    down = -mean[:, :3] / np.linalg.norm(mean[:, :3], axis=1, keepdims=True)
    measured = np.sum(mean[:, 3:] * down, axis=1)
    speed = np.hypot(north, east)
    # beyond half a turn in a span the course cannot be told
    use = whole & (np.minimum(speed[1:], speed[:-1]) > fixes.moving) & (np.abs(rate) * span < 2.0)
    if use.sum() < MIN_SPANS or _rms(rate[use]) < TURNING:
        return
    ratio = _slope(rate[use], measured[use])
    if ratio > 15.0:
        raise ValueError(_degrees(imu.path, f"they turn {ratio:.3g} times as fast as the course"))
    if ratio < -0.3:
        raise ValueError(
            f"{imu.path}: the angular rate about down turns against the GNSS course: change the "
            "sign of wz, or of the axes that point the other way."
        )
    if not 0.3 < ratio < 3.0:
        raise ValueError(
            f"{imu.path}: the angular rate about down is {ratio:.2g} times the rate of the GNSS "
            "course: check that both files have one clock, and the order of wx, wy, wz."
        )


def _degrees(path: str, why: str) -> str:
    return f"{path}: the angular rates look like deg/s ({why}): multiply them by pi/180."


def _spaced(time: Array, begin: float, end: float) -> Indices:
    """Fixes at least a span apart, between two times."""
    chosen: list[int] = []
    for i in np.flatnonzero((time >= begin) & (time <= end)):
        if not chosen or time[i] - time[chosen[-1]] >= SPAN:
            chosen.append(int(i))
    return np.array(chosen, np.int64)


def _slope(x: Array, y: Array) -> float:
    return float(np.sum(x * y) / np.sum(x * x))


def _correlation(x: Array, y: Array) -> float:
    """Of two series; zero where one does not vary."""
    x, y = x - x.mean(), y - y.mean()
    size = _rms(x) * _rms(y)
    return float(np.mean(x * y)) / size if size > 0.0 else 0.0


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
