"""Linear algebra on batches of small matrices, (B, rows, columns), for the reference filters.

Every function treats its filters apart: where one of them has no answer, its result
is NaN, nothing is raised and the others do not notice. Results have the arguments' precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def transpose(A: Array) -> Array:
    """Swap the last two axes."""
    return np.swapaxes(A, -1, -2)


def symmetric(A: Array) -> Array:
    """The symmetric part (A + A^T) / 2."""
    return 0.5 * (A + transpose(A))


def diagonal(d: Array) -> Array:
    """Diagonal matrices (B, m, m) of the rows of d (B, m)."""
    return d[:, :, None] * np.eye(d.shape[1], dtype=d.dtype)


def tria(*blocks: Array) -> Array:
    """Lower factor L with L L^T = A A^T and diagonal >= 0, A = [blocks side by side].

    A is (B, n, k) with k >= n; L is the transposed R of the QR decomposition of A^T.
    """
    upper = np.linalg.qr(transpose(np.concatenate(blocks, axis=-1)), mode="r")
    negative = np.diagonal(upper, axis1=-2, axis2=-1) < 0.0
    signs = np.where(negative, -1.0, 1.0).astype(upper.dtype)
    return transpose(upper) * signs[:, None, :]


def cholesky(P: Array) -> Array:
    """Lower factors of P, read from its lower triangle; NaN where P is not positive definite."""
    L = np.zeros_like(P)
    for j in range(P.shape[-1]):
        column = P[:, j:, j] - (L[:, j:, :j] @ L[:, j, :j, None])[:, :, 0]
        L[:, j:, j] = column / np.sqrt(np.where(column[:, :1] > 0.0, column[:, :1], np.nan))
    return L


def downdate(L: Array, v: Array) -> Array:
    """Lower factor of L L^T - v v^T, v (B, n); NaN where that is not positive definite."""
    L, v = L.copy(), v.copy()
    for j in range(L.shape[-1]):
        pivot, head = L[:, j, j].copy(), v[:, j].copy()
        squared = (pivot - head) * (pivot + head)
        c = np.sqrt(np.where(squared > 0.0, squared, np.nan)) / pivot
        s = head / pivot
        L[:, j:, j] = (L[:, j:, j] - s[:, None] * v[:, j:]) / c[:, None]
        v[:, j:] = c[:, None] * v[:, j:] - s[:, None] * L[:, j:, j]
    return L


def solve_lower(L: Array, b: Array) -> Array:
    """L^-1 b by forward substitution, b (B, m, k)."""
    x = np.zeros_like(b)
    for i in range(L.shape[-1]):
        x[:, i] = (b[:, i] - (L[:, i, None, :i] @ x[:, :i])[:, 0]) / L[:, i, i, None]
    return x


def solve_upper(L: Array, b: Array) -> Array:
    """L^-T b by backward substitution with the transpose of a lower factor, b (B, m, k)."""
    x = np.zeros_like(b)
    for i in reversed(range(L.shape[-1])):
        x[:, i] = (b[:, i] - (L[:, None, i + 1 :, i] @ x[:, i + 1 :])[:, 0]) / L[:, i, i, None]
    return x


def solve(A: Array, b: Array) -> Array:
    """A^-1 b for any square A, b (B, m, k); NaN where A is singular."""
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:  # one of them is singular: find out which
        if len(A) == 1:
            return np.full_like(b, np.nan)
        return np.concatenate([solve(A[i : i + 1], b[i : i + 1]) for i in range(len(A))])
