"""Factors and sigma points in a block of `sweep`, and the slopes of both."""

from numba import njit

from kfenv.kernel_cache import INNER_KERNEL
from kfenv.models.namespaces.compiled import wrap
from kfenv.models.namespaces.lanes import load, spread, sqrt, store


@njit(**INNER_KERNEL)
def cholesky(w, matrix, factor, size, stride):
    """factor := lower factor of a matrix."""
    for i in range(size):
        for j in range(i + 1):
            total = load(w, matrix + i * stride + j)
            for k in range(j):
                total = total - load(w, factor + i * stride + k) * load(w, factor + j * stride + k)
            if i == j:
                store(w, factor + i * stride + j, sqrt(total))
            else:
                store(w, factor + i * stride + j, total / load(w, factor + j * stride + j))


@njit(**INNER_KERNEL)
def square(w, factor, matrix, n):
    """matrix := factor factor^T."""
    for i in range(n):
        for j in range(i + 1):
            total = spread(0.0)
            for k in range(j + 1):
                total = total + load(w, factor + i * n + k) * load(w, factor + j * n + k)
            store(w, matrix + i * n + j, total)
            store(w, matrix + j * n + i, total)


@njit(**INNER_KERNEL)
def pull_factor(at, w):
    """Add the slope of L L^T, given that of L.

    With Phi the lower triangle of L^T (slope of L), its diagonal halved, it is the symmetric part
    of L^-T Phi L^-1.
    """
    n, factor, room = at.n, at.factor, at.room
    for i in range(n):
        for j in range(i, -1, -1):
            total = spread(0.0)
            for k in range(i, n):
                total = total + load(w, factor + k * n + i) * load(w, at.of_factor + k * n + j)
            if i == j:
                total = 0.5 * total
            for k in range(j + 1, i + 1):
                total = total - load(w, room + i * n + k) * load(w, factor + k * n + j)
            store(w, room + i * n + j, total / load(w, factor + j * n + j))
            if i > j:
                store(w, room + j * n + i, spread(0.0))
    for j in range(n):
        for i in range(n - 1, -1, -1):
            total = load(w, room + i * n + j)
            for k in range(i + 1, n):
                total = total - load(w, factor + k * n + i) * load(w, room + k * n + j)
            store(w, room + i * n + j, total / load(w, factor + i * n + i))
    for i in range(n):
        for j in range(n):
            half = 0.5 * (load(w, room + i * n + j) + load(w, room + j * n + i))
            place = at.of_covariance + i * n + j
            store(w, place, load(w, place) + half)


@njit(**INNER_KERNEL)
def draw(at, w):
    """Sigma points mean, mean +- sqrt(n + kappa) factor[:, i]."""
    n = at.n
    for i in range(n):
        centre, row = load(w, at.mean + i), at.points + i * at.p
        store(w, row, centre)
        for j in range(n):
            offset = spread(0.0)
            if j <= i:
                offset = at.spacing * load(w, at.factor + i * n + j)
            store(w, row + 1 + j, centre + offset)
            store(w, row + 1 + n + j, centre - offset)


@njit(**INNER_KERNEL)
def draw_predicted(at, w):
    """The same of the predicted state, whose parts the knobs weigh."""
    fading, process_scale = load(w, at.knobs), load(w, at.knobs + 1)
    for k in range(at.n * at.n):
        noise = process_scale * load(w, at.added + k)
        store(w, at.room + k, fading * load(w, at.propagated + k) + noise)
    cholesky(w, at.room, at.factor, at.n, at.n)
    draw(at, w)


@njit(**INNER_KERNEL)
def pull_points(at, w):
    """Add the slopes of mean and factor, given those of the points."""
    n = at.n
    for i in range(n):
        total, row = load(w, at.of_mean + i), at.of_points + i * at.p
        for j in range(at.p):
            total = total + load(w, row + j)
        store(w, at.of_mean + i, total)
        for j in range(i + 1):
            odd = at.spacing * (load(w, row + 1 + j) - load(w, row + 1 + n + j))
            place = at.of_factor + i * n + j
            store(w, place, load(w, place) + odd)


@njit(**INNER_KERNEL)
def deviate(at, w, row, is_angle):
    """Turn a row of values at the points into deviations from their mean, times root weights."""
    centre, total = load(w, row), spread(0.0)
    for j in range(1, at.p):
        offset = load(w, row + j) - centre
        if is_angle:
            offset = wrap(offset)
        store(w, row + j, offset)
        total = total + offset
    mean = at.weight * total
    store(w, row, -at.root_centre_weight * mean)
    for j in range(1, at.p):
        store(w, row + j, at.root_weight * (load(w, row + j) - mean))


@njit(**INNER_KERNEL)
def pull_deviations(at, w, row, of_mean):
    """Turn the slopes of a row's deviations, and of its mean, into those of its values."""
    total = at.root_centre_weight * load(w, row)
    for j in range(1, at.p):
        total = total + at.root_weight * load(w, row + j)
    shared, total = at.weight * (of_mean - total), spread(0.0)
    for j in range(1, at.p):
        slope = shared + at.root_weight * load(w, row + j)
        store(w, row + j, slope)
        total = total + slope
    store(w, row, of_mean - total)
