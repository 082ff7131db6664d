"""Real flights as truth: a smoothing spline through a track file's reports, and its windows.

Position reports of aircraft (ADS-B) jitter by 7 to 60 m along the track, since they
are stamped late or in whole seconds, and step by 25 ft in altitude; a few are stale by
hundreds of metres. A robust cubic smoothing spline in a local east-north-up frame takes
the jitter out and gives continuous velocity and acceleration at any time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from kfenv.checks import is_number
from kfenv.scenarios.coverage import CHECK_STEP, Placement, check_time, place, turn
from kfenv.scenarios.reports import Site, Track, check_degrees, load_track, tidied
from kfenv.scenarios.smoothing import robust_spline, too_stiff

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CUTOFFS = (25.0, 12.5, 6.25, 3.125)  # s; see smooth_track
MAX_TOO_STIFF = 0.01  # share of the reports
HARDEST = 20.0  # m/s^2: who needs more of a shorter cutoff follows reports that are wrong
LONGEST_GAP = 10.0  # s
LATE, ASTRAY = 10.0, 2_000.0  # s and m that a late report may lie off; beyond it is another's
MAX_ASTRAY, MAX_REJECTED = 0.05, 0.3  # shares of the reports

WINDOW_RANGE = (6_000.0, 13_000.0)  # m, of a window's middle, along the ground
MAX_ATTEMPTS, FEW_ATTEMPTS = 200, 20
LOWERED = tuple(range(-1000, -13_000, -1000))  # m, tried for a flight that is too high
SHORTER = (0.75, 0.5, 0.25, 0.1)  # of a window, tried for a flight that is too fast


@dataclass(frozen=True, eq=False)
class SmoothTrack:
    """A flight that can be asked for its state at any time.

    Times count from the first report that was kept.

    Attributes:
        origin: of the east-north-up frame: latitude and longitude in degrees, height m.
        begin: time of that report in the file, s.
        duration: s.
        gaps: (begin, end) of the stretches of more than `longest_gap` without a report, s.
            The spline bridges them with the least bending; `window` avoids them.
        rejected: how many reports were left out, since they were stale or lay far off.
        longest_gap: s.
        path: of the file.
    """

    origin: Site
    begin: float
    duration: float
    gaps: tuple[tuple[float, float], ...]
    rejected: int
    longest_gap: float
    path: str
    _spline: CubicSpline

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
                f"{self.path} lasts {longest:g} s without a gap of more than "
                f"{self.longest_gap:g} s in its reports, the episode {duration:g} s; shorten the "
                f"episode{self._bridge(duration)} or take another flight."
            )
        room = np.maximum(room, 0.0)
        offset = rng.uniform(0.0, room.sum())
        stretch = int(np.searchsorted(np.cumsum(room), offset))
        return float(begin[stretch] + offset - room[:stretch].sum())

    def _bridge(self, duration: float) -> str:
        """The least gap to bridge that makes a stretch long enough, if any does."""
        for least in sorted(end - begin for begin, end in self.gaps):
            wider = [gap for gap in self.gaps if gap[1] - gap[0] > least]
            edges = np.array([0.0, *(time for gap in wider for time in gap), self.duration])
            if (edges[1::2] - edges[0::2]).max() >= duration:
                return f", bridge gaps with longest_gap={np.ceil(least):g}"
        return ""

    def _check(self, time: ArrayLike) -> Array:
        time = check_time(time)
        if time[0] < 0.0 or time[-1] > self.duration + 1e-6:
            raise ValueError(
                f"{self.path} lasts from 0 to {self.duration:g} s, "
                f"times from {time[0]:g} to {time[-1]:g} s were asked for."
            )
        return time

    def _motion(self, time: Array) -> Array:
        """Position, velocity and acceleration at any times: (3 axes, 3 quantities, T)."""
        return np.stack([self._spline(time, order).T for order in range(3)], axis=1)


def flight(
    path: str | PathLike[str], cutoff: float | None = None, longest_gap: float = LONGEST_GAP
) -> SmoothTrack:
    """Read and smooth the flight in a track file, anew when the file has changed.

    Args, Raises: as `load_track` and `smooth_track`.
    """
    file = Path(path).resolve()
    written = file.stat() if file.is_file() else None
    state = (written.st_size, written.st_mtime_ns) if written else ()
    return _smoothed(file, cutoff, longest_gap, state)


def check_track(scenario: Any, only_beside_it: Sequence[str]) -> None:
    """Complain of a scenario's `track` that is no path, and of arguments that need one.

    Raises:
        ValueError: naming the argument.
    """
    path = scenario.track
    if path is not None and not isinstance(path, str | PathLike):
        raise ValueError(f"track must be the path of a CSV file, got {path!r}.")
    for item in fields(scenario):
        value = getattr(scenario, item.name)
        if item.name not in only_beside_it or value is item.default:
            continue
        if path is None and value != item.default:
            raise ValueError(f"{item.name} goes with a real flight: give a track too.")
        if item.name != "radar_position" and not is_number(value):
            raise ValueError(f"{item.name} must be a number, got {value!r}.")


@lru_cache(maxsize=16)
def _smoothed(
    path: Path, cutoff: float | None, longest_gap: float, state: tuple[int, ...]
) -> SmoothTrack:
    return smooth_track(load_track(path), cutoff, longest_gap=longest_gap)


def smooth_track(
    track: Track,
    cutoff: float | None = None,
    origin: Site | None = None,
    longest_gap: float = LONGEST_GAP,
) -> SmoothTrack:
    """Fit a robust cubic smoothing spline to a flight (see `kfenv.scenarios.smoothing`).

    Motion of period T comes through with gain 1 / (1 + (cutoff / T)^4), however densely it
    was sampled; along the track the cutoff grows where times jitter by more than usual.
    Reports further from the spline than five times what those around them show (and 30 m)
    are left out.

    On three airliners' flights a cutoff of 25 s holds speed within 1.5 m/s rms of the
    reported ground speed and acceleration below 0.7 g and keeps turns (up to 3.4 deg/s). A
    smaller aircraft turns faster: by default the cutoff is halved, down to 3 s, until it leaves
    out at most 1 % of the reports that lie on their neighbours' way, or would need 2 g.
    In the first and last half cutoff acceleration fades to zero at the flight's ends.

    Args:
        track: the reports.
        cutoff: period at which the gain is a half, s; None for the default.
        origin: of the local frame, latitude and longitude in degrees and height in m;
            by default the flight's middle report.
        longest_gap: between two reports that windows may bridge, s.

    Raises:
        ValueError: if the cutoff is not positive or longer than the flight, the gap not
            positive, or many reports lie off.
    """
    middle = track.time.size // 2
    if origin is None:
        origin = (
            float(track.latitude[middle]),
            float(track.longitude[middle]),
            float(track.altitude[middle]),
        )
    time, position, stale = tidied(track, origin)
    duration = time[-1] - time[0]
    if cutoff is not None and not 0.0 < cutoff <= duration:
        raise ValueError(
            f"cutoff must be positive and at most the flight's {duration:g} s, got {cutoff!r} s."
        )
    if not longest_gap > 0.0:
        raise ValueError(f"longest_gap must be positive, got {longest_gap!r} s.")
    since = time - time[0]
    cutoff, spline, kept = _fitted(since, position, CUTOFFS if cutoff is None else (cutoff,))
    _check_rejected(track.path, spline, since, position, kept, cutoff)
    begin = time[kept][0] - time[0]
    spline.x -= begin
    wide = np.flatnonzero(np.diff(spline.x) > longest_gap)
    return SmoothTrack(
        origin=origin,
        begin=float(time[kept][0]),
        duration=float(spline.x[-1]),
        gaps=tuple((float(spline.x[i]), float(spline.x[i + 1])) for i in wide),
        rejected=stale + int((~kept).sum()),
        longest_gap=longest_gap,
        path=track.path,
        _spline=spline,
    )


def _fitted(
    time: Array, position: Array, cutoffs: Sequence[float]
) -> tuple[float, CubicSpline, Mask]:
    """The first of the cutoffs that leaves enough in, or the last that flies like an aircraft."""
    best = None
    for cutoff in cutoffs:
        spline, kept = robust_spline(time, position, cutoff)
        if best is not None and np.linalg.norm(spline(spline.x, 2), axis=1).max() > HARDEST:
            break
        best = cutoff, spline, kept
        if too_stiff(time, position, spline, kept) <= MAX_TOO_STIFF:
            break
    return best


def _check_rejected(path: str, spline, time: Array, position: Array, kept, cutoff: float) -> None:
    speed = np.linalg.norm(spline(time, 1), axis=1)
    astray = np.linalg.norm(position - spline(time), axis=1) > ASTRAY + LATE * speed
    if (astray & ~kept).mean() > MAX_ASTRAY:
        raise ValueError(
            f"{path}: {astray.sum()} of {time.size} reports lie kilometres off the smoothed "
            "flight: the file mixes aircraft; keep the rows of one."
        )
    if (~kept).mean() > MAX_REJECTED:
        raise ValueError(
            f"{path}: {(~kept).sum()} of {time.size} reports lie off the smoothed flight: its "
            f"times are wrong, or a cutoff of {cutoff:g} s is too long for its turns; try a "
            f"cutoff of {0.5 * cutoff:g}."
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
            longest stretch without a gap, or none of 200 windows fits into coverage above
            the ground; then the message says what would fit.
    """
    time = check_time(time)
    elapsed = time - time[0]
    duration = float(elapsed[-1])
    drawn = _draw(rng, smooth, duration, altitude_offset)
    if drawn is None:
        raise ValueError(
            f"{smooth.path}: none of {MAX_ATTEMPTS} windows of {duration:g} s stayed in the "
            f"radar's coverage and above the ground at an altitude_offset of {altitude_offset:g} "
            f"m; {_remedy(smooth, duration, altitude_offset)}."
        )
    start, to_ground, placement = drawn
    motion = to_ground.apply(smooth._motion(start + elapsed))
    turned = turn(motion[:2].reshape(2, -1), placement.angle)
    motion[:2] = turned.reshape(2, 3, -1)
    motion[:, 0] += np.append(placement.shift, altitude_offset)[:, None]
    return _as_states(motion)


