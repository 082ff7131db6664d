"""Moment matching for banks of filters: many Gaussians into few, compiled, eight rows at a time.

Covariances are summed about each mixture's own mean, so that nothing large is subtracted,
and factored anew by Cholesky. Where rounding leaves a pivot that is not positive, the
weighted factors themselves are triangularised instead, which always works.
"""

from __future__ import annotations

from math import sqrt as root_of

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.models.namespaces import lanes
from kfenv.models.namespaces.compiled import FLOATING_POINT, wrap
from kfenv.models.namespaces.lanes import LANES, load, spread, store, where_greater

Array = NDArray[np.float64]

NEARLY_ONE = 1.0 - 1.2e-16  # only 1 is greater


def mix(
    weights: Array, mean: Array, factor: Array, is_angle: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The Gaussians with the moments of J mixtures of the same C components.

    x_j = sum_i w_ij m_i and P_j = sum_i w_ij (P_i + (m_i - x_j)(m_i - x_j)^T), angles as
    offsets from the heaviest component (Blom and Bar-Shalom 1988; SPEC section 10). A
    mixture of one component is that component, to the bit.

    Args:
        weights: (B, C, J), each mixture's of sum 1. A component without any weight may hold
            anything.
        mean, factor: of the components, (B, C, n) and lower (B, C, n, n).
        is_angle: (n,) which states are angles.

    Returns:
        Means (B, J, n) and lower factors (B, J, n, n).
    """
    batch, components, targets = weights.shape
    n = mean.shape[2]
    new_mean, new_factor = np.empty((batch, targets, n)), np.zeros((batch, targets, n, n))
    size = n * (n + 1) // 2
    scratch = tuple(
        np.zeros((rows, LANES))
        for rows in (
            components * targets, components * n, components * size, components * size,
            n, n, size, size, 1,
        )
    )  # fmt: skip
    _mix(weights, mean, factor, is_angle, *scratch, new_mean, new_factor)
    return new_mean, new_factor


@njit(cache=True, **FLOATING_POINT)
def _mix(weights, mean, factor, is_angle, w, d, L, P, centre, shift, total, S, sound,
         new_mean, new_factor):  # fmt: skip
    """Scratch rows: weights, offsets, packed factors and covariances of the components; the
    centre; one mixture's mean offset, covariance and factor, and whether its pivots are sound."""
    batch, components, targets = weights.shape
    n = mean.shape[2]
    for first in range(0, batch, LANES):
        _gather(weights, mean, factor, first, w, d, L)
        _take_offsets(w, components, targets, is_angle, d, centre)
        for i in range(components):
            _square(L, P, i, n)
        for j in range(targets):
            _moments(w, d, P, components, targets, j, n, shift, total)
            _factorise(total, S, sound, n)
            _prefer_single(w, L, S, components, targets, j, n)
            for k in range(n):
                value = load(centre, k) + load(shift, k)
                store(shift, k, wrap(value) if is_angle[k] else value)
            for lane in range(min(LANES, batch - first)):
                b = first + lane
                _scatter(shift, S, lane, new_mean[b, j], new_factor[b, j])
                if not sound[0, lane] > 0.5 and not _is_single(weights[b, :, j]):
                    _triangularise(weights[b, :, j], mean[b], new_mean[b, j], is_angle,
                                   factor[b], new_factor[b, j])  # fmt: skip


@njit(**FLOATING_POINT)
def _gather(weights, mean, factor, first, w, d, L):
    """Lane l takes row first + l, the last row fills up; what has no weight becomes zero."""
    batch, components, targets = weights.shape
    n = mean.shape[2]
    for lane in range(LANES):
        b = min(first + lane, batch - 1)
        for i in range(components):
            used = False
            for j in range(targets):
                w[i * targets + j, lane] = weights[b, i, j]
                used |= weights[b, i, j] > 0.0
            at = i * (n * (n + 1) // 2)
            for row in range(n):
                d[i * n + row, lane] = mean[b, i, row] if used else 0.0
                for column in range(row + 1):
                    L[at, lane] = factor[b, i, row, column] if used else 0.0
                    at += 1


@njit(**FLOATING_POINT)
def _take_offsets(w, components, targets, is_angle, d, centre):
    """Turn the means in d into offsets from the heaviest component, the centre."""
    n = len(is_angle)
    heaviest = spread(-1.0)
    for i in range(components):
        total = spread(0.0)
        for j in range(targets):
            total = total + load(w, i * targets + j)
        for k in range(n):
            here = load(d, i * n + k)
            store(centre, k, where_greater(total, heaviest, here, load(centre, k)))
        heaviest = where_greater(total, heaviest, total, heaviest)
    for i in range(components):
        for k in range(n):
            offset = load(d, i * n + k) - load(centre, k)
            store(d, i * n + k, wrap(offset) if is_angle[k] else offset)


@njit(**FLOATING_POINT)
def _square(L, P, i, n):
    """Covariance P_i := L_i L_i^T, both packed by rows of the lower triangle."""
    start = i * (n * (n + 1) // 2)
    at = start
    for row in range(n):
        for column in range(row + 1):
            total = spread(0.0)
            for k in range(column + 1):
                left = load(L, start + row * (row + 1) // 2 + k)
                total = total + left * load(L, start + column * (column + 1) // 2 + k)
            store(P, at, total)
            at += 1


@njit(**FLOATING_POINT)
def _moments(w, d, P, components, targets, j, n, shift, total):
    """Mean offset and packed covariance of mixture j."""
    size = n * (n + 1) // 2
    for k in range(n):
        value = spread(0.0)
        for i in range(components):
            value = value + load(w, i * targets + j) * load(d, i * n + k)
        store(shift, k, value)
    for k in range(size):
        store(total, k, spread(0.0))
    for i in range(components):
        weight, at = load(w, i * targets + j), 0
        for row in range(n):
            scaled = weight * (load(d, i * n + row) - load(shift, row))
            for column in range(row + 1):
                off = load(d, i * n + column) - load(shift, column)
                value = load(total, at) + weight * load(P, i * size + at)
                store(total, at, value + scaled * off)
                at += 1


@njit(**FLOATING_POINT)
def _factorise(total, S, sound, n):
    """Packed Cholesky factor; `sound` is 1 in lanes all of whose pivots are positive."""
    store(sound, 0, spread(1.0))
    for row in range(n):
        start = row * (row + 1) // 2
        for column in range(row + 1):
            other = column * (column + 1) // 2
            value = load(total, start + column)
            for k in range(column):
                value = value - load(S, start + k) * load(S, other + k)
            if column < row:
                store(S, start + column, value / load(S, other + column))
            else:
                store(S, start + row, lanes.sqrt(where_greater(value, 0.0, value, 1.0)))
                store(sound, 0, where_greater(value, 0.0, load(sound, 0), 0.0))


@njit(**FLOATING_POINT)
def _prefer_single(w, L, S, components, targets, j, n):
    """Where one component has all the weight, take its factor as it is."""
    size = n * (n + 1) // 2
    for i in range(components):
        weight = load(w, i * targets + j)
        if not _any_single(w, i * targets + j):
            continue
        for k in range(size):
            value = where_greater(weight, NEARLY_ONE, load(L, i * size + k), load(S, k))
            store(S, k, value)


@njit(**FLOATING_POINT)
def _any_single(w, row):
    for lane in range(LANES):
        if w[row, lane] > NEARLY_ONE:
            return True
    return False


@njit(**FLOATING_POINT)
def _is_single(weights):
    for i in range(len(weights)):
        if weights[i] > NEARLY_ONE:
            return True
    return False


@njit(**FLOATING_POINT)
def _scatter(mean, S, lane, new_mean, new_factor):
    at = 0
    for row in range(len(new_mean)):
        new_mean[row] = mean[row, lane]
        for column in range(row + 1):
            new_factor[row, column] = S[at, lane]
            at += 1


@njit(**FLOATING_POINT)
def _triangularise(weights, mean, centre, is_angle, factor, L):
    """L := tria[sqrt(w_i) L_i, sqrt(w_i) (m_i - x)], by Householder reflections."""
    components, n = mean.shape
    A = np.zeros((n, components * (n + 1)))
    for i in range(components):
        if not weights[i] > 0.0:
            continue
        scale = root_of(weights[i])
        for row in range(n):
            for column in range(row + 1):
                A[row, i * n + column] = scale * factor[i, row, column]
            off = mean[i, row] - centre[row]
            A[row, components * n + i] = scale * (wrap(off) if is_angle[row] else off)
    for i in range(n):
        norm = root_of(np.sum(A[i, i:] ** 2))
        L[i, i] = norm
        sign = -1.0 if A[i, i] < 0.0 else 1.0
        scale = norm * (norm + abs(A[i, i]))
        A[i, i] += sign * norm
        for k in range(i + 1, n):
            if scale > 0.0:
                A[k, i:] -= np.sum(A[k, i:] * A[i, i:]) / scale * A[i, i:]
            L[k, i] = -sign * A[k, i]
