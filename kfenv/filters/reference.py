"""Reference tier: every filter of the family, as plainly as NumPy can say it."""

from __future__ import annotations

from math import log, pi

import numpy as np
from numpy.typing import DTypeLike, NDArray

from kfenv.filters import covariance, square_root, unit_triangular
from kfenv.filters.designs import FilterDesign, find_design
from kfenv.filters.matrices import cholesky, solve_lower
from kfenv.filters.protocol import Episodes, Knobs, Measurement, elapsed, measured
from kfenv.filters.results import (
    BAD_INNOVATION,
    BAD_PREDICTION,
    BAD_UPDATE,
    NOT_POSITIVE_DEFINITE,
    OK,
    History,
    Prediction,
    Run,
    Update,
    blame,
)
from kfenv.filters.square_root import Correction
from kfenv.filters.transforms import StateFunction, angle_indices, sigma_weights, wrap
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch, dual

Array = NDArray[np.float64]
Status = NDArray[np.int64]

LOG_TWO_PI = log(2.0 * pi)
FORMS = {
    "covariance": covariance,
    "square-root": square_root,
    "unit-triangular": unit_triangular,
}


class ReferenceFilter:
    """A `kfenv.filters.protocol.Filter` of one design.

    `run` and `history` serve every design; `predict`, `innovate` and `update` hand lower
    factors in and out and so serve the square-root designs.

    Args:
        motion, sensor: the models.
        design: a name in `kfenv.filters.designs.DESIGNS`, or a `FilterDesign`.
        kappa: spread of the sigma points in place of the design's; may be negative in
            covariance form.
        dtype: precision of all that is computed, float64 or float32. Records are kept in
            float64, which holds either.

    Raises:
        ValueError: if there is no such design or precision, or its weights do not exist.
    """

    def __init__(
        self,
        motion: Motion,
        sensor: Sensor,
        design: FilterDesign | str = "srukf-joseph-exact",
        kappa: float | None = None,
        dtype: DTypeLike = np.float64,
    ) -> None:
        self.motion, self.sensor = motion, sensor
        self.design = find_design(design, kappa)
        self.dtype = np.dtype(dtype)
        if self.dtype not in (np.float64, np.float32):
            raise ValueError(f"dtype must be float64 or float32, got {self.dtype.name}.")
        if self.design.transform != "extended":
            sigma_weights(self.design, len(motion.states))  # complains at the door
        self._form = FORMS[self.design.form]
        self._plain, self._dual = motion.build(batch), motion.build(dual)
        self._measure = sensor.build(batch), sensor.build(dual)
        self._state_angles = angle_indices(motion.states)
        self._channel_angles = angle_indices(sensor.channels)

    def __reduce__(self):
        return ReferenceFilter, (self.motion, self.sensor, self.design, None, self.dtype)

    def predict(
        self, mean: Array, factor: Array, inputs: Array, dt: Array, status: Status
    ) -> Prediction:
        """See `Filter.predict`.

        Raises:
            TypeError: if the design carries covariances.
        """
        self._require_factors()
        return self._predict(*self._rounded(mean, factor, inputs, dt), status)

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.innovate`.

        Raises:
            TypeError: if the design carries covariances.
        """
        self._require_factors()
        return self._update(*self._all_rounded(prediction, knobs, measurement), status, False)

    def update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.update`.

        Raises:
            TypeError: if the design carries covariances.
        """
        self._require_factors()
        return self._update(*self._all_rounded(prediction, knobs, measurement), status, True)

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """See `Filter.run`."""
        return self._filter(episodes, knobs, None)

    def history(self, episodes: Episodes, knobs: Knobs | None = None) -> History:
        """`run` that also keeps the posterior covariances."""
        shape = *episodes.measurement.shape[:2], *episodes.factor.shape[1:]
        spreads = np.full(shape, np.nan)
        run = self._filter(episodes, knobs, spreads)
        with np.errstate(over="ignore"):  # of a filter that has long diverged
            covariances = self._form.spelled_out(spreads)
        return History(*run, covariances, spreads if self._form is square_root else None)

    def _rounded(self, *arrays: Array) -> tuple[Array, ...]:
        """In the filter's precision."""
        return tuple(np.asarray(array, self.dtype) for array in arrays)

    def _all_rounded(self, *records: tuple) -> tuple[tuple, ...]:
        """Records of arrays in the filter's precision."""
        return tuple(type(record)(*self._rounded(*record)) for record in records)

    def _require_factors(self) -> None:
        if self.design.form != "square-root":
            raise TypeError(
                f"This design carries covariances, not factors: {self.design}. "
                "Use run() or history(), or a square-root design."
            )

    def _predict(self, mean, spread, inputs, dt, status) -> Prediction:
        """`predict` for either form; spread is what the form carries."""
        step = StateFunction(self._plain.step, self._dual.step, self._state_angles, inputs, dt)
        noise = np.zeros((len(mean), *2 * (len(self.motion.states),)), self.dtype)
        with np.errstate(all="ignore"):  # what fails is told by the status
            new_mean, root = self._form.propagate(step, mean, spread, self.design)
            entries = self._plain.noise_factor(tuple(mean.T), tuple(inputs.T), dt)
        for (row, column), entry in zip(self.motion.noise_pattern, entries, strict=True):
            noise[:, row, column] = entry
        self._blame_covariance(spread, new_mean, status)
        self._blame_downdate(root, status, new_mean, spread)
        blame(status, BAD_PREDICTION, new_mean, root)
        return Prediction(new_mean, root, noise)

    def _update(self, prediction, knobs, measurement, status, correct) -> Update:
        """`update` for either form; the factor of the result is what the form carries."""
        inputs, value, noise = measurement
        present = ~np.isnan(value)
        measure = StateFunction(*self._measure, self._channel_angles, inputs, present=present)
        known, noise = np.where(present, value, 0.0), np.where(present, noise, 1.0)
        arrived = present.any(axis=1)
        with np.errstate(all="ignore"):
            spread = self._form.add_noise(*prediction[1:], *knobs)
        if self._form is square_root and not arrived.any():  # nothing to work out
            blame(status, NOT_POSITIVE_DEFINITE, spread)
            return Update(prediction.mean.copy(), spread, *_nothing(value))
        with np.errstate(all="ignore"):
            found = self._form.correct(measure, prediction.mean, spread, known, noise, self.design)
            told = _tell(found, present)
        self._blame_covariance(spread, found.innovation, status)
        self._blame_downdate(found.root, status, found.innovation, spread, noise)
        blame(status, BAD_INNOVATION, np.where(arrived, found.nis, 0.0)[:, None])
        take = arrived & correct
        mean = np.where(take[:, None], wrap(found.mean, self._state_angles), prediction.mean)
        spread = np.where(take[:, None, None], found.spread, spread)
        blame(status, BAD_UPDATE, mean)
        blame(status, NOT_POSITIVE_DEFINITE, spread)
        return Update(mean, spread, *told)

    def _filter(self, episodes: Episodes, knobs: Knobs | None, spreads: Array | None) -> Run:
        """Filter episodes; fills spreads (B, T, n, n) if they are wanted."""
        batch_size, steps = episodes.measurement.shape[:2]
        (knobs,) = self._all_rounded(knobs or Knobs.nominal(batch_size))
        status, failed_at = np.zeros(batch_size, np.int64), np.full(batch_size, -1)
        mean, factor = self._rounded(episodes.mean, episodes.factor)
        spread = self._form.start(factor)
        means = np.full((batch_size, steps, mean.shape[1]), np.nan)
        nis = np.full((batch_size, steps), np.nan)
        dt = elapsed(episodes)
        for t in range(steps):
            if t == 0:
                prediction = Prediction(mean, spread, np.zeros_like(spread))
                blame(status, BAD_PREDICTION, mean, spread)
            else:
                known = self._rounded(episodes.motion_inputs[:, t], dt[:, t].copy())
                prediction = self._predict(mean, spread, *known, status)
            (seen,) = self._all_rounded(measured(episodes, t))
            told = self._update(prediction, knobs, seen, status, correct=True)
            mean, spread = told.mean, told.factor
            failed_at[(status != OK) & (failed_at < 0)] = t
            sound = status == OK
            means[sound, t], nis[sound, t] = mean[sound], told.nis[sound]
            if spreads is not None:
                spreads[sound, t] = spread[sound]
        return Run(means, nis, status, failed_at)

    def _blame_covariance(self, spread: Array, outcome: Array, status: Status) -> None:
        """Where an outcome is not finite since sigma points found no root, say so."""
        if self._form is covariance and self.design.transform != "extended":
            suspects = np.flatnonzero(~np.isfinite(outcome).all(axis=1))
            with np.errstate(all="ignore"):
                roots = cholesky(spread[suspects])
            rootless = ~np.isfinite(roots).all(axis=(1, 2))
            sound = np.isfinite(spread[suspects]).all(axis=(1, 2))
            guilty = suspects[rootless & sound]
            status[guilty] = np.where(status[guilty] == OK, NOT_POSITIVE_DEFINITE, status[guilty])

    def _blame_downdate(self, root: Array, status: Status, *sound: Array) -> None:
        """Where a root is not finite for all that what it comes of is, a downdate found none."""
        if self.design.centre == "downdated":
            failed = ~np.isfinite(root).all(axis=(1, 2)) & (status == OK)
            for array in sound:
                failed &= np.isfinite(array).reshape(len(status), -1).all(axis=1)
            status[failed] = NOT_POSITIVE_DEFINITE


def _nothing(value: Array) -> tuple[Array, ...]:
    """The last five fields of `Update` where no channel arrived."""
    batch_size = len(value)
    nothing = np.full((3, *value.shape), np.nan, value.dtype)
    return *nothing, np.full(batch_size, np.nan, value.dtype), np.zeros(batch_size, value.dtype)


def _tell(found: Correction, present: NDArray[np.bool_]) -> tuple[Array, ...]:
    """The last five fields of `Update`; NaN in the channels that are missing."""
    count, arrived = present.sum(axis=1, dtype=found.nis.dtype), present.any(axis=1)
    whitened = solve_lower(found.root, found.innovation[:, :, None])[:, :, 0]
    log_determinant = np.sum(np.log(np.diagonal(found.root, axis1=1, axis2=2)), axis=1)
    log_likelihood = -0.5 * (found.nis + count * LOG_TWO_PI) - log_determinant
    return (
        np.where(present, found.innovation, np.nan),
        np.where(present, np.sum(found.root**2, axis=2), np.nan),
        np.where(present, whitened, np.nan),
        np.where(arrived, found.nis, np.nan),
        np.where(arrived, log_likelihood, 0.0),
    )
