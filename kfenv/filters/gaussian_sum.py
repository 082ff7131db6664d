"""The Gaussian sum: noise that is nominal or an outlier, over any square-root filter (SPEC 5)."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.filters.matrices import tria
from kfenv.filters.protocol import Episodes, Filter, Knobs, Measurement
from kfenv.filters.replay import replay
from kfenv.filters.results import BAD_UPDATE, Prediction, Run, Update, blame
from kfenv.filters.transforms import angle_indices, wrap

Array = NDArray[np.float64]
Status = NDArray[np.int64]


@dataclass(frozen=True)
class Mixture:
    """Measurement noise (1 - weight) N(0, R) + weight N(0, ratio R), by whole vector (SPEC 4.4).

    Attributes:
        weight: share of outliers, in [0, 1).
        ratio: of the outliers' variance to the nominal one, above 1.
        as_printed: branches of equal prior weight, since the printed weight is the fading
            factor of both (S4 eq 44), and P_R without the spread of the means (eq 46).

    Raises:
        ValueError: if a number is out of its range.
    """

    weight: float = 0.15
    ratio: float = 500.0
    as_printed: bool = False

    def __post_init__(self) -> None:
        if not (is_number(self.weight) and 0.0 <= self.weight < 1.0):
            raise ValueError(f"The mixture's weight must lie in [0, 1), got {self.weight!r}.")
        if not (is_number(self.ratio) and self.ratio > 1.0):
            raise ValueError(f"The mixture's ratio must be greater than 1, got {self.ratio!r}.")


def posterior_log_weights(log_prior: Array, log_likelihood: Array) -> Array:
    """log alpha_j = log pi_j gamma_j - log sum pi_i gamma_i, branches first (J, B)."""
    joint = log_prior + log_likelihood
    return joint - np.logaddexp.reduce(joint, axis=0)


def collapse(
    weights: Array,
    means: Array,
    factors: Array,
    angles: NDArray[np.intp],
    spread_of_means: bool = True,
) -> tuple[Array, Array]:
    """The Gaussian with the moments of a sum of Gaussians, square roots all the way.

    x = sum w_j m_j and S = tria[sqrt(w_j) S_j, sqrt(w_j) (m_j - x)], so that S S^T is
    sum w_j (P_j + (m_j - x)(m_j - x)^T) (S4 eq 45, 46).

    Args:
        weights: (J, B), of sum 1.
        means, factors: of the branches, (J, B, n) and lower (J, B, n, n).
        angles: indices of the states that are angles, averaged about the first branch.
        spread_of_means: False leaves it out, as printed.
    """
    offsets = np.stack([wrap(mean - means[0], angles) for mean in means])
    shift = np.sum(weights[:, :, None] * offsets, axis=0)
    root = np.sqrt(weights)[:, :, None, None]
    columns = list(root * factors)
    if spread_of_means:
        columns += list(root * (offsets - shift)[..., None])
    return wrap(means[0] + shift, angles), tria(*columns)


class GaussianSum:
    """A filter that holds every measurement for nominal or an outlier, by its likelihood.

    Both branches are the base filter's update of the same prediction, with noise R and
    with ratio R; they collapse before the next step. It is itself a `Filter`.

    Args:
        base: `Engine`, or a `ReferenceFilter` in square-root form.
        mixture: the noise.
    """

    def __init__(self, base: Filter, mixture: Mixture = Mixture()) -> None:
        self.motion, self.sensor = base.motion, base.sensor
        self.base, self.mixture = base, mixture
        self._angles = angle_indices(self.motion.states)

    def predict(
        self, mean: Array, factor: Array, inputs: Array, dt: Array, status: Status
    ) -> Prediction:
        """See `Filter.predict`: the base's."""
        return self.base.predict(mean, factor, inputs, dt, status)

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.innovate`: the base's, under the nominal noise."""
        return self.base.innovate(prediction, knobs, measurement, status)

    def update(
        self,
        prediction: Prediction,
        knobs: Knobs,
        measurement: Measurement,
        status: Status,
        outlier_odds: Array | None = None,
    ) -> Update:
        """See `Filter.update`.

        Innovation, variance and NIS are the nominal branch's, the log-likelihood the sum's.

        Args:
            outlier_odds: factor (B,) on the prior odds of an outlier, weight / (1 - weight).
        """
        nominal = self.base.update(prediction, knobs, measurement, status)
        arrived = ~np.isnan(measurement.value).all(axis=1)
        if not arrived.any():
            return nominal
        outlier = self.base.update(prediction, knobs, self._as_outlier(measurement), status)
        with np.errstate(all="ignore"):  # what fails is told by the status
            log_prior = self._log_prior(outlier_odds, len(arrived))
            log_likelihood = np.stack([nominal.log_likelihood, outlier.log_likelihood])
            weights = np.exp(posterior_log_weights(log_prior, log_likelihood))
            mean, factor = collapse(
                weights, np.stack([nominal.mean, outlier.mean]),
                np.stack([nominal.factor, outlier.factor]), self._angles,
                spread_of_means=not self.mixture.as_printed,
            )  # fmt: skip
            total = np.logaddexp.reduce(log_prior + log_likelihood, axis=0)
        blame(status, BAD_UPDATE, np.where(arrived[:, None], mean, 0.0))
        return nominal._replace(
            mean=np.where(arrived[:, None], mean, nominal.mean),
            factor=np.where(arrived[:, None, None], factor, nominal.factor),
            log_likelihood=np.where(arrived, total, 0.0),
        )

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """See `Filter.run`."""
        return Run(*replay(self, None, episodes, knobs, keep=False)[:4])

    def nominal_probability(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> tuple[Update, Array]:
        """The nominal innovation and the posterior weight (B,) of its branch."""
        nominal = self.base.innovate(prediction, knobs, measurement, status)
        outlier = self.base.innovate(prediction, knobs, self._as_outlier(measurement), status)
        log_likelihood = np.stack([nominal.log_likelihood, outlier.log_likelihood])
        with np.errstate(all="ignore"):
            log_prior = self._log_prior(None, len(status))
            return nominal, np.exp(posterior_log_weights(log_prior, log_likelihood)[0])

    def _as_outlier(self, measurement: Measurement) -> Measurement:
        return measurement._replace(noise=sqrt(self.mixture.ratio) * measurement.noise)

    def _log_prior(self, outlier_odds: Array | None, batch: int) -> Array:
        """log (pi_1, pi_2) of every filter, (2, B)."""
        odds = np.ones(batch) if outlier_odds is None else outlier_odds
        if not self.mixture.as_printed:
            odds = odds * self.mixture.weight / (1.0 - self.mixture.weight)
        return np.stack([-np.log1p(odds), np.log(odds) - np.log1p(odds)])
