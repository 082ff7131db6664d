"""The engine's filter for models that are NumPy functions: their calls between compiled steps.

It is the square-root sigma-point filter with the exact Joseph form (SPEC section 9). All sigma
points of all filters pass the user's function in one call; what comes before and after is compiled
once, for models of any size, and not for each model as the engine is.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from kfenv.filters import pointwise_kernel as kernel
from kfenv.filters.protocol import Episodes, Knobs, Measurement, elapsed, measured
from kfenv.filters.results import OK, Prediction, Run, Update
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch
from kfenv.models.own import constant_noise, numpy_function

Array = NDArray[np.float64]
Status = NDArray[np.int64]


class PointwiseFilter:
    """A `kfenv.filters.protocol.Filter`.

    Args:
        motion, sensor: the models, either or both of NumPy functions.
        kappa: spread of the sigma points, >= 0 so that no weight is negative (SPEC 2.2).

    Raises:
        ValueError: if kappa is negative or not finite.
    """

    def __init__(self, motion: Motion, sensor: Sensor, kappa: float = 1.0) -> None:
        if not 0.0 <= kappa < float("inf"):
            raise ValueError(f"kappa must be a non-negative number, got {kappa!r}.")
        self.motion, self.sensor, self.kappa = motion, sensor, float(kappa)
        functions = motion.build(batch)
        self._step = _on_points(motion, functions.step)
        self._measure = _on_points(sensor, sensor.build(batch))
        self._noise_factor = functions.noise_factor
        self._rows, self._columns = np.array(motion.noise_pattern, int).reshape(-1, 2).T
        self._constant = constant_noise(motion)
        self._n, self._m = len(motion.states), len(sensor.channels)
        self._state_angles = np.array([state.angle for state in motion.states])
        self._channel_angles = np.array([channel.angle for channel in sensor.channels])

    def __reduce__(self):
        return PointwiseFilter, (self.motion, self.sensor, self.kappa)

    def predict(
        self, mean: Array, factor: Array, inputs: Array, dt: Array, status: Status
    ) -> Prediction:
        """See `Filter.predict`."""
        size, n = mean.shape
        result = Prediction(np.empty((size, n)), np.empty((size, n, n)), np.zeros((size, n, n)))
        with np.errstate(all="ignore"):  # what fails is told by the status
            step = float(dt[0]) if np.all(dt == dt[0]) else np.repeat(dt, 2 * n + 1)
            moved = self._step(*self._points(mean, factor, inputs), step)
            self._fill_noise(result.noise, mean, inputs, dt)
        kernel.gather(
            np.ascontiguousarray(moved), self._state_angles, self.kappa, result.mean, result.root,
            status,
        )  # fmt: skip
        return result

    def _fill_noise(self, noise: Array, mean: Array, inputs: Array, dt: Array) -> None:
        """Lower factors (B, n, n) of the process noise, so far zero."""
        if self._constant is not None:
            noise[:, self._rows, self._columns] = self._constant
            return
        entries = self._noise_factor(tuple(mean.T), tuple(inputs.T), dt)
        for row, column, entry in zip(self._rows, self._columns, entries, strict=True):
            noise[:, row, column] = entry

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.innovate`."""
        return self._update(prediction, knobs, measurement, status, False)

    def update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.update`."""
        return self._update(prediction, knobs, measurement, status, True)

    def _update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status,
        correct: bool,
    ) -> Update:  # fmt: skip
        size = len(prediction.mean)
        mean, factor = prediction.mean.copy(), np.empty((size, self._n, self._n))
        kernel.add_noise(
            prediction.root, prediction.noise, knobs.fading, knobs.process_scale, factor
        )
        told = Update(
            mean, factor, *np.full((3, size, self._m), np.nan), *np.zeros((2, size))
        )  # fmt: skip
        with np.errstate(all="ignore"):
            seen = self._measure(*self._points(mean, factor, measurement.inputs), None)
        kernel.correct(
            np.ascontiguousarray(seen), np.ascontiguousarray(measurement.value),
            np.ascontiguousarray(measurement.noise), self._channel_angles, self._state_angles,
            self.kappa, correct, *told, status,
        )  # fmt: skip
        return told

    def _points(self, mean: Array, factor: Array, inputs: Array) -> tuple[Array, Array]:
        """All sigma points (n, B P) and the inputs at each, (p, B P)."""
        count = 2 * self._n + 1
        points = np.empty((self._n, len(mean) * count))
        kernel.scatter(mean, factor, sqrt(self._n + self.kappa), points)
        return points, np.repeat(inputs.T, count, axis=1)

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """See `Filter.run`."""
        size, steps = episodes.measurement.shape[:2]
        knobs = knobs or Knobs.nominal(size)
        status, failed_at = np.zeros(size, np.int64), np.full(size, -1)
        means, nis = np.full((size, steps, self._n), np.nan), np.full((size, steps), np.nan)
        factor = np.array(episodes.factor)
        prediction = Prediction(np.array(episodes.mean), factor, np.zeros_like(factor))
        dt = elapsed(episodes)
        for t in range(steps):
            told = self.update(prediction, knobs, measured(episodes, t), status)
            failed_at[(status != OK) & (failed_at < 0)] = t
            sound = status == OK
            means[sound, t], nis[sound, t] = told.mean[sound], told.nis[sound]
            if t + 1 < steps:
                known = episodes.motion_inputs[:, t + 1].copy()
                passed = dt[:, t + 1].copy()
                prediction = self.predict(told.mean, told.factor, known, passed, status)
                failed_at[(status != OK) & (failed_at < 0)] = t + 1
        return Run(means, nis, status, failed_at)


def _on_points(model: Motion | Sensor, function: Callable) -> Callable:
    """A model's function from points (n, N), inputs (p, N) and dt to values (m, N)."""
    given = numpy_function(model)
    if given is not None:
        return given.many

    def values(points: Array, inputs: Array, dt: Array | float | None) -> Array:
        told = function(tuple(points), tuple(inputs), *(() if dt is None else (dt,)))
        return np.stack([np.broadcast_to(part, points.shape[1]) for part in told])

    return values
