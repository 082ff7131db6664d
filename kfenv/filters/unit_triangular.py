"""Prediction and correction of a filter that carries L and D, P = L D L^T (Bierman, Thornton).

L is lower triangular with a diagonal of ones, in whose place the matrices here hold D: the
mirror image of the published U D U^T. Only the factor of the innovation covariance, which is
for telling, takes a square root. For linearised models.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.filters.matrices import diagonal, solve_lower, transpose, tria
from kfenv.filters.sequential import bierman, one_by_one
from kfenv.filters.square_root import Correction
from kfenv.filters.transforms import StateFunction, linearised, wrap

Array = NDArray[np.float64]


def start(factor: Array) -> Array:
    """What this form carries, from an initial lower factor (B, n, n)."""
    scale = np.diagonal(factor, axis1=1, axis2=2)
    with np.errstate(all="ignore"):  # what fails is told by the status
        return _pack(factor / scale[:, None, :], scale**2)


def spelled_out(packed: Array) -> Array:
    """The covariance (..., n, n) of what this form carries."""
    L, D = _unpack(packed)
    return (L * D[..., None, :]) @ transpose(L)


def propagate(
    step: StateFunction, mean: Array, packed: Array, design: FilterDesign
) -> tuple[Array, Array]:
    """Mean (B, n) and L and D (B, n, n) of the state dt later, without process noise."""
    value, J = linearised(step, mean)
    L, D = _unpack(packed)
    return value, orthogonalise(J @ L, D)


def add_noise(root: Array, noise: Array, fading: Array, process_scale: Array) -> Array:
    """L and D of fading times the propagated covariance + process_scale noise noise^T."""
    L, D = _unpack(root)
    weights = fading[:, None] * D, process_scale[:, None] * np.ones_like(D)
    return orthogonalise(np.concatenate([L, noise], axis=2), np.concatenate(weights, axis=1))


def correct(
    measure: StateFunction, mean: Array, packed: Array, z: Array, sd: Array, design: FilterDesign
) -> Correction:
    """Measurement update with z (B, m) and its noise deviations sd (B, m), channel by channel."""
    value, H = linearised(measure, mean)
    L, D = _unpack(packed)
    innovation = wrap(z - value, measure.angles)
    root = tria(H @ (L * np.sqrt(D)[:, None, :]), diagonal(sd))
    whitened = solve_lower(root, innovation[:, :, None])
    posterior, new = one_by_one(bierman, mean, packed, H, innovation, sd)
    return Correction(posterior, new, innovation, root, np.sum(whitened**2, axis=(1, 2)))


def orthogonalise(A: Array, weights: Array) -> Array:
    """L and D with L D L^T = A diag(weights) A^T, (B, n, k) and (B, k).

    Modified weighted Gram-Schmidt (Thornton 1976). A direction without any weight, whose D
    is zero, leaves zeros below it in L.
    """
    A, packed = A.copy(), np.zeros((*A.shape[:2], A.shape[1]), A.dtype)
    for i in range(A.shape[1]):
        weighted = A[:, i] * weights
        d = np.sum(A[:, i] * weighted, axis=1)
        projections = (A[:, i + 1 :] @ weighted[:, :, None])[:, :, 0]
        below = projections / np.where(d == 0.0, np.inf, d)[:, None]
        A[:, i + 1 :] -= below[:, :, None] * A[:, i, None]
        packed[:, i, i], packed[:, i + 1 :, i] = d, below
    return packed


def _pack(L: Array, D: Array) -> Array:
    packed = L.copy()
    states = np.arange(D.shape[1])
    packed[:, states, states] = D
    return packed


def _unpack(packed: Array) -> tuple[Array, Array]:
    """L (..., n, n) with its diagonal of ones, and D (..., n)."""
    L, states = packed.copy(), np.arange(packed.shape[-1])
    L[..., states, states] = 1.0
    return L, np.diagonal(packed, axis1=-2, axis2=-1)
