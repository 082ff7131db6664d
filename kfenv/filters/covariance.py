"""Prediction and correction of a filter that carries its full covariance P."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.filters.matrices import cholesky, diagonal, solve, symmetric, transpose
from kfenv.filters.square_root import Correction
from kfenv.filters.transforms import (
    Ensemble,
    StateFunction,
    linearised,
    sigma_weights,
    unscented,
    wrap,
)

Array = NDArray[np.float64]


class Moments(NamedTuple):
    """What a Gaussian becomes behind a function, and how that was found."""

    mean: Array  # (B, m)
    covariance: Array  # (B, m, m)
    cross: Array  # (B, n, m) covariance of the state with the value
    jacobian: Array | None  # (B, m, n) of the extended transform
    points: Ensemble | None  # of the sigma-point transforms


def moments(
    function: StateFunction, mean: Array, covariance: Array, design: FilterDesign
) -> Moments:
    """Carry N(mean, covariance) through the function.

    NaN where sigma points need a root and the covariance is not positive definite.
    """
    if design.transform == "extended":
        value, J = linearised(function, mean)
        return Moments(value, J @ covariance @ transpose(J), covariance @ transpose(J), J, None)
    weights = sigma_weights(design, mean.shape[1], mean.dtype)
    points = unscented(function, mean, cholesky(covariance), weights)
    weighted = points.values * points.weights
    return Moments(
        points.mean,
        weighted @ transpose(points.values),
        points.states @ transpose(weighted),
        None,
        points,
    )


def start(factor: Array) -> Array:
    """What this form carries, from an initial lower factor (B, n, n)."""
    return factor @ transpose(factor)


def spelled_out(covariance: Array) -> Array:
    """The covariance (..., n, n) of what this form carries."""
    return covariance


def propagate(
    step: StateFunction, mean: Array, covariance: Array, design: FilterDesign
) -> tuple[Array, Array]:
    """Mean (B, n) and covariance (B, n, n) of the state dt later, without process noise."""
    return moments(step, mean, covariance, design)[:2]


def add_noise(propagated: Array, noise: Array, fading: Array, process_scale: Array) -> Array:
    """fading propagated + process_scale noise noise^T; the scales are (B,)."""
    Q = noise @ transpose(noise)
    return fading[:, None, None] * propagated + process_scale[:, None, None] * Q


def correct(
    measure: StateFunction,
    mean: Array,
    covariance: Array,
    z: Array,
    sd: Array,
    design: FilterDesign,
) -> Correction:
    """Measurement update with z (B, m) and its noise deviations sd (B, m)."""
    R = diagonal(sd**2)
    predicted = moments(measure, mean, covariance, design)
    Pzz = predicted.covariance + R
    # The gain takes all of Pzz, not one triangle: unsymmetrised filters go on as printed.
    gain = transpose(solve(transpose(Pzz), transpose(predicted.cross)))
    innovation = wrap(z - predicted.mean, measure.angles)
    nis = np.sum(innovation * solve(Pzz, innovation[:, :, None])[:, :, 0], axis=1)
    posterior = mean + (gain @ innovation[:, :, None])[:, :, 0]
    H = predicted.jacobian
    if design.update == "joseph":
        H = measure.jacobian(posterior)
    elif design.update == "joseph-prior" and H is None:
        H = measure.jacobian(mean)
    elif design.update in ("joseph-statistical", "joseph-omega"):  # S0 eq 16
        H = transpose(solve(transpose(covariance), predicted.cross))
    if design.update == "joseph-omega":
        R = Pzz - H @ covariance @ transpose(H)
    new = _corrected(design.update, covariance, gain, Pzz, R, H, predicted.points)
    return Correction(posterior, new, innovation, cholesky(symmetric(Pzz)), nis)


def _corrected(
    update: str, P: Array, K: Array, Pzz: Array, R: Array, H: Array | None, points: Ensemble | None
) -> Array:
    """The posterior covariance by one of the forms of `FilterDesign`."""
    if update == "classical":
        return symmetric(P - K @ Pzz @ transpose(K))
    if update == "unsymmetrised":
        return P - K @ Pzz @ transpose(K)
    if update == "khp":
        return P - K @ (H @ P)
    if update == "joseph-exact":
        D = points.states - K @ points.values
        return (D * points.weights) @ transpose(D) + K @ R @ transpose(K)
    G = np.eye(P.shape[-1], dtype=P.dtype) - K @ H
    return G @ P @ transpose(G) + K @ R @ transpose(K)
