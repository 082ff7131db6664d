"""Reference tier: every filter of the family, as plainly as NumPy can say it."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

from kfenv.filters import covariance, square_root
from kfenv.filters.designs import FilterDesign, find_design
from kfenv.filters.matrices import cholesky, solve_lower, transpose
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


class ReferenceFilter:
    """A batch of filters of one design, with the interface of `kfenv.filters.engine.Engine`.

    The methods, shapes and failure statuses are the engine's. `run` and `history`
    serve every design; `predict`, `innovate` and `update` hand lower factors in and
    out and so serve the square-root designs.

    Args:
        motion, sensor: the models.
        design: a name in `kfenv.filters.designs.DESIGNS`, or a `FilterDesign`.
        kappa: spread of the sigma points in place of the design's; may be negative in
            covariance form.

    Raises:
        ValueError: if there is no such design, or its weights do not exist.
    """

    def __init__(
        self,
        motion: Motion,
        sensor: Sensor,
        design: FilterDesign | str = "srukf-joseph-exact",
        kappa: float | None = None,
    ) -> None:
        self.motion, self.sensor = motion, sensor
        self.design = find_design(design, kappa)
        if self.design.transform != "extended":
            sigma_weights(self.design, len(motion.states))  # complains at the door
        self._form = square_root if self.design.form == "square-root" else covariance
        self._plain, self._dual = motion.build(batch), motion.build(dual)
        self._measure = sensor.build(batch), sensor.build(dual)
        self._state_angles = angle_indices(motion.states)
        self._channel_angles = angle_indices(sensor.channels)

    def __reduce__(self):
        return ReferenceFilter, (self.motion, self.sensor, self.design)

    def predict(
        self, mean: Array, factor: Array, u: Array, dt: Array, status: Status
    ) -> Prediction:
        """Time update over dt (B,) with known inputs u (B, p).

        Raises:
            TypeError: if the design carries covariances.
        """
        self._require_factors()
        return self._predict(mean, factor, u, dt, status)

    def innovate(
        self,
        prediction: Prediction,
        fading: Array,
        process_scale: Array,
        s: Array,
        z: Array,
        sd: Array,
        status: Status,
    ) -> Update:
        """Form the innovation and stop there: mean and factor are the predicted ones.

        The predicted covariance is fading root root^T + process_scale noise noise^T.

        Args:
            fading, process_scale: knobs, (B,), variance factors.
            s: known inputs of the sensor, (B, k).
            z: measurement (B, m), NaN where nothing arrived.
            sd: standard deviation of its noise, (B, m).

        Raises:
            TypeError: if the design carries covariances.
        """
        self._require_factors()
        return self._update(prediction, fading, process_scale, s, z, sd, status, correct=False)

    def update(
        self,
        prediction: Prediction,
        fading: Array,
        process_scale: Array,
        s: Array,
        z: Array,
        sd: Array,
        status: Status,
    ) -> Update:
        """Measurement update; arguments as in `innovate`."""
        self._require_factors()
        return self._update(prediction, fading, process_scale, s, z, sd, status, correct=True)

    def run(
        self,
        mean: Array,
        factor: Array,
        time: Array,
        u: Array,
        s: Array,
        z: Array,
        sd: Array,
        fading: Array,
        process_scale: Array,
    ) -> Run:
        """Filter whole recordings; at the first time there is no prediction.

        Args:
            mean, factor: initial state at the first time, (B, n) and lower (B, n, n).
            time: (T,).
            u, s: known inputs of the motion (B, T, p) and of the sensor (B, T, k).
            z, sd: measurements and noise deviations, (B, T, m).
            fading, process_scale: constant knobs, (B,).
        """
        return self._filter(mean, factor, time, u, s, z, sd, fading, process_scale, None)

    def history(
        self,
        mean: Array,
        factor: Array,
        time: Array,
        u: Array,
        s: Array,
        z: Array,
        sd: Array,
        fading: Array,
        process_scale: Array,
    ) -> History:
        """`run` that also keeps the posterior covariances; arguments as there."""
        spreads = np.full((*z.shape[:2], *factor.shape[1:]), np.nan)
        run = self._filter(mean, factor, time, u, s, z, sd, fading, process_scale, spreads)
        if self.design.form == "square-root":
            with np.errstate(over="ignore"):  # of a filter that has long diverged
                return History(*run, spreads @ transpose(spreads), spreads)
        return History(*run, spreads, None)

    def _require_factors(self) -> None:
        if self.design.form != "square-root":
            raise TypeError(
                f"This design carries covariances, not factors: {self.design}. "
                "Use run() or history(), or a square-root design."
            )

    def _predict(self, mean, spread, u, dt, status) -> Prediction:
        """`predict` for either form; spread is what the form carries."""
        step = StateFunction(self._plain.step, self._dual.step, self._state_angles, u, dt)
        noise = np.zeros((len(mean), len(self.motion.states), len(self.motion.states)))
        with np.errstate(all="ignore"):  # what fails is told by the status
            new_mean, root = self._form.propagate(step, mean, spread, self.design)
            entries = self._plain.noise_factor(tuple(mean.T), tuple(u.T), dt)
        for (row, column), entry in zip(self.motion.noise_pattern, entries, strict=True):
            noise[:, row, column] = entry
        self._blame_covariance(spread, new_mean, status)
        blame(status, BAD_PREDICTION, new_mean, root)
        return Prediction(new_mean, root, noise)

    def _update(self, prediction, fading, process_scale, s, z, sd, status, correct) -> Update:
        """`update` for either form; the factor of the result is what the form carries."""
        present = ~np.isnan(z)
        measure = StateFunction(*self._measure, self._channel_angles, s, present=present)
        known, noise = np.where(present, z, 0.0), np.where(present, sd, 1.0)
        arrived = present.any(axis=1)
        with np.errstate(all="ignore"):
            spread = self._form.add_noise(*prediction[1:], fading, process_scale)
        if self._form is square_root and not arrived.any():  # nothing to work out
            blame(status, NOT_POSITIVE_DEFINITE, spread)
            return Update(prediction.mean.copy(), spread, *_nothing(z))
        with np.errstate(all="ignore"):
            found = self._form.correct(measure, prediction.mean, spread, known, noise, self.design)
            told = _tell(found, present)
        self._blame_covariance(spread, found.innovation, status)
        blame(status, BAD_INNOVATION, np.where(arrived, found.nis, 0.0)[:, None])
        take = arrived & correct
        mean = np.where(take[:, None], wrap(found.mean, self._state_angles), prediction.mean)
        spread = np.where(take[:, None, None], found.spread, spread)
        blame(status, BAD_UPDATE, mean)
        blame(status, NOT_POSITIVE_DEFINITE, spread)
        return Update(mean, spread, *told)

    def _filter(
        self, mean, factor, time, u, s, z, sd, fading, process_scale, spreads: Array | None
    ) -> Run:
        """Filter recordings; fills spreads (B, T, n, n) if they are wanted."""
        batch_size, steps = z.shape[:2]
        status, failed_at = np.zeros(batch_size, np.int64), np.full(batch_size, -1)
        means = np.full((batch_size, steps, mean.shape[1]), np.nan)
        nis = np.full((batch_size, steps), np.nan)
        spread = self._form.start(factor)
        dt = np.diff(time, prepend=time[:1])
        for t in range(steps):
            if t == 0:
                prediction = Prediction(mean, spread, np.zeros_like(spread))
                blame(status, BAD_PREDICTION, mean, spread)
            else:
                elapsed = np.full(batch_size, dt[t])
                prediction = self._predict(mean, spread, u[:, t], elapsed, status)
            told = self._update(
                prediction, fading, process_scale, s[:, t], z[:, t], sd[:, t], status, correct=True
            )
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


def _nothing(z: Array) -> tuple[Array, ...]:
    """The last five fields of `Update` where no channel arrived."""
    return *np.full((3, *z.shape), np.nan), np.full(len(z), np.nan), np.zeros(len(z))


def _tell(found: Correction, present: NDArray[np.bool_]) -> tuple[Array, ...]:
    """The last five fields of `Update`; NaN in the channels that are missing."""
    count, arrived = present.sum(axis=1), present.any(axis=1)
    whitened = solve_lower(found.root, found.innovation[:, :, None])[:, :, 0]
    log_determinant = np.sum(np.log(np.diagonal(found.root, axis1=1, axis2=2)), axis=1)
    log_likelihood = -0.5 * (found.nis + count * np.log(2.0 * pi)) - log_determinant
    return (
        np.where(present, found.innovation, np.nan),
        np.where(present, np.sum(found.root**2, axis=2), np.nan),
        np.where(present, whitened, np.nan),
        np.where(arrived, found.nis, np.nan),
        np.where(arrived, log_likelihood, 0.0),
    )
