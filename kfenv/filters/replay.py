"""Whole recordings through a filter that predicts and updates, with or without fading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.fading import Fading, fading_factor, second_moment
from kfenv.filters.matrices import cholesky, symmetric, transpose, tria
from kfenv.filters.protocol import Episodes, Filter, Knobs, Measurement, elapsed, measured
from kfenv.filters.results import (
    BAD_PREDICTION,
    NOT_POSITIVE_DEFINITE,
    OK,
    History,
    Prediction,
    Update,
    blame,
)

Array = NDArray[np.float64]
Status = NDArray[np.int64]


def replay(
    tier: Filter,
    rule: Fading | None,
    episodes: Episodes,
    knobs: Knobs | None = None,
    keep: bool = True,
) -> History:
    """Filter episodes step by step, as `Filter.run` does.

    Args:
        tier: a filter in square-root form; for a robust rule a `GaussianSum`.
        rule: adaptive fading on top of the constant knob, or None.
        keep: whether to keep factors and covariances; they are None otherwise.
    """
    batch, steps, m = episodes.measurement.shape
    knobs = knobs or Knobs.nominal(batch)
    mean, factor = episodes.mean, episodes.factor
    status, failed_at = np.zeros(batch, np.int64), np.full(batch, -1)
    means = np.full((batch, steps, mean.shape[1]), np.nan)
    nis = np.full((batch, steps), np.nan)
    factors = np.full((batch, steps, *factor.shape[1:]), np.nan) if keep else None
    dt = elapsed(episodes)
    moment = np.full((batch, m), np.nan)
    for t in range(steps):
        if t == 0:
            prediction = Prediction(mean.copy(), factor.copy(), np.zeros_like(factor))
            blame(status, BAD_PREDICTION, mean, factor)
        else:
            inputs = episodes.motion_inputs[:, t].copy()
            prediction = tier.predict(mean, factor, inputs, dt[:, t].copy(), status)
        pending = prediction, knobs, measured(episodes, t), status
        if rule is None or np.isnan(episodes.measurement[:, t]).all():
            told = tier.update(*pending)
        else:
            told, moment = faded_update(tier, rule, *pending, moment)
        mean, factor = told.mean, told.factor
        failed_at[(status != OK) & (failed_at < 0)] = t
        sound = status == OK
        means[sound, t], nis[sound, t] = mean[sound], told.nis[sound]
        if keep:
            factors[sound, t] = factor[sound]
    with np.errstate(over="ignore"):  # of a filter that has long diverged
        covariances = factors @ transpose(factors) if keep else None
    return History(means, nis, status, failed_at, covariances, factors)


def faded_update(
    tier: Filter,
    rule: Fading,
    prediction: Prediction,
    knobs: Knobs,
    measurement: Measurement,
    status: Status,
    moment: Array,
) -> tuple[Update, Array]:
    """Find the fading factor from the unfaded innovation, apply it, update.

    Args:
        moment: V (B, m) so far, NaN in channels that have not arrived yet.

    Returns:
        The update, and V with this innovation taken in.
    """
    nominal = None
    if rule.v_mode == "robust":
        looked, nominal = tier.nominal_probability(prediction, knobs, measurement, status)
    else:
        looked = tier.innovate(prediction, knobs, measurement, status)
    with np.errstate(all="ignore"):  # what has failed holds anything
        moment = second_moment(rule, moment, looked.innovation, looked.variance, nominal)
        factor = fading_factor(rule, moment, looked.variance, measurement.noise)
        factor = np.where(status == OK, factor, 1.0)
    if rule.applied == "twice":
        return _faded_twice(tier, prediction, factor, knobs, measurement, status), moment
    if rule.applied == "raw-moment":
        prediction = _with_raw_moment(prediction, factor)
    knobs = knobs._replace(fading=knobs.fading * factor)
    return tier.update(prediction, knobs, measurement, status), moment


def _with_raw_moment(prediction: Prediction, factor: Array) -> Prediction:
    """Let factor P become factor (P + m m^T) - m m^T, eq 40 as printed (SPEC 6)."""
    excess = np.sqrt(1.0 - 1.0 / factor)[:, None] * prediction.mean
    return prediction._replace(root=tria(prediction.root, excess[:, :, None]))


def _faded_twice(
    tier: Filter, prediction: Prediction, factor: Array, knobs: Knobs, measurement: Measurement,
    status: Status,
) -> Update:  # fmt: skip
    """lambda on P^-, and on P_yy and P_xy again; then P = P^- - K P_yy K^T (eq 35, 41, 42).

    P_yy and P_xy are those of lambda P^-, and its update by the tier is
    lambda P^- - K P_yy K^T: what is printed lies (lambda - 1) P^- below.
    """
    root = np.sqrt(knobs.fading * factor)[:, None, None] * prediction.root
    noise = np.sqrt(knobs.process_scale)[:, None, None] * prediction.noise
    predicted = tria(root, noise)
    once = Prediction(prediction.mean, predicted, np.zeros_like(predicted))
    told = tier.update(once, Knobs(factor, np.ones_like(factor)), measurement, status)
    excess = (factor - 1.0)[:, None, None] * (predicted @ transpose(predicted))
    with np.errstate(all="ignore"):
        covariance = told.factor @ transpose(told.factor) - excess
        changed = (factor > 1.0)[:, None, None]
        lower = np.where(changed, cholesky(symmetric(covariance)), told.factor)
    blame(status, NOT_POSITIVE_DEFINITE, lower)
    return told._replace(factor=lower)
