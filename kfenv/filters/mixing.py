"""Moment matching for banks of filters: many Gaussians into few, compiled, eight rows at a time.

Covariances are summed about each mixture's own mean, in units of the heaviest component: with
L_0 its factor and M_i = L_0^-1 L_i, the sum of w_i M_i M_i^T is close to the identity where
components are alike, so that its Cholesky factor T keeps all digits, and L_0 T is the
mixture's. Where they are so different that digits would be lost, the weighted factors
themselves are triangularised instead, which always works and takes longer.
"""

from __future__ import annotations

from math import sqrt as root_of

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.models.namespaces import lanes
from kfenv.models.namespaces.compiled import FLOATING_POINT, INNER, wrap
from kfenv.models.namespaces.lanes import LANES, load, spread, store, where_greater

Array = NDArray[np.float64]

MOST = 1e5  # variance in units of the heaviest component that still keeps ten digits


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
            components * targets, components * n, components * n, components * size,
            components * size, size, n, n, n, size, size, 1,
        )
    )  # fmt: skip
    _mix(weights, mean, factor, is_angle, *scratch, new_mean, new_factor)
    return new_mean, new_factor


@njit(cache=True, **FLOATING_POINT)
def _mix(weights, mean, factor, is_angle, w, d, e, L, P, base, centre, shift, bend, total, T,
         sound, new_mean, new_factor):  # fmt: skip
    """Scratch rows: of the components weights, offsets d, the same in units of the base e,
    packed factors L and covariances P; the heaviest one's factor and mean, base and centre; of
    one mixture the mean offsets shift and bend, covariance, factor, and whether it is sound."""
    batch, components, targets = weights.shape
    n = mean.shape[2]
    for first in range(0, batch, LANES):
        _gather(weights, mean, factor, first, w, d, L)
        _choose(w, components, targets, n, d, L, centre, base)
        for i in range(components):
            _relate(d, e, L, base, centre, is_angle, i)
            _square(L, P, i, n)
        for j in range(targets):
            _mean_offset(w, d, components, targets, j, n, shift)
            _mean_offset(w, e, components, targets, j, n, bend)
            _covariance(w, e, P, components, targets, j, bend, total)
            _factorise(total, T, sound, n)
            _times(base, T, n)
            for k in range(n):
                value = load(centre, k) + load(shift, k)
                store(shift, k, wrap(value) if is_angle[k] else value)
            for lane in range(min(LANES, batch - first)):
                b = first + lane
                _scatter(shift, T, lane, new_mean[b, j], new_factor[b, j])
                if not sound[0, lane] > 0.5:
                    _triangularise(weights[b, :, j], mean[b], new_mean[b, j], is_angle,
                                   factor[b], new_factor[b, j])  # fmt: skip


@njit(**INNER)
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


@njit(**INNER)
def _choose(w, components, targets, n, d, L, centre, base):
    """Mean and factor of the heaviest component."""
    size = n * (n + 1) // 2
    heaviest = spread(-1.0)
    for i in range(components):
        total = spread(0.0)
        for j in range(targets):
            total = total + load(w, i * targets + j)
        for k in range(n):
            here = load(d, i * n + k)
            store(centre, k, where_greater(total, heaviest, here, load(centre, k)))
        for k in range(size):
            here = load(L, i * size + k)
            store(base, k, where_greater(total, heaviest, here, load(base, k)))
        heaviest = where_greater(total, heaviest, total, heaviest)


@njit(**INNER)
def _relate(d, e, L, base, centre, is_angle, i):
    """Turn mean and factor of component i into an offset d, e = L_0^-1 d and M = L_0^-1 L."""
    n = len(is_angle)
    start = i * (n * (n + 1) // 2)
    for k in range(n):
        offset = load(d, i * n + k) - load(centre, k)
        store(d, i * n + k, wrap(offset) if is_angle[k] else offset)
    for row in range(n):
        at = row * (row + 1) // 2
        inverse = 1.0 / load(base, at + row)
        value = load(d, i * n + row)
        for k in range(row):
            value = value - load(base, at + k) * load(e, i * n + k)
        store(e, i * n + row, value * inverse)
        for column in range(row):
            value = load(L, start + at + column)
            for k in range(column, row):
                entry = load(L, start + k * (k + 1) // 2 + column)
                value = value - load(base, at + k) * entry
            store(L, start + at + column, value * inverse)
        store(L, start + at + row, load(L, start + at + row) / load(base, at + row))


@njit(**INNER)
def _square(L, P, i, n):
    """P_i := L_i L_i^T, both packed by rows of the lower triangle."""
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


@njit(**INNER)
def _mean_offset(w, offset, components, targets, j, n, mean):
    """Of mixture j."""
    for k in range(n):
        value = spread(0.0)
        for i in range(components):
            value = value + load(w, i * targets + j) * load(offset, i * n + k)
        store(mean, k, value)


@njit(**INNER)
def _covariance(w, e, P, components, targets, j, bend, total):
    """Packed covariance of mixture j, in units of the base."""
    n, size = len(bend), len(total)
    for k in range(size):
        store(total, k, spread(0.0))
    for i in range(components):
        weight, at = load(w, i * targets + j), 0
        for row in range(n):
            scaled = weight * (load(e, i * n + row) - load(bend, row))
            for column in range(row + 1):
                off = load(e, i * n + column) - load(bend, column)
                value = load(total, at) + weight * load(P, i * size + at)
                store(total, at, value + scaled * off)
                at += 1


@njit(**INNER)
def _factorise(total, T, sound, n):
    """Packed Cholesky factor; `sound` is 1 in lanes that keep their digits."""
    store(sound, 0, spread(1.0))
    for row in range(n):
        start = row * (row + 1) // 2
        for column in range(row + 1):
            other = column * (column + 1) // 2
            value = load(total, start + column)
            for k in range(column):
                value = value - load(T, start + k) * load(T, other + k)
            if column < row:
                store(T, start + column, value / load(T, other + column))
            else:
                store(T, start + row, lanes.sqrt(where_greater(value, 0.0, value, 1.0)))
                store(sound, 0, where_greater(value, 0.0, load(sound, 0), 0.0))
                variance = load(total, start + row)
                store(sound, 0, where_greater(MOST, variance, load(sound, 0), 0.0))


@njit(**INNER)
def _times(base, T, n):
    """T := base T, both packed lower factors."""
    for row in range(n - 1, -1, -1):
        at = row * (row + 1) // 2
        for column in range(row + 1):
            value = spread(0.0)
            for k in range(column, row + 1):
                value = value + load(base, at + k) * load(T, k * (k + 1) // 2 + column)
            store(T, at + column, value)


@njit(**INNER)
def _scatter(mean, T, lane, new_mean, new_factor):
    at = 0
    for row in range(len(new_mean)):
        new_mean[row] = mean[row, lane]
        for column in range(row + 1):
            new_factor[row, column] = T[at, lane]
            at += 1


@njit(**INNER)
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
