"""What two files tell of each other: the clocks' offset, the unit's mounting, its errors at rest.

All is estimated before any filter runs, with its standard deviation, so that a user can see
what to correct; None where the drive does not tell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.models.rotations import matrix_from_angles
from kfenv.models.strapdown_biases import local_gravity
from kfenv.scenarios.inertial.files import MOVING, TURNING, FixLog, ImuLog
from kfenv.scenarios.inertial.log import level

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LARGEST_OFFSET, OFFSET_STEP = 25.0, 0.1  # s
TURN_SPAN, FORCE_SPAN = 1.0, 2.0  # s over which turns and forces are compared
ENOUGH = 20  # spans
EXPLAINED = 0.5  # of the fixes' turns or accelerations: with less the files tell nothing
STANDS, STANDSTILL = 0.2, 3.0  # m/s, s


class Estimate(NamedTuple):
    """A number and its standard deviation."""

    value: float
    deviation: float


class Mounting(NamedTuple):
    """Attitude of the unit in the vehicle: what turns its samples forward, right, down; rad.

    Attributes:
        roll, pitch, yaw: errors of the accelerometers count as tilt, 0.1 m/s^2 as 0.6 deg.
        mirrored: instead of a yaw, what makes fx and fy fit the fixes; empty if they do.
    """

    roll: Estimate
    pitch: Estimate
    yaw: Estimate
    mirrored: str = ""


class Rest(NamedTuple):
    """Means while the vehicle stands.

    Attributes:
        duration: of all standstills, s.
        rate: (3,) rad/s, the gyroscopes' biases but for the Earth's rotation.
        force: size of the specific force, m/s^2, and of gravity there.
        gravity: m/s^2.
    """

    duration: float
    rate: Array
    force: float
    gravity: float


def clock_offset(imu: ImuLog, fixes: FixLog) -> Estimate | None:
    """How far the inertial clock is ahead of the fixes', s: by turns of gyroscopes and course."""
    first, last = _spans(fixes, TURN_SPAN)
    if len(first) < ENOUGH:
        return None
    course = np.arctan2(fixes.velocity[:, 1], fixes.velocity[:, 0])
    turned = np.angle(np.exp(1j * (course[last] - course[first])))
    begin, end = fixes.time[first], fixes.time[last]
    if np.sqrt(np.mean((turned / (end - begin)) ** 2)) < TURNING:
        return None
    down = -np.median(imu.samples[:, :3], axis=0)
    down /= np.linalg.norm(down)
    steps = np.diff(imu.time, prepend=imu.time[0])
    angle = np.cumsum(steps * (imu.samples[:, 3:] @ down))

    def unexplained(offset: float) -> float:
        inside = (begin + offset >= imu.time[0]) & (end + offset <= imu.time[-1])
        if inside.sum() < max(ENOUGH, 0.5 * len(begin)):
            return np.inf
        gyroscopes = np.interp(end + offset, imu.time, angle)
        gyroscopes -= np.interp(begin + offset, imu.time, angle)
        return float(np.var((turned - gyroscopes)[inside]))

    offsets = OFFSET_STEP * np.arange(
        -round(LARGEST_OFFSET / OFFSET_STEP), round(LARGEST_OFFSET / OFFSET_STEP) + 1
    )
    left = np.array([unexplained(offset) for offset in offsets])
    best = int(np.argmin(left))
    if left[best] > (1.0 - EXPLAINED) * np.var(turned) or best in (0, len(left) - 1):
        return None
    below, least, above = left[best - 1 : best + 2]
    bend = (below - 2.0 * least + above) / OFFSET_STEP**2
    if not 0.0 < bend < np.inf:
        return None
    slope = (above - below) / (2.0 * OFFSET_STEP)
    deviation = np.sqrt(2.0 * least / (len(turned) * bend))
    return Estimate(float(offsets[best] - slope / bend), float(deviation))


