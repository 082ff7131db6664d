"""What a log has taught a filter up to each of its fixes: a plain extended filter run over it.

Biases take longer to settle than a window lasts, and attitude is better known the longer the
vehicle has turned and braked. So a window begins with what the log before it taught.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Motion
from kfenv.models.namespaces import batch, scalar
from kfenv.scenarios.inertial.log import ALIGNED, InertialLog

Array = NDArray[np.float64]

LONGEST = 0.25  # s of covariance in one linear step
NUDGE = 1e-5  # of a state, for differences


class Lessons:
    """Mean and covariance of the state after each fix, positions relative to that fix.

    Attributes:
        first: place in ``log.used`` of the first fix with any: where the vehicle first moved.
        mean, covariance: (K, n), (K, n, n) of the places from the first one on.
    """

    def __init__(self, log: InertialLog, motion: Motion, bias: tuple[float, ...]) -> None:
        self._log, self._size, self._inputs = log, len(motion.states), len(motion.inputs)
        self._scalar, self._batch = motion.build(scalar), motion.build(batch)
        self._angle = np.array([state.angle for state in motion.states])
        self.first = log.first_moving
        mean, covariance = self._begin(bias)
        self.mean, self.covariance = [mean], [covariance]
        for place in range(self.first + 1, len(log.used)):
            mean, covariance = self._predict(mean, covariance, place)
            mean, covariance = self._correct(mean, covariance, place)
            self.mean.append(mean)
            self.covariance.append(covariance)

    def at(self, place: int) -> tuple[Array, Array]:
        """Mean (n,) and lower factor (n, n) after the fix at a place of ``log.used``."""
        index = place - self.first
        return self.mean[index], np.linalg.cholesky(self.covariance[index])

    def _begin(self, bias: tuple[float, ...]) -> tuple[Array, Array]:
        log, fix = self._log, self._log.used[self.first]
        deviation = np.concatenate([log.fixes.deviation[fix], ALIGNED, bias])
        mean = np.zeros(self._size)
        mean[3:6], mean[6:9] = log.fixes.velocity[fix], log.aligned(self.first)
        return mean, np.diag(deviation**2)

    def _predict(self, mean: Array, covariance: Array, place: int) -> tuple[Array, Array]:
        """Every sample for the mean, a few of their means for the covariance."""
        log = self._log
        rows = slice(log.row[place - 1] + 1, log.row[place] + 1)
        inputs = log.motion_inputs(rows, place - 1, self._inputs)
        parts = max(1, round(len(inputs) / log.rate / LONGEST))
        for part in np.array_split(inputs, parts):
            dt, told = len(part) / log.rate, tuple(part.mean(axis=0))
            F = self._jacobian(mean, told, dt)
            noise = np.array(self._scalar.noise_factor(tuple(mean.tolist()), told, dt))
            covariance = F @ covariance @ F.T + np.diag(noise**2)
            state = tuple(mean.tolist())
            for sample in part.tolist():
                state = self._scalar.step(state, sample, 1.0 / log.rate)
            mean = np.array(state)
        return mean, covariance

    def _jacobian(self, mean: Array, inputs: tuple[float, ...], dt: float) -> Array:
        """Of the step, (n, n), by central differences."""
        shift = NUDGE * np.eye(self._size)
        points = mean[:, None] + np.hstack([shift, -shift])
        high, low = np.hsplit(np.array(self._batch.step(tuple(points), inputs, dt)), 2)
        difference = high - low
        angle = difference[self._angle]
        difference[self._angle] = np.arctan2(np.sin(angle), np.cos(angle))
        return difference / (2.0 * NUDGE)

    def _correct(self, mean: Array, covariance: Array, place: int) -> tuple[Array, Array]:
        """Joseph's form; the origin moves on to the new fix."""
        log, fix = self._log, self._log.used[place]
        moved = log.local(log.fixes, [fix], log.fixes.place[log.used[place - 1]])[0]
        late = log.time[log.row[place]] - log.fixes.time[fix]
        off = moved + late * np.concatenate([moved[3:], np.zeros(3)]) - mean[:6]
        R = np.diag(log.fixes.deviation[fix] ** 2)
        try:
            gain = np.linalg.solve(covariance[:6, :6] + R, covariance[:6]).T
        except np.linalg.LinAlgError:
            raise ValueError(
                f"{log.fixes.path}: the fix at t = {log.fixes.time[fix]:.10g} s cannot be weighed "
                f"against what {log.imu.path} measured until then: check the numbers and units of "
                "both, and the fixes' deviations."
            ) from None
        keep = np.eye(self._size) - gain @ np.eye(6, self._size)
        mean = mean + gain @ off
        mean[:3] -= moved[:3]
        return mean, keep @ covariance @ keep.T + gain @ R @ gain.T


@lru_cache(maxsize=4)
def lessons(log: InertialLog, motion: Motion, bias: tuple[float, ...]) -> Lessons:
    """What a log taught a filter with this motion: run once for equal arguments.

    Args:
        log: the log.
        motion: with 9 states or, with biases, 15.
        bias: standard deviations of the biases before anything is known of them.
    """
    return Lessons(log, motion, bias)
