# ruff: noqa: F821
"""One cycle of square-root sigma-point filters, eight side by side or one (SPEC section 9).

This file is the first of two templates. `kfenv.filters.engine` executes them, one after the
other and in one module, once per pair of motion and sensor, after binding the names in
capitals, the model's functions, the component accessors and the decorator ``entry_point`` as
globals; bound so, and not through closures, Numba finds its cache again in the next process.

There is one filter per lane of a vector, or a float. Scratch matrices are rows of lanes
(rows * columns); ``load`` and ``store`` take a flat index. No lane sees another, so a filter's
bits do not depend on its neighbours. ``w`` is the engine's `Scratch`; its rows are overwritten
from one step to the next. A missing channel keeps its row with zero slope, unit noise and zero
innovation, and since the noise stands first in the rows that are triangularised, it changes
no bit of the others. So where there are many, one that no lane heard has no row at all, and
the bits are the same.
"""

from numba import njit

from kfenv.models.namespaces.compiled import INNER, wrap
from kfenv.models.namespaces.lanes import load, peek, sqrt, store, where_greater


@njit(forceinline=True, **INNER)
def _plain(number):
    """The number as a variable: Numba compiles a function anew for every literal argument."""
    return number + 0


@njit(**INNER)
def _triangularise(A, L, rows, width):
    """L := lower factor with L L^T = A A^T, diagonal >= 0; destroys A (Householder)."""
    for i in range(rows):
        squared = spread(0.0)
        for j in range(i, width):
            value = load(A, i * width + j)
            squared = squared + value * value
        norm = sqrt(squared)
        pivot = load(A, i * width + i)
        sign = where_greater(0.0, pivot, -1.0, 1.0)
        head = pivot + sign * norm
        scale = norm * (norm + abs(pivot))
        scale = where_greater(scale, 0.0, 1.0 / scale, 0.0)
        store(A, i * width + i, head)
        store(L, i * rows + i, norm)
        for k in range(i + 1, rows):
            projection = spread(0.0)
            for j in range(i, width):
                projection = projection + load(A, k * width + j) * load(A, i * width + j)
            projection = projection * scale
            for j in range(i, width):
                value = load(A, k * width + j) - projection * load(A, i * width + j)
                store(A, k * width + j, value)
            store(L, k * rows + i, -sign * load(A, k * width + i))


@njit(**INNER)
def _append(L, A, rows, stride, first, width):
    """L := lower factor of L L^T + A A^T, diagonal >= 0, of a lower L; destroys A (Householder).

    A reflection touches one column of L, and of A what row i has: first + i entries, or `width`.
    """
    for i in range(rows):
        end = min(first + i, width)
        pivot = load(L, i * stride + i)
        squared = pivot * pivot
        for j in range(end):
            value = load(A, i * width + j)
            squared = squared + value * value
        norm = sqrt(squared)
        sign = where_greater(0.0, pivot, -1.0, 1.0)
        head = pivot + sign * norm
        scale = norm * (norm + abs(pivot))
        scale = where_greater(scale, 0.0, 1.0 / scale, 0.0)
        store(L, i * stride + i, norm)
        for k in range(i + 1, rows):
            projection = load(L, k * stride + i) * head
            for j in range(end):
                projection = projection + load(A, k * width + j) * load(A, i * width + j)
            projection = projection * scale
            for j in range(end):
                value = load(A, k * width + j) - projection * load(A, i * width + j)
                store(A, k * width + j, value)
            store(L, k * stride + i, -sign * (load(L, k * stride + i) - projection * head))


@njit(**INNER)
def _copy(source, target, rows):
    for k in range(rows):
        store(target, k, load(source, k))


@njit(**INNER)
def _start(w):
    """The initial state in the prediction's place, without any process noise."""
    for k in range(N * N):
        store(w.Q, k, spread(0.0))
        store(w.L, k, load(w.S, k))
    _copy(w.posterior, w.predicted, _plain(N))


@njit(**INNER)
def _add_noise(w):
    """L := lower factor of S S^T and Q Q^T by their scales."""
    root_scale, noise_scale = load(w.scales, 0), load(w.scales, 1)
    for i in range(N):
        for j in range(i + 1):
            store(w.L, i * N + j, root_scale * load(w.S, i * N + j))
            store(w.A, i * N + j, noise_scale * load(w.Q, i * N + j))
    _append(w.L, w.A, _plain(N), _plain(N), _plain(1), _plain(N))


@njit(**INNER)
def _draw(mean, factor, X):
    """Sigma points mean, mean +- sqrt(n + kappa) factor[:, i] along the rows of X."""
    for i in range(N):
        centre = load(mean, i)
        store(X, i * P, centre)
        for j in range(N):
            if j <= i:
                offset = SPREAD * load(factor, i * N + j)
                store(X, i * P + 1 + j, centre + offset)
                store(X, i * P + 1 + N + j, centre - offset)
            else:
                store(X, i * P + 1 + j, centre)
                store(X, i * P + 1 + N + j, centre)


@njit(**INNER)
def _mean_offset(X, row, is_angle):
    """Turn a row of points into offsets from the central one; return their weighted mean."""
    centre = load(X, row)
    total = spread(0.0)
    for j in range(P):
        deviation = load(X, row + j) - centre
        if is_angle:
            deviation = wrap(deviation)
        store(X, row + j, deviation)
        total = total + deviation
    return WEIGHT * total  # the central offset is zero, whatever its weight


