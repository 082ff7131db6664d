"""Real inertial and GNSS logs as episodes: resampled, aligned, cut into windows (SPEC 3.5, 4.4).

Where no truth is known, the fixes that faults withhold from the filter
are the yardstick: only there do errors count.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kfenv.models.strapdown import GRAVITY
from kfenv.models.strapdown_biases import local_gravity
from kfenv.scenarios.inertial.files import FixLog, ImuLog
from kfenv.scenarios.windows import PARTS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CHANNELS = 6
ALIGNMENT = 1.0  # s of samples before and after a fix that give the first attitude
ALIGNED = np.radians([3.0, 3.0, 10.0])  # how well: roll and pitch by gravity, yaw by the course


@dataclass(frozen=True)
class Window:
    """A stretch of T instants of a log, in the north-east-down frame at its first fix.

    Attributes:
        rows: (T,) its instants among the log's.
        fix: (T, 6) position and velocity, zero where no fix falls on the instant.
        deviation: (T, 6) of the fixes.
        arrived: (T,) whether a fix falls on the instant.
        truth: (T, 9) the true track, or the one that the fixes suggest; of the attitude the
            yaw alone, as the course.
    """

    rows: Indices
    fix: Array
    deviation: Array
    arrived: NDArray[np.bool_]
    truth: Array


@dataclass(frozen=True, eq=False)
class InertialLog:
    """A pair of logs on evenly spaced instants.

    Attributes:
        imu, fixes, truth: what was read; no truth is None.
        rate: instants per second.
        time: (K,) of the instants, s of the log's clock.
        samples: (K, 6) means of the samples between an instant and the one before.
        used: (M,) the fixes that fall on instants, in order.
        row: (M,) the nearest instant of each.
    """

    imu: ImuLog
    fixes: FixLog
    truth: FixLog | None
    rate: float
    time: Array
    samples: Array
    used: Indices
    row: Indices

    @property
    def steps_per_fix(self) -> int:
        """Usual number of instants from one fix to the next."""
        return max(1, round(self.fixes.interval * self.rate))

    @cached_property
    def first_moving(self) -> int:
        """The first place in `used` at which the course tells the yaw.

        Raises:
            ValueError: if the vehicle never moves fast enough.
        """
        speed = np.hypot(*self.fixes.velocity[self.used, :2].T)
        moving = np.flatnonzero((speed > self.fixes.moving) & (self.row >= ALIGNMENT * self.rate))
        if not len(moving):
            raise ValueError(
                f"{self.fixes.path}: the vehicle never moves faster than {self.fixes.moving:.3g} "
                "m/s, which its yaw is aligned by."
            )
        return int(moving[0])

    def starts(self, duration: float, part: str) -> Indices:
        """All places in `used` at which a window of that part may begin.

        Raises:
            ValueError: if there is none.
        """
        low, high = (share * (len(self.time) - 1) for share in PARTS[part])
        last = np.minimum(high, len(self.time) - 1) - round(duration * self.rate)
        places = np.flatnonzero((self.row >= low) & (self.row <= last))
        places = places[places >= self.first_moving]
        if not len(places):
            whole, since = self.time[-1] - self.time[0], self.time[self.row[self.first_moving]]
            raise ValueError(
                f"{self.imu.path}: the part for {part} ({np.ptp(PARTS[part]):.0%} of "
                f"{whole:.4g} s) has no room for a window of {duration:g} s after the vehicle "
                f"first moves, at t = {since:.10g} s; give a longer log or a shorter duration."
            )
        return places

    def apart(self, duration: float, part: str, every: float) -> Indices:
        """Starts of windows at least so many seconds apart, as many as fit."""
        chosen: list[int] = []
        for place in self.starts(duration, part):
            if not chosen or self.row[place] >= self.row[chosen[-1]] + round(every * self.rate):
                chosen.append(int(place))
        return np.array(chosen)

    def place_before(self, time: float, duration: float, outage: float) -> int:
        """Where a window begins whose fixes after a time are withheld until its end.

        Raises:
            ValueError: if it is not within the log, after the vehicle first moved.
        """
        begin = time - (duration - outage)
        place = int(np.searchsorted(self.time[self.row], begin + 0.5 / self.rate)) - 1
        first, last = self.time[self.row[self.first_moving]], self.time[-1] - duration
        if place < self.first_moving or begin > last:
            raise ValueError(
                f"{self.imu.path}: an outage at t = {time:.10g} s needs a window from "
                f"{begin:.10g} to {begin + duration:.10g} s, and windows lie between "
                f"{first:.10g}, when the vehicle first moves, and {self.time[-1]:.10g} s: give "
                "another time or a shorter duration."
            )
        return place

    def window(self, start: int, duration: float) -> Window:
        """The window that begins at a fix."""
        begin = self.row[start]
        rows = begin + np.arange(round(duration * self.rate) + 1)
        used, places = self._decisions(start, rows)
        origin = self.fixes.place[used[0]]
        fixes = self.local(self.fixes, used, origin)
        # moved along its velocity to the instant that it falls on
        late = self.time[rows[places]] - self.fixes.time[used]
        fixes[:, :3] += late[:, None] * fixes[:, 3:]
        usual = np.median(self.fixes.deviation[self.used], axis=0)
        fix, deviation = np.zeros((len(rows), CHANNELS)), np.tile(usual, (len(rows), 1))
        fix[places], deviation[places] = fixes, self.fixes.deviation[used]
        arrived = np.zeros(len(rows), bool)
        arrived[places] = True
        arrived[0] = False
        truth = self._track(self.time[rows], origin)
        return Window(rows, fix, deviation, arrived, truth)

    def motion_inputs(self, rows: slice | Indices, place: int, inputs: int) -> Array:
        """Samples (k, 6) of instants; of a motion with more inputs also what it asks of a place.

        Args:
            rows: the instants.
            place: in `used`, of the fix where the frame begins.
            inputs: of the motion, 6 or 9.
        """
        samples = self.samples[rows]
        if inputs == samples.shape[1]:
            return samples
        degrees, _, height = self.fixes.place[self.used[place]]
        latitude = np.radians(degrees)
        told = [local_gravity(latitude, height), latitude, height]
        return np.hstack([samples, np.tile(told, (len(samples), 1))])

    def _decisions(self, start: int, rows: Indices) -> tuple[Indices, Indices]:
        """The fixes of a window and their places in it, multiples of the steps per fix.

        A decision concerns the instants at these multiples, and the times of fixes jitter.
        Of two with the same nearest multiple the nearer one stays.
        """
        step = self.steps_per_fix
        chosen = np.arange(start, np.searchsorted(self.row, rows[-1] + step // 2, side="right"))
        off = self.fixes.time[self.used[chosen]] - self.time[rows[0]]
        places = step * np.rint(off * self.rate / step).astype(np.int64)
        places[0] = 0
        nearest_first = np.argsort(np.abs(off - places / self.rate), kind="stable")
        places, first = np.unique(places[nearest_first], return_index=True)
        inside = places < len(rows)
        return self.used[chosen[nearest_first[first]]][inside], places[inside]

    def local(self, log: FixLog, rows: Indices, origin: Array) -> Array:
        """Way north and east of the origin, height below it, and velocities, (k, 6)."""
        import pymap3d

        north, east, _ = pymap3d.geodetic2ned(*log.place[rows].T, *origin)
        position = north, east, origin[2] - log.place[rows, 2]
        return np.hstack([np.stack(position, axis=1), log.velocity[rows]])

    def geodetic(self, place: int, position: Array) -> Array:
        """Latitude, longitude (deg) and height (T, 3) of positions (T, 3) in a fix's frame.

        Args:
            place: in `used`, of the fix.
            position: north, east and down of it, m.
        """
        import pymap3d

        origin = self.fixes.place[self.used[place]]
        latitude, longitude, _ = pymap3d.ned2geodetic(*position.T, *origin)
        return np.stack([latitude, longitude, origin[2] - position[:, 2]], axis=-1)

    def _track(self, time: Array, origin: Array) -> Array:
        """States (T, 9) between the true places, or the fixes: cubic, by their velocities."""
        from scipy.interpolate import CubicHermiteSpline

        log = self.truth or self.fixes
        first = np.searchsorted(log.time, time[0], side="right") - 1
        last = np.searchsorted(log.time, time[-1])
        near = np.arange(max(first - 1, 0), min(last + 2, len(log.time)))
        local = self.local(log, near, origin)
        spline = CubicHermiteSpline(log.time[near], local[:, :3], local[:, 3:])
        position, velocity = spline(time), spline.derivative()(time)
        states = np.zeros((len(time), 9))
        states[:, :3], states[:, 3:6] = position, velocity
        states[:, 8] = np.arctan2(velocity[:, 1], velocity[:, 0])
        return states

    def aligned(self, start: int) -> Array:
        """Roll, pitch and yaw at a fix: gravity levels, the course points (no sideslip).

        The acceleration of the velocity in the fixes around is taken out first, so that
        a turn is not mistaken for level flight.
        """
        now = self.time[self.row[start]]
        around = np.array([now - ALIGNMENT, now + ALIGNMENT])
        force = np.diff(self.imu.integral(around), axis=0)[0, :3] / (2.0 * ALIGNMENT)
        near = self.used[np.abs(self.fixes.time[self.used] - now) <= 1.5 * ALIGNMENT]
        near = near if len(near) > 1 else self.used[max(start - 1, 0) : start + 2]
        since, velocity = self.fixes.time[near] - now, self.fixes.velocity[near]
        since = since - since.mean()
        acceleration = since @ (velocity - velocity.mean(axis=0)) / (since @ since)
        north, east, _ = self.fixes.velocity[self.used[start]]
        return level(force, acceleration - [0.0, 0.0, GRAVITY], float(np.arctan2(east, north)))


def level(force: Array, pull: Array, yaw: float) -> Array:
    """Roll, pitch and yaw (3,) that turn a specific force (3,) in the body into `pull` (3,).

    Args:
        force: along the body's axes, m/s^2.
        pull: the same vector along north, east, down: acceleration less gravity.
        yaw: rad.
    """
    sine, cosine = np.sin(yaw), np.cos(yaw)
    along, across = pull[0] * cosine + pull[1] * sine, pull[1] * cosine - pull[0] * sine
    side = np.hypot(force[1], force[2])
    # across = side sin(a - roll) with force = side (sin a, cos a), and cos(a - roll) < 0
    roll = np.arctan2(force[1], force[2]) - np.pi + np.arcsin(np.clip(across / side, -1.0, 1.0))
    below = force[1] * np.sin(roll) + force[2] * np.cos(roll)
    pitch = np.arctan2(below, force[0]) - np.arctan2(pull[2], along)
    return np.array([_wrapped(roll), _wrapped(pitch), yaw])


def _wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))
