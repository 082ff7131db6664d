"""What two files tell of each other: the clocks' offset, the unit's mounting, its errors at rest.

All is estimated before any filter runs, with its standard deviation, so that a user can see
what to correct; None where the drive does not tell.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import gathered
from kfenv.models.rotations import matrix_from_angles
from kfenv.models.strapdown_biases import local_gravity
from kfenv.scenarios.inertial.files import TURNING, FixLog, ImuLog
from kfenv.scenarios.inertial.log import level

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LARGEST_OFFSET, OFFSET_STEP = 25.0, 0.1  # s
TURN_SPAN, FORCE_SPAN = 1.0, 2.0  # s over which turns and forces are compared
ENOUGH = 20  # spans
# Shares of the fixes' turns and accelerations that the unit must explain to tell anything;
# of a flight's turns, which are banked and would look late, it explains less
EXPLAINED_TURNS, EXPLAINED = 0.92, 0.6
STANDSTILL = 3.0  # s
# What is complained of, if it is as many deviations
CERTAIN = 5.0
MOST_OFFSET = 0.75  # s; what banks are left make turns look late by half a second
MOST_TURNED = np.radians(15.0)
MOST_FORCE, MOST_RATE = 0.05, np.radians(3.0)  # share of gravity; rad/s


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
    if left[best] > (1.0 - EXPLAINED_TURNS) * np.var(turned) or best in (0, len(left) - 1):
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
    inside = (fixes.time[:-1] >= imu.time[0]) & (fixes.time[1:] <= imu.time[-1])
    still = inside & fixes.stands[:-1] & fixes.stands[1:]
    steps = np.diff(fixes.time)
    still &= steps < 2.0 * fixes.interval
    duration = float(steps[still].sum())
    if duration < STANDSTILL:
        return None
    mean = np.diff(imu.integral(fixes.time), axis=0)[still].sum(axis=0) / duration
    latitude, _, height = np.median(fixes.place[:-1][still], axis=0)
    gravity = float(local_gravity(np.radians(latitude), height))
    return Rest(duration, mean[3:], float(np.linalg.norm(mean[:3])), gravity)


def clocks_apart(imu: ImuLog, fixes: FixLog) -> Estimate | None:
    """The offset of the clocks where it is large beyond doubt, otherwise None."""
    offset = clock_offset(imu, fixes)
    return offset if offset is not None and _is_more(offset, MOST_OFFSET) else None


def complain_of_clocks(imu: ImuLog, fixes: FixLog, offset: Estimate) -> None:
    """Refuse files whose clocks are apart.

    Raises:
        ValueError: naming the file, the offset, and the argument that corrects it.
    """
    raise ValueError(
        f"{imu.path}: by the turns its clock is {offset.value:.2f} s (+- {offset.deviation:.2f}) "
        f"ahead of the fixes': give time_offset={-offset.value:.2f}, which is added to it."
    )


def check_measured(imu: ImuLog, fixes: FixLog) -> None:
    """Complain of a unit turned in its vehicle, and of units wrong at rest.

    Raises:
        ValueError: naming the file, what was measured, and the argument that corrects it.
    """
    gathered(partial(_complain_of_mounting, imu, fixes), partial(_complain_of_rest, imu, fixes))


def _complain_of_mounting(imu: ImuLog, fixes: FixLog) -> None:
    found = mounting(imu, fixes)
    if found is None:
        return
    if found.mirrored:
        raise ValueError(
            f"{imu.path}: fx and fy fit the accelerations of the fixes only as in a mirror: "
            f"{found.mirrored}; give the axes forward, right, down."
        )
    if any(_is_more(angle, MOST_TURNED) for angle in found[:3]):
        told = [f"{np.degrees(a.value):.1f} (+- {np.degrees(a.deviation):.1f})" for a in found[:3]]
        give = ",".join(f"{np.degrees(angle.value):.1f}" for angle in found[:3])
        raise ValueError(
            f"{imu.path}: by the accelerations the unit sits in the vehicle with roll {told[0]}, "
            f"pitch {told[1]}, yaw {told[2]} deg: give mounting=[{give}]."
        )


def _complain_of_rest(imu: ImuLog, fixes: FixLog) -> None:
    rest = at_rest(imu, fixes)
    if rest is None:
        return
    if abs(rest.force / rest.gravity - 1.0) > MOST_FORCE:
        raise ValueError(
            f"{imu.path}: at rest the specific force is {rest.force:.4g} m/s^2 and gravity "
            f"{rest.gravity:.4g}: check the unit and scale of fx, fy, fz."
        )
    if np.linalg.norm(rest.rate) > MOST_RATE:
        told = ", ".join(f"{rate:.3g}" for rate in np.degrees(rest.rate))
        raise ValueError(
            f"{imu.path}: at rest the angular rates are ({told}) deg/s, more than any bias: check "
            "the unit of wx, wy, wz."
        )


def _is_more(estimate: Estimate, limit: float) -> bool:
    """Whether it is, beyond doubt."""
    return abs(estimate.value) > max(limit, CERTAIN * estimate.deviation)


def _spans(fixes: FixLog, span: float) -> tuple[Indices, Indices]:
    """First and last fixes of stretches of about that length in which the vehicle moves."""
    chosen = [0]
    for i in range(1, len(fixes.time)):
        if fixes.time[i] - fixes.time[chosen[-1]] >= span - 1e-6:
            chosen.append(i)
    first, last = np.array(chosen[:-1], np.int64), np.array(chosen[1:], np.int64)
    speed = np.hypot(*fixes.velocity[:, :2].T)
    short = fixes.time[last] - fixes.time[first] <= 2.0 * max(span, fixes.interval)
    use = short & (np.minimum(speed[first], speed[last]) > fixes.moving)
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