@njit(**INNER)
def _predict_lanes(w):
    """Propagate from posterior and S; L and Q are the two parts of the predicted factor."""
    inputs, dt = input_components(w.u), load(w.dt, 0)
    _draw(w.posterior, w.S, w.X)
    entries = noise_factor(state_components(w.X, _plain(0)), inputs, dt)
    for k in range(N * N):
        store(w.Q, k, spread(0.0))
    for k in range(len(NOISE_PATTERN)):
        store(w.Q, NOISE_PATTERN[k][0] * N + NOISE_PATTERN[k][1], lift(entries[k]))
    for j in range(P):
        store_state(w.X, j, step(state_components(w.X, j), inputs, dt))
    for i in range(N):
        row = i * P
        centre = load(w.X, row)
        offset = _mean_offset(w.X, row, STATE_IS_ANGLE[i])
        value = centre + offset
        if STATE_IS_ANGLE[i]:
            value = wrap(value)
        store(w.predicted, i, value)
        store(w.X, row, -ROOT_CENTRE_WEIGHT * offset)
        for j in range(1, P):
            store(w.X, row + j, ROOT_WEIGHT * (load(w.X, row + j) - offset))
    _triangularise(w.X, w.L, _plain(N), _plain(P))


@njit(**INNER)
def _channel(w, r):
    """The channel that row r of U, Re, C and K stands for."""
    return int(peek(w.order, r, 0)) if SKIPS else r


@njit(**INNER)
def _innovate_lanes(w, heard):
    """Innovation, its variance and whitened form; fills U, Re and C (SPEC section 9).

    With many channels they have a row for each that any lane heard, see `_channel`.
    """
    inputs, rows = sensor_components(w.s), heard if SKIPS else M
    _draw(w.predicted, w.L, w.X)
    for j in range(P):
        store_channels(w.Z, j, measure(state_components(w.X, j), inputs))
    width = N + 1
    for r in range(rows):
        c = _channel(w, r)
        row, here = c * P, load(w.arrived, c)
        centre = load(w.Z, row)
        offset = _mean_offset(w.Z, row, CHANNEL_IS_ANGLE[c])
        nu = load(w.z, c) - centre - offset
        if CHANNEL_IS_ANGLE[c]:
            nu = wrap(nu)
        store(w.innovation, c, where_greater(here, 0.5, nu, 0.0))
        for q in range(r):
            store(w.Re, r * M + q, spread(0.0))
        store(w.Re, r * M + r, load(w.sd, c))
        for j in range(N):
            plus, minus = load(w.Z, row + 1 + j), load(w.Z, row + 1 + N + j)
            slope, bend = ODD * (plus - minus), EVEN * (plus + minus - 2.0 * offset)
            store(w.U, r * N + j, where_greater(here, 0.5, slope, 0.0))
            store(w.A, r * width + j, where_greater(here, 0.5, bend, 0.0))
        centred = where_greater(here, 0.5, -ROOT_CENTRE_WEIGHT * offset, 0.0)
        store(w.A, r * width + N, centred)
    _append(w.Re, w.A, _plain(rows), _plain(M), width, width)
    for r in range(rows):
        for q in range(r + 1):
            store(w.C, r * M + q, load(w.Re, r * M + q))
        for j in range(N):
            store(w.A, r * N + j, load(w.U, r * N + j))
    _append(w.C, w.A, _plain(rows), _plain(M), _plain(N), _plain(N))
    for r in range(rows):
        c = _channel(w, r)
        residual = load(w.innovation, c)
        diagonal = load(w.C, r * M + r)
        total = diagonal * diagonal
        for q in range(r):
            entry = load(w.C, r * M + q)
            residual = residual - entry * load(w.whitened, _channel(w, q))
            total = total + entry * entry
        store(w.whitened, c, residual / diagonal)
        store(w.variance, c, total)


@njit(**INNER)
def _correct_lanes(w, heard):
    """K = S U^T C^-T C^-1 and S+ = tria[S - K U, K Re]; K is held one row a channel.

    Where no lane has a measurement: what comes of that, for nothing.
    """
    if not heard:
        _copy(w.predicted, w.posterior, _plain(N))
        _copy(w.L, w.S, _plain(N * N))
        return
    count, rows = load(w.count, 0), heard if SKIPS else M
    for r in range(rows):
        inverse = 1.0 / load(w.C, r * M + r)
        for i in range(N):
            value = spread(0.0)
            for k in range(i + 1):
                value = value + load(w.L, i * N + k) * load(w.U, r * N + k)
            for q in range(r):
                value = value - load(w.C, r * M + q) * load(w.K, q * N + i)
            store(w.K, r * N + i, value * inverse)
    for r in range(rows - 1, -1, -1):
        inverse = 1.0 / load(w.C, r * M + r)
        for i in range(N):
            value = load(w.K, r * N + i)
            for q in range(r + 1, rows):
                value = value - load(w.C, q * M + r) * load(w.K, q * N + i)
            store(w.K, r * N + i, value * inverse)
    width = N + rows
    for i in range(N):
        value = load(w.predicted, i)
        for j in range(N):
            entry = load(w.L, i * N + j) if j <= i else spread(0.0)
            for r in range(rows):
                entry = entry - load(w.K, r * N + i) * load(w.U, r * N + j)
            store(w.A, i * width + j, entry)
        for q in range(rows):
            entry = spread(0.0)
            for r in range(q, rows):
                entry = entry + load(w.K, r * N + i) * load(w.Re, r * M + q)
            store(w.A, i * width + N + q, entry)
        for r in range(rows):
            value = value + load(w.K, r * N + i) * load(w.innovation, _channel(w, r))
        if STATE_IS_ANGLE[i]:
            value = wrap(value)
        store(w.posterior, i, where_greater(count, 0.5, value, load(w.predicted, i)))
    _triangularise(w.A, w.S, _plain(N), width)
    for i in range(N):
        for j in range(i + 1):
            k = i * N + j
            store(w.S, k, where_greater(count, 0.5, load(w.S, k), load(w.L, k)))
