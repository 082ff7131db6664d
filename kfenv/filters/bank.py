"""A bank of filters that differ in their knobs: the interacting multiple model.

Blom and Bar-Shalom (1988), SPEC section 10. Each filter of the bank believes one mode; the
modes follow a Markov chain, and before each prediction every filter starts from the mixture
of all that its mode may have come from. A bank of one mode is its filter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from kfenv.filters.gaussian_sum import Mixture
from kfenv.filters.mixing import mix
from kfenv.filters.protocol import Episodes, Filter, Knobs, Measurement, Status, elapsed, measured
from kfenv.filters.results import BAD_PREDICTION, BAD_UPDATE, OK, History, Prediction, blame

Array = NDArray[np.float64]
Transition = Callable[[float], Array]

LEAST_WEIGHT = 1e-12  # of a sound filter, so that none is ruled out for ever


class Mode(NamedTuple):
    """What one filter of a bank believes, as the environments' knobs say it."""

    noise: float = 1.0  # factor of the told noise's deviation
    process_noise: float = 1.0  # factor of the process noise's covariance
    fading: float = 1.0  # factor of the propagated covariance


class Components(NamedTuple):
    """Posterior of C = modes times hypotheses, hypotheses of a mode side by side."""

    weight: Array  # (B, C), of sum 1
    mean: Array  # (B, C, n)
    factor: Array  # (B, C, n, n)
    innovation: Array  # (B, C, m), NaN in channels that are missing
    variance: Array  # (B, C, m) of the innovation
    nis: Array  # (B,) mean of the components', NaN if nothing arrived


class Mixed(NamedTuple):
    """The estimate, and what the bank's filters start the next prediction from."""

    mean: Array  # (B, n)
    factor: Array  # (B, n, n)
    means: Array  # (B, K, n)
    factors: Array  # (B, K, n, n)
    probability: Array  # (B, K) of the modes at the next instant


def markov(rates: Array) -> Transition:
    """Transition matrices (K, K) of a chain by the seconds that pass: exp(generator dt).

    Args:
        rates: (K, K) of switching from the row's mode to the column's, 1/s; the diagonal is
            not looked at.

    Raises:
        ValueError: if a rate is negative or not finite.
    """
    rates = np.array(rates, dtype=np.float64)
    np.fill_diagonal(rates, 0.0)
    if not (np.all(np.isfinite(rates)) and np.all(rates >= 0.0)):
        raise ValueError(f"Switching rates must be non-negative numbers, got {rates.tolist()}.")
    generator = rates - np.diag(rates.sum(axis=1))

    @cache
    def of_nanoseconds(dt: int) -> Array:
        return np.maximum(expm(generator * (1e-9 * dt)), 0.0)

    return lambda dt: of_nanoseconds(round(1e9 * dt))


