"""Gain and knobs in a block of `sweep`, and the slopes of all that they depend on."""

from math import sqrt

from numba import njit

from kfenv.kernel_cache import INNER_KERNEL
from kfenv.models.namespaces.lanes import load, spread, store, where_greater

from .points import cholesky, deviate, pull_deviations

HALF_ROOT = sqrt(0.5)


@njit(**INNER_KERNEL)
def _channel(at, w, r):
    """Of a row of S, or a column of C and K."""
    return int(w[at.order + r, 0])


@njit(**INNER_KERNEL)
def solve(at, w, heard, is_angle):
    """Deviations, S, K, and S^-1 times the innovation."""
    n, m, p = at.n, at.m, at.p
    for r in range(heard):
        c = _channel(at, w, r)
        row, here = at.values + c * p, load(w, at.here + c)
        deviate(at, w, row, is_angle[c])
        for j in range(p):
            store(w, row + j, where_greater(here, 0.5, load(w, row + j), 0.0))
        for q in range(r + 1):
            other = at.values + _channel(at, w, q) * p
            total = spread(0.0)
            for j in range(p):
                total = total + load(w, row + j) * load(w, other + j)
            if q == r:
                total = total + load(w, at.told + c) * load(w, at.told + c)
            store(w, at.spread + r * m + q, total)
        for i in range(n):
            total = spread(0.0)
            for j in range(i + 1):
                odd = load(w, row + 1 + j) - load(w, row + 1 + n + j)
                total = total + load(w, at.factor + i * n + j) * odd
            store(w, at.gain + i * m + r, HALF_ROOT * total)
        store(w, at.weighted + r, load(w, at.innovation + c))
    cholesky(w, at.spread, at.root, heard, m)
    for i in range(n):
        _over_root(at, w, at.gain + i * m, heard)
    _over_root(at, w, at.weighted, heard)


@njit(**INNER_KERNEL)
def _over_root(at, w, row, heard):
    """A row times S^-1, in place."""
    m, root = at.m, at.root
    for r in range(heard):
        total = load(w, row + r)
        for q in range(r):
            total = total - load(w, root + r * m + q) * load(w, row + q)
        store(w, row + r, total / load(w, root + r * m + r))
    for r in range(heard - 1, -1, -1):
        total = load(w, row + r)
        for q in range(r + 1, heard):
            total = total - load(w, root + q * m + r) * load(w, row + q)
        store(w, row + r, total / load(w, root + r * m + r))


@njit(**INNER_KERNEL)
def pull_gain(at, w, heard):
    """From the slopes of the posterior to those of S, C and the noise told, and on to points."""
    n, m = at.n, at.m
    for r in range(heard):
        total = spread(0.0)
        for i in range(n):
            total = total + load(w, at.gain + i * m + r) * load(w, at.of_mean + i)
        store(w, at.of_innovation + r, total)
        for i in range(n):
            total = spread(0.0)
            for k in range(n):
                slope = load(w, at.of_covariance + i * n + k)
                total = total + slope * load(w, at.gain + k * m + r)
            store(w, at.of_cross + i * m + r, total)
    for r in range(heard):
        total = spread(0.0)
        for q in range(r + 1):
            total = load(w, at.of_innovation + r) * load(w, at.weighted + q)
            total = total + load(w, at.of_innovation + q) * load(w, at.weighted + r)
            total = -0.5 * total
            for i in range(n):
                total = total + load(w, at.gain + i * m + r) * load(w, at.of_cross + i * m + q)
            store(w, at.spread + r * m + q, total)
            store(w, at.spread + q * m + r, total)
        c = _channel(at, w, r)
        store(w, at.of_told + c, 2.0 * total * load(w, at.told + c))
    for i in range(n):
        for r in range(heard):
            place = at.of_cross + i * m + r
            total = load(w, at.of_mean + i) * load(w, at.weighted + r)
            store(w, place, HALF_ROOT * (total - 2.0 * load(w, place)))
    _pull_cross(at, w, heard)


@njit(**INNER_KERNEL)
def _pull_cross(at, w, heard):
    """From the slopes of S and C to those of the measured points and of the factor."""
    n, m, p = at.n, at.m, at.p
    for i in range(n):
        for j in range(i + 1):
            total = spread(0.0)
            for r in range(heard):
                row = at.values + _channel(at, w, r) * p
                odd = load(w, row + 1 + j) - load(w, row + 1 + n + j)
                total = total + load(w, at.of_cross + i * m + r) * odd
            store(w, at.of_factor + i * n + j, total)
    for k in range(m * p):
        store(w, at.of_values + k, spread(0.0))
    for r in range(heard):
        row = at.of_values + _channel(at, w, r) * p
        for j in range(p):
            total = spread(0.0)
            for q in range(heard):
                value = load(w, at.values + _channel(at, w, q) * p + j)
                total = total + load(w, at.spread + r * m + q) * value
            store(w, row + j, 2.0 * total)
        for j in range(n):
            odd = spread(0.0)
            for i in range(j, n):
                slope = load(w, at.of_cross + i * m + r)
                odd = odd + slope * load(w, at.factor + i * n + j)
            store(w, row + 1 + j, load(w, row + 1 + j) + odd)
            store(w, row + 1 + n + j, load(w, row + 1 + n + j) - odd)
        pull_deviations(at, w, row, -load(w, at.of_innovation + r))


@njit(**INNER_KERNEL)
def pull_knobs(at, w):
    """From the slope of the predicted covariance to those of the knobs and of its two parts."""
    n = at.n
    of_fading = of_scale = spread(0.0)
    for k in range(n * n):
        slope = load(w, at.of_covariance + k)
        of_fading = of_fading + slope * load(w, at.propagated + k)
        of_scale = of_scale + slope * load(w, at.added + k)
    store(w, at.of_knobs, of_fading)
    store(w, at.of_knobs + 1, of_scale)
    fading, double = load(w, at.knobs), 2.0 * load(w, at.knobs + 1)
    for i in range(n):
        deviation, of_deviation = load(w, at.knobs + 2 + i), spread(0.0)
        for j in range(i + 1):
            total = spread(0.0)
            for k in range(j, n):
                slope = load(w, at.of_covariance + i * n + k)
                total = total + slope * load(w, at.noise + k * n + j)
            total = double * total
            of_deviation = of_deviation + total * load(w, at.noise + i * n + j)
            store(w, at.of_noise + i * n + j, total * deviation)
        store(w, at.of_knobs + 2 + i, of_deviation / deviation)
    for k in range(n * n):
        store(w, at.of_covariance + k, fading * load(w, at.of_covariance + k))