def _draw(
    rng: Generator,
    smooth: SmoothTrack,
    duration: float,
    altitude_offset: float,
    attempts: int = MAX_ATTEMPTS,
) -> tuple[float, _Frame, Placement] | None:
    """Draw where a window begins and is laid; None if none of the attempts fits."""
    check = np.linspace(0.0, duration, round(duration / CHECK_STEP) + 2)
    for _ in range(attempts):
        start = smooth.random_start(rng, duration)
        to_ground = _Frame.below(smooth, start + 0.5 * duration)
        path = to_ground.apply(smooth._motion(start + check))[:, 0]
        path[2] += altitude_offset
        # The window's middle is the frame's origin.
        placement = place(rng, path, np.zeros(2), WINDOW_RANGE)
        if placement is not None and path[2].min() > 0.0:
            return start, to_ground, placement
    return None


def _remedy(smooth: SmoothTrack, duration: float, altitude_offset: float) -> str:
    """What would let windows fit: another height, or else a shorter window."""
    for length in (duration, *(float(int(share * duration)) for share in SHORTER)):
        for offset in (altitude_offset, 0.0, *LOWERED):
            draws = (
                _draw(rng, smooth, length, offset, FEW_ATTEMPTS)
                for rng in map(np.random.default_rng, range(3))
            )
            if all(draw is not None for draw in draws):
                height = f"an altitude_offset of {offset:g} m" * (offset != altitude_offset)
                shorter = f"a duration of {length:g} s" * (length < duration)
                return f"{' and '.join(filter(None, (height, shorter)))} would fit"
    return "take another flight, or give radar_position to see it where it was flown"


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
    check_degrees("latitude of the radar", np.array([radar[0]]), 90.0)
    check_degrees("longitude of the radar", np.array([radar[1]]), 360.0)
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

        position = smooth._spline(time)
        latitude, longitude, _ = pymap3d.enu2geodetic(*position, *smooth.origin)
        return cls.between(smooth.origin, (float(latitude), float(longitude), 0.0))

    def apply(self, motion: Array) -> Array:
        """Return position, velocity and acceleration (3, 3, T) in the new frame."""
        moved = (self.rotation @ motion.reshape(3, -1)).reshape(motion.shape)
        moved[:, 0] += self.shift[:, None]
        return moved


def _as_states(motion: Array) -> Array:
    return motion.transpose(2, 0, 1).reshape(-1, 9)