class Bank:
    """Filters over one compiled or reference filter, a mode each, and a Markov chain of modes.

    Args:
        tier: `Engine`, or a `ReferenceFilter` in square-root form.
        modes: K of them.
        transition: (K, K) probabilities of going from the row's mode to the column's in one
            filter step, or a function that gives them for dt seconds, such as `markov` does.
        mixture: outliers that may strike any measurement anew: each mode then updates under
            both of its hypotheses.

    Raises:
        ValueError: if modes or transition are none, or do not fit each other.
    """

    def __init__(
        self,
        tier: Filter,
        modes: Sequence[Mode],
        transition: Array | Transition,
        mixture: Mixture | None = None,
    ) -> None:
        self.tier, self.modes = tier, tuple(modes)
        fixed = None if callable(transition) else np.array(transition, dtype=np.float64)
        self.transition = transition if callable(transition) else lambda dt: fixed
        _check(self.modes, self.transition(1.0))
        shares, factors = [1.0], [1.0]
        if mixture is not None:
            shares, factors = [1.0 - mixture.weight, mixture.weight], [1.0, mixture.ratio**0.5]
        self._shares, self._factors = np.array(shares), np.array(factors)
        self._noise, self._process_noise, self._fading = np.array(self.modes, dtype=float).T
        self._is_angle = np.array([state.angle for state in tier.motion.states])

    @property
    def noise_factors(self) -> Array:
        """Factors (C,) of the told noise's deviation that the components believe."""
        return np.outer(self._noise, self._factors).ravel()

    def knobs(self, batch: int) -> Knobs:
        """Of all filters, B K rows."""
        return Knobs(np.tile(self._fading, batch), np.tile(self._process_noise, batch))

    def start(self, mean: Array, factor: Array) -> Prediction:
        """All filters (B K rows) at the initial state (B, n), (B, n, n), as if predicted."""
        count = len(self.modes)
        root = np.repeat(factor, count, axis=0)
        return Prediction(np.repeat(mean, count, axis=0), root, np.zeros_like(root))

    def predict(self, mixed: Mixed, inputs: Array, dt: Array, status: Status) -> Prediction:
        """Time update of all filters (B K rows) over dt (B,) seconds with known inputs (B, p)."""
        count, n = len(self.modes), mixed.mean.shape[1]
        work = np.repeat(status, count)
        prediction = self.tier.predict(
            mixed.means.reshape(-1, n), mixed.factors.reshape(-1, n, n),
            np.repeat(inputs, count, axis=0), np.repeat(dt, count), work,
        )  # fmt: skip
        _mark(prediction, work)
        return prediction

    def update(
        self,
        prediction: Prediction,
        probability: Array,
        measurement: Measurement,
        status: Status,
        log_likelihood: Array | None = None,
    ) -> Components:
        """Update every filter under every hypothesis, and weigh them by their likelihoods.

        Args:
            prediction: of B K rows.
            probability: (B, K) of the modes before the measurement.
            measurement: its noise (B, m) is common to all modes, or (B, K, m) each mode's;
                the mode's own factor comes on top.
            status: (B,); a bank none of whose filters is sound fails.
            log_likelihood: (B, K) of the modes, where the caller knows better.
        """
        batch, count, size = len(status), len(self.modes), len(self._shares)
        noise = measurement.noise
        noise = (noise if noise.ndim == 3 else noise[:, None]) * self._noise[:, None]
        inputs, value = (np.repeat(a, count, axis=0) for a in measurement[:2])
        knobs = self.knobs(batch)
        told, log_weight = [], np.empty((batch, count, size))
        for h in range(size):
            work = np.where(np.isfinite(prediction.mean[:, 0]), 0, BAD_PREDICTION)
            rows = (noise * self._factors[h]).reshape(batch * count, -1)
            told.append(self.tier.update(prediction, knobs, Measurement(inputs, value, rows), work))
            likelihood = told[h].log_likelihood.reshape(batch, count)
            likelihood = likelihood if log_likelihood is None else log_likelihood
            with np.errstate(divide="ignore"):
                log_weight[..., h] = np.log(probability) + likelihood + np.log(self._shares[h])
            failed = (work != OK).reshape(batch, count)
            log_weight[..., h][failed] = -np.inf
            reason = np.where(failed.all(axis=1), work.reshape(batch, count)[:, 0], BAD_UPDATE)
        weight = _normalised(log_weight.reshape(batch, -1), status, reason)
        mean, factor, innovation, variance, nis = (
            np.stack(
                [getattr(one, name).reshape(batch, count, *shape) for one in told], axis=2
            ).reshape(batch, count * size, *shape)
            for name in ("mean", "factor", "innovation", "variance", "nis")
            for shape in [getattr(told[0], name).shape[1:]]
        )
        weighed = np.sum(weight * np.where(weight > 0.0, nis, 0.0), axis=1)
        return Components(weight, mean, factor, innovation, variance, weighed)

    def _transitions(self, dt: Array) -> Array:
        """Of each episode's seconds (B,): (K, K) where all are the same, else (B, K, K)."""
        if (dt == dt[0]).all():
            return self.transition(dt[0])
        return np.stack([self.transition(passed) for passed in dt])

    def mix(self, components: Components, transition: Array) -> Mixed:
        """The estimate of all components, and each mode's start of the next prediction.

        Args:
            transition: (K, K), or each episode's (B, K, K).
        """
        batch, count = len(components.weight), len(self.modes)
        split = components.weight.reshape(batch, count, -1)
        joint = split[..., None] * transition[..., :, None, :]  # (B, K, H, K)
        probability = joint.sum(axis=(1, 2))
        weights = np.empty((batch, split.shape[1] * split.shape[2], count + 1))
        with np.errstate(invalid="ignore"):
            weights[..., :count] = joint.reshape(batch, -1, count) / probability[:, None]
        weights[..., count] = components.weight
        weights = np.nan_to_num(weights)  # a mode that nothing leads to starts from nothing
        means, factors = mix(weights, components.mean, components.factor, self._is_angle)
        return Mixed(means[:, -1], factors[:, -1], means[:, :-1], factors[:, :-1], probability)

    def history(self, episodes: Episodes) -> History:
        """Filter whole episodes, all modes alike at the first instant."""
        batch, steps = episodes.measurement.shape[:2]
        n = episodes.mean.shape[1]
        status, failed_at = np.zeros(batch, np.int64), np.full(batch, -1)
        means, factors = np.full((batch, steps, n), np.nan), np.full((batch, steps, n, n), np.nan)
        nis = np.full((batch, steps), np.nan)
        prediction = self.start(episodes.mean, episodes.factor)
        probability = np.full((batch, len(self.modes)), 1.0 / len(self.modes))
        dt = np.roll(elapsed(episodes), -1, axis=1)  # until the next instant, 0 at the last
        for t in range(steps):
            components = self.update(prediction, probability, measured(episodes, t), status)
            mixed = self.mix(components, self._transitions(dt[:, t]))
            probability = mixed.probability
            blame(status, BAD_UPDATE, mixed.mean, mixed.factor)
            failed_at[(status != OK) & (failed_at < 0)] = t
            sound = status == OK
            means[sound, t], factors[sound, t] = mixed.mean[sound], mixed.factor[sound]
            nis[sound, t] = components.nis[sound]
            if t + 1 < steps:
                inputs = episodes.motion_inputs[:, t + 1].copy()
                prediction = self.predict(mixed, inputs, dt[:, t].copy(), status)
        return History(means, nis, status, failed_at, factors @ factors.swapaxes(-1, -2), factors)


