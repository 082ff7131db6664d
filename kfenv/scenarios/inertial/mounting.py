"""Whether an inertial unit's axes are the vehicle's: its samples must lead from fix to fix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.models.namespaces import batch
from kfenv.models.strapdown import strapdown
from kfenv.scenarios.inertial.log import InertialLog

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STRETCH = 8.0  # s: long enough to turn, short enough for a poor unit
MARGIN = 2.0  # s of samples before and after, more than the alignment needs
STRETCHES, ENOUGH = 30, 5
TURNED = 0.5  # rad in a stretch; by the gyroscopes, so that outliers of GNSS choose nothing
DRIFT = 12.0  # m/s in a stretch, more than units with biases of 1 deg/s and 0.3 m/s^2 drift
RATE = 50.0  # Hz, of the samples' means: the check needs no more


def check_mounting(log: InertialLog) -> None:
    """Complain if the samples, mechanised from aligned states, lead away from the fixes.

    Where the vehicle turns, inertial navigation of a few seconds must be much better than
    constant velocity; with forward and right exchanged, or turned about, it is as bad. A
    poor unit passes, and so does a slow or straight drive, which tells too little.

    Raises:
        ValueError: naming the file, the likely culprits and the numbers.
    """
    begin, end = _stretches(log)
    if len(begin) < ENOUGH:
        return
    first, last = (log.fixes.velocity[log.used[place], :2] for place in (begin, end))
    constant = np.linalg.norm(last - first, axis=1)
    found = _velocity(log, begin, log.time[log.row[end]] - log.time[log.row[begin]])
    error = float(np.median(np.linalg.norm(found - last, axis=1)))
    usual = float(np.median(constant))
    if error > max(0.5 * usual, DRIFT):
        raise ValueError(
            f"{log.imu.path}: over {STRETCH:g} s in which the vehicle turns, the samples miss the "
            f"GNSS velocity by {error:.3g} m/s, and constant velocity by {usual:.3g} m/s: check "
            "the axes (x forward, y to the right, z down), the signs of fx, fy, wx, wy, wz, and "
            "that both files have one clock."
        )


def _stretches(log: InertialLog) -> tuple[Indices, Indices]:
    """Places in `used` where stretches in which the vehicle turns begin and end."""
    row = log.row
    margin, whole = round(MARGIN * log.rate), round(STRETCH * log.rate)
    begin = np.flatnonzero((row >= margin) & (row + whole < len(log.time) - margin))
    end = np.searchsorted(row, row[begin] + whole, side="right") - 1
    full = row[end] - row[begin] > 0.75 * whole
    moving = np.linalg.norm(log.fixes.velocity[log.used[begin], :2], axis=1) > log.fixes.moving
    angle = log.imu.integral(log.time)[:, 3:]
    turned = np.linalg.norm(angle[row[end]] - angle[row[begin]], axis=1) > TURNED
    use = np.flatnonzero(full & moving & turned)
    use = use[:: max(1, len(use) // STRETCHES)]
    return begin[use], end[use]


def _velocity(log: InertialLog, begin: Indices, duration: Array) -> Array:
    """Horizontal velocities (S, 2) after stretches, mechanised from the aligned states."""
    step = strapdown((1.0, 1.0, 1.0)).build(batch).step
    since = np.arange(round(STRETCH * RATE) + 1) / RATE
    time = log.time[log.row[begin]][:, None] + since
    total = log.imu.integral(time.ravel()).reshape(*time.shape, 6)
    samples = np.diff(total, axis=1) * RATE
    velocity = log.fixes.velocity[log.used[begin]]
    attitude = np.array([log.aligned(place) for place in begin])
    state = tuple(np.hstack([np.zeros_like(velocity), velocity, attitude]).T)
    found = [np.stack(state[3:5], axis=1)]
    for sample in samples.transpose(1, 2, 0):
        state = step(state, tuple(sample), 1.0 / RATE)
        found.append(np.stack(state[3:5], axis=1))
    return np.array(found)[np.rint(duration * RATE).astype(np.int64), np.arange(len(begin))]
