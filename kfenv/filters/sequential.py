"""Measurement updates one channel at a time, of factors that need no covariance (S0 Table 3).

Written on components, so that they run on arrays of a batch, batch last, and as well on
arrays of objects that count the operations made on them. Each takes the state x (n, ...), the
row h (n, ...) of H, the variance r and the value z of one channel, and returns the corrected
state and factor. The published factors are upper triangular; these are their mirror images.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ScalarUpdate = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array]]


def bierman(x: Array, packed: Array, h: Array, r: Array, z: Array) -> tuple[Array, Array]:
    """Update P = L D L^T, L of unit diagonal, which holds D instead (Bierman 1977)."""
    n = len(x)
    x, packed = x.copy(), packed.copy()
    residual = z - dot(h, x)
    f = [h[i] + dot(packed[i + 1 :, i], h[i + 1 :]) if i < n - 1 else h[i] for i in range(n)]
    alpha, inverse, gain = r, None, [None] * n
    for i in reversed(range(n)):
        v = packed[i, i] * f[i]
        before, turn = alpha, None if inverse is None else f[i] * inverse
        alpha = alpha + f[i] * v
        inverse = 1.0 / alpha
        packed[i, i] = packed[i, i] * (before * inverse)
        for k in range(i + 1, n):
            former, gain[k] = gain[k], gain[k] + v * packed[k, i]
            packed[k, i] = packed[k, i] - turn * former
        gain[i] = v
    return _moved(x, gain, residual * inverse), packed


def carlson(x: Array, factor: Array, h: Array, r: Array, z: Array) -> tuple[Array, Array]:
    """Update P = S S^T, S lower triangular (Carlson 1973)."""
    n = len(x)
    x, factor = x.copy(), factor.copy()
    residual = z - dot(h, x)
    f = [dot(factor[i:, i], h[i:]) for i in range(n)]
    alpha, gain = r, [None] * n
    for i in reversed(range(n)):
        before, alpha = alpha, alpha + f[i] * f[i]
        shrink = np.sqrt(before / alpha)
        spill = f[i] / (alpha * shrink)
        for k in range(i + 1, n):
            former, gain[k] = gain[k], gain[k] + f[i] * factor[k, i]
            factor[k, i] = shrink * factor[k, i] - spill * former
        gain[i] = f[i] * factor[i, i]
        factor[i, i] = shrink * factor[i, i]
    return _moved(x, gain, residual / alpha), factor


def one_by_one(
    update: ScalarUpdate, mean: Array, factor: Array, H: Array, innovation: Array, sd: Array
) -> tuple[Array, Array]:
    """Correct means (B, n) and factors (B, n, n) by all channels of an innovation (B, m).

    The function is linearised once, H (B, m, n); noise of deviations sd (B, m) is
    uncorrelated, so that the order of the channels is of no account.
    """
    moved = np.zeros_like(mean.T)
    factor = np.ascontiguousarray(np.moveaxis(factor, 0, -1))
    for row, deviation, value in zip(np.moveaxis(H, 0, -1), sd.T, innovation.T, strict=True):
        moved, factor = update(moved, factor, row, deviation * deviation, value)
    return mean + moved.T, np.ascontiguousarray(np.moveaxis(factor, -1, 0))


def dot(a: Array, b: Array) -> Array:
    """Sum of products, which starts from the first of them."""
    total = a[0] * b[0]
    for left, right in zip(a[1:], b[1:], strict=True):
        total = total + left * right
    return total


def _moved(x: Array, gain: list, residual: Array) -> Array:
    for i, entry in enumerate(gain):
        x[i] = x[i] + entry * residual
    return x