def _check(modes: tuple[Mode, ...], transition: Array) -> None:
    """Complain about modes and transition probabilities that are none."""
    if not modes or not np.all(np.array(modes, dtype=float) > 0.0):
        raise ValueError(f"A bank needs at least one mode, of positive factors, got {modes}.")
    if transition.shape != (len(modes), len(modes)):
        raise ValueError(
            f"{len(modes)} modes need a transition matrix of shape {(len(modes),) * 2}, got "
            f"{transition.shape}."
        )
    if np.any(transition < 0.0) or not np.allclose(transition.sum(axis=1), 1.0):
        raise ValueError(
            "Each row of a transition matrix holds probabilities of sum 1, got "
            f"{transition.tolist()}."
        )


def _mark(prediction: Prediction, work: Status) -> None:
    """NaN in the rows that failed, whose numbers mean nothing."""
    prediction.mean[work != OK] = np.nan


def _normalised(log_weight: Array, status: Status, reason: Status) -> Array:
    """Weights of sum 1; a bank without any sound component fails for the reason given."""
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight)
    most = log_weight.max(axis=1, keepdims=True)
    lost = ~np.isfinite(most[:, 0])
    status[lost & (status == OK)] = reason[lost & (status == OK)]
    weight = np.exp(log_weight - np.where(lost[:, None], 0.0, most))
    sound = np.isfinite(log_weight)
    weight = np.where(sound, np.maximum(weight / _sum(weight), LEAST_WEIGHT), 0.0)
    return weight / _sum(weight)


def _sum(weight: Array) -> Array:
    total = weight.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, total, 1.0)
