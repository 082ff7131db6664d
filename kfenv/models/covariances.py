"""Covariances as users give them: a matrix, a diagonal, or what is none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ROUNDING = 1e-12  # of the largest variance: eigenvalues below count as zero


def positive_semidefinite_factor(name: str, given: ArrayLike, size: int) -> Array:
    """A lower factor (n, n) of a covariance that may be singular, with its zeros kept.

    Args:
        name: of the covariance, for complaints.
        given: (n, n), or (n,) its diagonal.
        size: n.

    Raises:
        ValueError: if it is no covariance.
    """
    P = covariance(name, given, size)
    least = ROUNDING * np.max(np.diagonal(P), initial=0.0)
    rest, L = P.copy(), np.zeros_like(P)
    for j in range(size):
        if rest[j, j] > least:
            L[j:, j] = rest[j:, j] / np.sqrt(rest[j, j])
            rest[j:, j:] -= np.outer(L[j:, j], L[j:, j])
    if np.abs(L @ L.T - P).max(initial=0.0) > 1e3 * least:
        raise ValueError(_indefinite(name, P, "must not have a negative eigenvalue"))
    return L


def positive_definite_factor(name: str, given: ArrayLike, size: int) -> Array:
    """The lower Cholesky factor (n, n) of a covariance.

    Raises:
        ValueError: if it is none, or singular.
    """
    P = covariance(name, given, size)
    try:
        return np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        raise ValueError(_indefinite(name, P, "must be positive definite")) from None


def deviations(name: str, given: ArrayLike, size: int) -> Array:
    """The standard deviations (n,) of a covariance without correlations.

    Raises:
        ValueError: if it is no covariance, is singular, or has correlations.
    """
    P = covariance(name, given, size)
    if np.any(P != np.diag(np.diagonal(P))):
        raise ValueError(
            f"{name} must be diagonal, since each channel is told a deviation of its own: multiply "
            f"h and the measurements by the inverse of its Cholesky factor, and give {name} = 1."
        )
    return np.diagonal(positive_definite_factor(name, P, size)).copy()


def covariance(name: str, given: ArrayLike, size: int) -> Array:
    """A symmetric, finite matrix (n, n), made of its diagonal where that alone is given.

    Raises:
        ValueError: naming what it has instead.
    """
    try:
        P = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {given!r}.") from None
    P = np.diag(P) if P.ndim == 1 else P.reshape(1, 1) if P.ndim == 0 else P
    if P.shape != (size, size):
        raise ValueError(
            f"{name} has shape {np.shape(given)}, expected ({size}, {size}), or ({size},) for its "
            "diagonal."
        )
    if not np.isfinite(P).all():
        raise ValueError(f"{name} holds NaN or infinity.")
    if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max():
        raise ValueError(f"{name} is not symmetric: give (P + P^T) / 2.")
    return 0.5 * (P + P.T)


def _indefinite(name: str, P: Array, must: str) -> str:
    least = np.linalg.eigvalsh(P)[0]
    return f"{name} {must}, and its smallest eigenvalue is {least:.3g}: correct its entries."
