"""Real flights as truth: a track file, a smoothing spline through it, and its windows.

Position reports of aircraft (ADS-B) jitter by 7 to 30 m along the track, since they
are stamped late, and step by 25 ft in altitude; a few are stale by hundreds of
metres. A cubic smoothing spline per axis, in a local east-north-up frame, takes the
jitter out and gives continuous velocity and acceleration at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from kfenv.scenarios.columns import read_columns
from kfenv.scenarios.coverage import CHECK_STEP, check_time, place, turn

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

Array = NDArray[np.float64]
Site = tuple[float, float, float]  # latitude and longitude in degrees, height in m

COLUMNS = ("t", "lat", "lon", "alt_m")
MIN_REPORTS = 10

CUTOFF = 25.0  # s; see smooth_track
MAX_GAP = 10.0  # s
OUTLIER_FACTOR, OUTLIER_FLOOR = 5.0, 30.0  # times the median distance; m
MAX_OUTLIERS = 0.05  # share of the reports
OUTLIER_PASSES = 3

WINDOW_RANGE = (6_000.0, 13_000.0)  # m, of a window's middle, along the ground
MAX_ATTEMPTS = 200


@dataclass(frozen=True, eq=False)
class Track:
    """The position reports of one flight, as they are in its file.

    Attributes:
        time: (N,) increasing, s.
        latitude, longitude: (N,) degrees.
        altitude: (N,) taken as height above the WGS 84 ellipsoid, m.

    Raises:
        ValueError: if the columns differ in length, hold a value that is no number or
            no place on Earth, have fewer than 10 rows, or times do not increase.
    """

    time: Array
    latitude: Array
    longitude: Array
    altitude: Array

    def __post_init__(self) -> None:
        for column, field in zip(COLUMNS, fields(self), strict=True):
            value = np.asarray(getattr(self, field.name), dtype=float)
            object.__setattr__(self, field.name, value)
            _check_column(column, value, self.time.size)
        _check_bounds("lat", self.latitude, 90.0)
        _check_bounds("lon", self.longitude, 360.0)
        steps = np.diff(self.time)
        if not (steps > 0.0).all():
            row = int(np.argmin(steps > 0.0))
            complaint = "repeats" if steps[row] == 0.0 else "decreases"
            raise ValueError(
                f"column 't' {complaint} in data row {row + 2}: {self.time[row]:g} s, then "
                f"{self.time[row + 1]:g} s; sort the rows and keep one per time."
            )


@dataclass(frozen=True, eq=False)
class SmoothTrack:
    """A flight that can be asked for its state at any time.

    Times count from the first report that was kept.

    Attributes:
        origin: of the east-north-up frame: latitude and longitude in degrees, height m.
        duration: s.
        gaps: (begin, end) of the stretches of more than 10 s without a report, s. The
            spline bridges them with the least bending; `window` avoids them.
        rejected: how many stale reports were left out.
    """

    origin: Site
    duration: float
    gaps: tuple[tuple[float, float], ...]
    rejected: int
    _splines: tuple[BSpline, BSpline, BSpline]  # position, velocity, acceleration

    def states(self, time: ArrayLike) -> Array:
        """Return the states (T, 9) at times (T,) s, axis-major, in the frame at the origin.

        Raises:
            ValueError: if the times are unusable or leave the flight.
        """
        return _as_states(self._motion(self._check(time)))

    def random_start(self, rng: Generator, duration: float) -> float:
        """Draw when a window without gaps begins, evenly among all that fit, s.

        Raises:
            ValueError: if no stretch without a gap lasts that long.
        """
        edges = [0.0, *(time for gap in self.gaps for time in gap), self.duration]
        begin, end = np.array(edges[0::2]), np.array(edges[1::2])
        room = end - begin - duration
        longest = float((end - begin).max())
        if longest < duration - 1e-6:
            raise ValueError(
                f"the flight lasts {longest:g} s without a gap of more than {MAX_GAP:g} s in its "
                f"reports, the episode {duration:g} s; shorten the episode or take another flight."
            )
        room = np.maximum(room, 0.0)
        offset = rng.uniform(0.0, room.sum())
        stretch = int(np.searchsorted(np.cumsum(room), offset))
        return float(begin[stretch] + offset - room[:stretch].sum())

    def _check(self, time: ArrayLike) -> Array:
        time = check_time(time)
        if time[0] < 0.0 or time[-1] > self.duration + 1e-6:
            raise ValueError(
                f"the flight lasts from 0 to {self.duration:g} s, "
                f"times from {time[0]:g} to {time[-1]:g} s were asked for."
            )
        return time

    def _motion(self, time: Array) -> Array:
        """Position, velocity and acceleration at any times: (3 axes, 3 quantities, T)."""
        return np.stack([spline(time).T for spline in self._splines], axis=1)


def load_track(path: str | Path) -> Track:
    """Read a flight from a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m).

    Other columns are ignored.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no CSV file, or as in `Track`; the message names the file.
    """
    columns = read_columns(path, "track", COLUMNS)
    try:
        return Track(*columns)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def smooth_track(track: Track, cutoff: float = CUTOFF, origin: Site | None = None) -> SmoothTrack:
    """Fit a cubic smoothing spline to a flight.

    The spline minimises the squared distance to the reports, each weighted by the time
    it stands for, plus (cutoff / 2 pi)^4 times the squared acceleration, both integrated
    over time. Motion of period T comes through with gain 1 / (1 + (cutoff / T)^4), however
    densely it was sampled. Reports further from the spline than five times the median
    (and 30 m) are stale: they are left out and the fit repeated.

    On three airliners' flights the default of 25 s holds speed within 2 m/s rms of the
    reported ground speed and acceleration below 0.7 g, keeps turns (up to 3.4 deg/s) and
    displaces them by 3 to 5 m rms, less than the jitter. At 15 s the jitter makes speed
    errors of 4 m/s rms; at 40 s turns are displaced by 15 m rms, up to 80 m.
    In the first and last half cutoff acceleration fades to zero at the flight's ends.

    Args:
        track: the reports.
        cutoff: period at which the gain is a half, s.
        origin: of the local frame, latitude and longitude in degrees and height in m;
            by default the flight's middle report.

    Raises:
        ValueError: if the cutoff is not positive or longer than the flight, or more than
            5 % of the reports seem stale.
    """
    duration = track.time[-1] - track.time[0]
    if not 0.0 < cutoff <= duration:
        raise ValueError(
            f"cutoff must be positive and at most the flight's {duration:g} s, got {cutoff!r} s."
        )
    middle = track.time.size // 2
    if origin is None:
        origin = (
            float(track.latitude[middle]),
            float(track.longitude[middle]),
            float(track.altitude[middle]),
        )
    position = _local(track, origin)
    kept = _without_outliers(track.time, position, cutoff)
    time = track.time[kept] - track.time[kept][0]
    spline = _fit(time, position[kept], cutoff)
    wide = np.flatnonzero(np.diff(time) > MAX_GAP)
    return SmoothTrack(
        origin=origin,
        duration=float(time[-1]),
        gaps=tuple((float(time[i]), float(time[i + 1])) for i in wide),
        rejected=int((~kept).sum()),
        _splines=(spline, spline.derivative(1), spline.derivative(2)),
    )


def window(
    rng: Generator, smooth: SmoothTrack, time: ArrayLike, altitude_offset: float = 0.0
) -> Array:
    """Cut a random window out of a flight and lay it before the radar.

    The window is turned about its vertical and shifted so that its middle lies 6 to
    13 km away along the ground and all of it in coverage (`kfenv.scenarios.coverage`);
    one that does not fit is redrawn. The radar lies at height 0: airliners stay at
    their altitude unless the offset lowers them. The Earth counts as flat over the shift.

    Args:
        rng: where window and place come from; the same state gives the same bits.
        smooth: the flight.
        time: (T,) increasing, s; only its differences matter.
        altitude_offset: added to the flight's height, m.

    Returns:
        States (T, 9) in m, m/s, m/s^2.

    Raises:
        ValueError: if the times are unusable, or last longer than the flight or than its
            longest stretch without a gap.
        RuntimeError: if none of 200 windows fits into coverage above the ground.
    """
    time = check_time(time)
    elapsed = time - time[0]
    duration = float(elapsed[-1])
    check = np.linspace(0.0, duration, round(duration / CHECK_STEP) + 2)
    for _ in range(MAX_ATTEMPTS):
        start = smooth.random_start(rng, duration)
        to_ground = _Frame.below(smooth, start + 0.5 * duration)
        path = to_ground.apply(smooth._motion(start + check))[:, 0]
        path[2] += altitude_offset
        # The window's middle is the frame's origin.
        placement = place(rng, path, np.zeros(2), WINDOW_RANGE)
        if placement is not None and path[2].min() > 0.0:
            motion = to_ground.apply(smooth._motion(start + elapsed))
            turned = turn(motion[:2].reshape(2, -1), placement.angle)
            motion[:2] = turned.reshape(2, 3, -1)
            motion[:, 0] += np.append(placement.shift, altitude_offset)[:, None]
            return _as_states(motion)
    raise RuntimeError(
        f"none of {MAX_ATTEMPTS} windows of {duration:g} s stayed in the radar's coverage and "
        f"above the ground at an altitude_offset of {altitude_offset:g} m; "
        "ask for a shorter window or change the offset."
    )


def from_radar(smooth: SmoothTrack, radar: Site, time: ArrayLike) -> Array:
    """Return the flight as a radar at a place on Earth sees it, in coverage or not.

    Args:
        smooth: the flight.
        radar: its latitude and longitude in degrees and its height in m.
        time: (T,) s from the flight's first report, increasing.

    Returns:
        States (T, 9) in the radar's east-north-up frame, in m, m/s, m/s^2.

    Raises:
        ValueError: if the times are unusable or leave the flight, or the radar's place
            is not one on Earth.
    """
    _check_bounds("latitude of the radar", np.array([radar[0]]), 90.0)
    _check_bounds("longitude of the radar", np.array([radar[1]]), 360.0)
    motion = smooth._motion(smooth._check(time))
    return _as_states(_Frame.between(smooth.origin, radar).apply(motion))


@dataclass(frozen=True, eq=False)
class _Frame:
    """The way from one east-north-up frame to another: position -> rotation position + shift."""

    rotation: Array
    shift: Array

    @classmethod
    def between(cls, old: Site, new: Site) -> _Frame:
        import pymap3d

        rotation = pymap3d.uvw2enu(*pymap3d.enu2uvw(*np.eye(3), old[0], old[1]), new[0], new[1])
        return cls(np.array(rotation), np.array(pymap3d.geodetic2enu(*old, *new)))

    @classmethod
    def below(cls, smooth: SmoothTrack, time: float) -> _Frame:
        """Lead to the frame at height 0 below the aircraft, since down turns along its way."""
        import pymap3d

        position = smooth._splines[0](time)
        latitude, longitude, _ = pymap3d.enu2geodetic(*position, *smooth.origin)
        return cls.between(smooth.origin, (float(latitude), float(longitude), 0.0))

    def apply(self, motion: Array) -> Array:
        """Return position, velocity and acceleration (3, 3, T) in the new frame."""
        moved = (self.rotation @ motion.reshape(3, -1)).reshape(motion.shape)
        moved[:, 0] += self.shift[:, None]
        return moved


def _as_states(motion: Array) -> Array:
    return motion.transpose(2, 0, 1).reshape(-1, 9)


def _check_column(column: str, value: Array, rows: int) -> None:
    if value.shape != (rows,):
        raise ValueError(f"column {column!r} has shape {value.shape}, column 't' {rows} rows.")
    if rows < MIN_REPORTS:
        raise ValueError(f"a track needs at least {MIN_REPORTS} rows, got {rows}.")
    bad = ~np.isfinite(value)
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"column {column!r} in data row {row + 1} is {value[row]}; leave such rows out."
        )


def _check_bounds(what: str, degrees: Array, most: float) -> None:
    outside = ~(np.abs(degrees) <= most)
    if outside.any():
        raise ValueError(
            f"{what} must be within {most:g} deg of zero, got {degrees[np.argmax(outside)]:g}."
        )


def _local(track: Track, origin: Site) -> Array:
    """Return the reports (N, 3) east, north and up of the origin, m."""
    import pymap3d

    enu = pymap3d.geodetic2enu(track.latitude, track.longitude, track.altitude, *origin)
    return np.stack(enu, axis=-1)


def _without_outliers(time: Array, position: Array, cutoff: float) -> NDArray[np.bool_]:
    """Say which reports lie near a spline that was fitted to these alone."""
    kept = np.ones(time.size, dtype=bool)
    for _ in range(OUTLIER_PASSES):
        spline = _fit(time[kept], position[kept], cutoff)
        away = np.linalg.norm(position - spline(time), axis=1)
        kept = away <= max(OUTLIER_FACTOR * float(np.median(away)), OUTLIER_FLOOR)
    if (~kept).mean() > MAX_OUTLIERS:
        raise ValueError(
            f"{(~kept).sum()} of {time.size} reports lie off the smoothed flight: the file "
            f"mixes aircraft, or a cutoff of {cutoff:g} s is too long for its turns."
        )
    return kept


def _fit(time: Array, position: Array, cutoff: float) -> BSpline:
    from scipy.interpolate import BSpline, make_smoothing_spline

    # Beside a gap a report stands for the seconds near it, not for half of the gap.
    spacing = np.gradient(time)
    weight = np.minimum(spacing, 3.0 * np.median(spacing))
    penalty = (cutoff / (2.0 * np.pi)) ** 4
    axes = [make_smoothing_spline(time, axis, w=weight, lam=penalty) for axis in position.T]
    return BSpline(axes[0].t, np.stack([axis.c for axis in axes], axis=-1), 3)