def mounting(imu: ImuLog, fixes: FixLog) -> Mounting | None:
    """How the unit sits in a vehicle that neither banks nor slides, by forces and accelerations."""
    first, last = _spans(fixes, FORCE_SPAN)
    inside = (fixes.time[first] >= imu.time[0]) & (fixes.time[last] <= imu.time[-1])
    first, last = first[inside], last[inside]
    if len(first) < ENOUGH:
        return None
    span = (fixes.time[last] - fixes.time[first])[:, None]
    total = imu.integral(np.concatenate([fixes.time[first], fixes.time[last]]))[:, :3]
    force = (total[len(first) :] - total[: len(first)]) / span
    pull = _in_vehicle(fixes, first, last, span)
    roll, pitch, _ = level(force.mean(axis=0), pull.mean(axis=0), 0.0)
    force = force @ matrix_from_angles([roll, pitch, 0.0]).T
    # horizontal parts as complex numbers: a yaw is a factor of size one
    x, y = ((h - h.mean()) for h in (force[:, 0] + 1j * force[:, 1], pull[:, 0] + 1j * pull[:, 1]))
    size = np.sum(np.abs(x) ** 2) * np.sum(np.abs(y) ** 2)
    straight, mirror = np.sum(np.conj(x) * y), np.sum(x * y)
    share, mirrored = np.abs(straight) ** 2 / size, np.abs(mirror) ** 2 / size
    if max(share, mirrored) < EXPLAINED:
        return None
    off = (force - pull).std(axis=0)[:2] / (np.sqrt(len(first)) * 9.8)
    yaw = Estimate(
        float(np.angle(straight)), float(np.sqrt((1.0 - share) / (2.0 * len(first) * share)))
    )
    wrong = _mirror(float(np.angle(mirror))) if mirrored > share else ""
    tilt = Estimate(float(roll), float(off[1])), Estimate(float(pitch), float(off[0]))
    return Mounting(*tilt, yaw, wrong)


def at_rest(imu: ImuLog, fixes: FixLog) -> Rest | None:
    """What the unit measures while the fixes say that the vehicle stands."""
    speed = np.linalg.norm(fixes.velocity, axis=1)
    inside = (fixes.time[:-1] >= imu.time[0]) & (fixes.time[1:] <= imu.time[-1])
    still = inside & (speed[:-1] < STANDS) & (speed[1:] < STANDS)
    steps = np.diff(fixes.time)
    still &= steps < 2.0 * fixes.interval
    duration = float(steps[still].sum())
    if duration < STANDSTILL:
        return None
    mean = np.diff(imu.integral(fixes.time), axis=0)[still].sum(axis=0) / duration
    latitude, _, height = np.median(fixes.place[:-1][still], axis=0)
    gravity = float(local_gravity(np.radians(latitude), height))
    return Rest(duration, mean[3:], float(np.linalg.norm(mean[:3])), gravity)


def _spans(fixes: FixLog, span: float) -> tuple[Indices, Indices]:
    """First and last fixes of stretches of about that length in which the vehicle moves."""
    chosen = [0]
    for i in range(1, len(fixes.time)):
        if fixes.time[i] - fixes.time[chosen[-1]] >= span - 1e-6:
            chosen.append(i)
    first, last = np.array(chosen[:-1], np.int64), np.array(chosen[1:], np.int64)
    speed = np.hypot(*fixes.velocity[:, :2].T)
    short = fixes.time[last] - fixes.time[first] <= 2.0 * max(span, fixes.interval)
    use = short & (np.minimum(speed[first], speed[last]) > MOVING)
    return first[use], last[use]


def _in_vehicle(fixes: FixLog, first: Indices, last: Indices, span: Array) -> Array:
    """Acceleration less gravity (k, 3) along the course, to its right and down to the road."""
    velocity = 0.5 * (fixes.velocity[first] + fixes.velocity[last])
    pull = (fixes.velocity[last] - fixes.velocity[first]) / span
    pull[:, 2] -= local_gravity(np.radians(fixes.place[first, 0]), fixes.place[first, 2])
    yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
    pitch = np.arctan2(-velocity[:, 2], np.hypot(velocity[:, 0], velocity[:, 1]))
    axes = matrix_from_angles(np.stack([np.zeros_like(yaw), pitch, yaw], axis=1))
    return np.einsum("kji,kj->ki", axes, pull)


def _mirror(angle: float) -> str:
    """What undoes a mirror image whose conjugate is turned by an angle."""
    if abs(angle) < np.pi / 4.0:
        return "change the sign of fy"
    if abs(angle) > 3.0 * np.pi / 4.0:
        return "change the sign of fx"
    return "exchange fx and fy" if angle > 0.0 else "exchange fx and fy and change both signs"
