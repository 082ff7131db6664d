"""Prediction and correction of a filter that carries a lower factor S of its covariance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.filters.matrices import diagonal, downdate, solve_lower, solve_upper, transpose, tria
from kfenv.filters.sequential import carlson, one_by_one
from kfenv.filters.transforms import (
    Ensemble,
    StateFunction,
    extended,
    sigma_weights,
    unscented,
    wrap,
)

Array = NDArray[np.float64]


class Correction(NamedTuple):
    """A corrected state and the innovation that corrected it."""

    mean: Array  # (B, n)
    spread: Array  # (B, n, n) lower factor or covariance, whichever the filter carries
    innovation: Array  # (B, m)
    root: Array  # (B, m, m) lower factor C of the innovation covariance
    nis: Array  # (B,) normalised innovation squared


def transform(
    function: StateFunction, mean: Array, factor: Array, design: FilterDesign
) -> Ensemble:
    """Carry N(mean, factor factor^T) through the function.

    The weights go into the deviations, all but their signs, of which only the central
    one's can be negative.
    """
    if design.transform == "extended":
        return extended(function, mean, factor)
    points = unscented(function, mean, factor, sigma_weights(design, mean.shape[1], mean.dtype))
    root, signs = np.sqrt(np.abs(points.weights)), np.where(points.weights < 0.0, -1.0, 1.0)
    return Ensemble(
        points.mean, points.states * root, points.values * root, signs.astype(root.dtype)
    )


def start(factor: Array) -> Array:
    """What this form carries, from an initial lower factor (B, n, n)."""
    return factor.copy()


def spelled_out(factor: Array) -> Array:
    """The covariance (..., n, n) of what this form carries."""
    return factor @ transpose(factor)


def propagate(
    step: StateFunction, mean: Array, factor: Array, design: FilterDesign
) -> tuple[Array, Array]:
    """Mean (B, n) and lower factor (B, n, n) of the state dt later, without process noise.

    S0 eq 21 with the deviations of the propagated points (SPEC F5), the central one
    included in the stack or, where its weight is negative, taken out after it (F6).
    """
    points = transform(step, mean, factor, design)
    return points.mean, _stacked(points.values, points.weights, design)


def _stacked(deviations: Array, signs: Array, design: FilterDesign, *noise: Array) -> Array:
    """Lower factor of deviations signs deviations^T + noise noise^T."""
    if design.centre == "stacked":
        return tria(deviations, *noise)
    centre, others = deviations[:, :, 0], deviations[:, :, 1:]
    factor = tria(others, *noise)  # S0 eq 22 and 26: QR of the others, cholupdate by the centre
    return downdate(factor, centre) if signs[0] < 0.0 else tria(factor, centre[:, :, None])


def add_noise(root: Array, noise: Array, fading: Array, process_scale: Array) -> Array:
    """Lower factor of fading root root^T + process_scale noise noise^T; the scales are (B,)."""
    return tria(
        np.sqrt(fading)[:, None, None] * root, np.sqrt(process_scale)[:, None, None] * noise
    )


def correct(
    measure: StateFunction, mean: Array, factor: Array, z: Array, sd: Array, design: FilterDesign
) -> Correction:
    """Measurement update with z (B, m) and its noise deviations sd (B, m).

    With deviations X of the points and Z of their measurements, redrawn from the
    prediction: C = tria[Z, sqrt(R)], K = X Z^T C^-T C^-1. (The redrawn central point is the
    mean, so that its sign has no part in X Z^T.)
    """
    points = transform(measure, mean, factor, design)
    noise = diagonal(sd)
    root = _stacked(points.values, points.weights, design, noise)
    whitened_cross = solve_lower(root, points.values @ transpose(points.states))
    gain = transpose(solve_upper(root, whitened_cross))
    innovation = wrap(z - points.mean, measure.angles)
    whitened = solve_lower(root, innovation[:, :, None])
    posterior = mean + (gain @ innovation[:, :, None])[:, :, 0]
    if design.update == "classical":
        new_factor = factor
        for column in np.moveaxis(gain @ root, 2, 0):
            new_factor = downdate(new_factor, column)
    elif design.update == "joseph-exact":  # SPEC 9
        deviations = points.states - gain @ points.values
        new_factor = _stacked(deviations, points.weights, design, gain @ noise)
    elif design.update == "carlson":
        H = measure.jacobian(mean)
        posterior, new_factor = one_by_one(carlson, mean, factor, H, innovation, sd)
    elif design.update == "joseph-statistical":  # H of S0 eq 16: H S = Z X^T S^-T
        HS = transpose(solve_lower(factor, points.states @ transpose(points.values)))
        new_factor = tria(factor - gain @ HS, gain @ noise)
    else:  # S0 eq 32 with its missing transpose (SPEC F8)
        H = measure.jacobian(posterior if design.update == "joseph" else mean)
        new_factor = tria(factor - gain @ (H @ factor), gain @ noise)
    return Correction(posterior, new_factor, innovation, root, np.sum(whitened**2, axis=(1, 2)))
