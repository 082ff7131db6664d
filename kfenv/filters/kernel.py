# ruff: noqa: F821
"""The fused kernel: one square-root sigma-point filter cycle (SPEC section 9).

This file is a template. `kfenv.filters.engine` executes it once per pair of motion
and sensor, after binding the names in capitals, the model's functions, the component accessors
and the decorator ``entry_point`` as globals; bound so, and not through closures,
Numba finds its cache again in the next process.

Layout: scratch matrices are flat with the constant row stride ``W``, sigma points
run along the rows, and row lengths are arguments that the caller pads to a multiple
of eight. Loops over them are then turned into vector code; a trip count that is a
constant would be unrolled first, and no vector code result.
"""

import sys
from math import floor, isnan, log, nan, pi, sqrt

from numba import njit

from kfenv.models.namespaces.compiled import FLOATING_POINT

TWO_PI = 2.0 * pi
LARGEST = sys.float_info.max
OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE = 0, 1, 2, 3


@njit(forceinline=True, **FLOATING_POINT)
def _wrap(angle):
    return angle - TWO_PI * floor(angle / TWO_PI + 0.5)


@njit(**FLOATING_POINT)
def _triangularise(A, L, rows, width):
    """L := lower factor with L L^T = A A^T, diagonal >= 0; destroys A (Householder)."""
    for i in range(rows):
        pivot_row = i * W
        squared = 0.0
        for j in range(width):
            squared += A[pivot_row + j] * A[pivot_row + j]
        norm = sqrt(squared)
        pivot = A[pivot_row + i]
        sign = 1.0 if pivot >= 0.0 else -1.0
        scale = norm * (norm + abs(pivot))
        scale = 1.0 / scale if scale > 0.0 else 0.0
        A[pivot_row + i] = pivot + sign * norm
        L[i, i] = norm
        for k in range(i + 1, rows):
            row = k * W
            projection = 0.0
            for j in range(width):
                projection += A[row + j] * A[pivot_row + j]
            projection *= scale
            for j in range(width):
                A[row + j] -= projection * A[pivot_row + j]
            L[k, i] = -sign * A[row + i]
            A[row + i] = 0.0  # so that every row keeps the full width


@njit(**FLOATING_POINT)
def _add_noise(root, root_scale, noise, noise_scale, L, A, B, width):
    """L := lower factor of root_scale^2 root root^T + noise_scale^2 noise noise^T.

    Both are lower triangular, so each reflection touches one column of the root.
    """
    for i in range(N):
        for j in range(i + 1):
            A[i * W + j] = root_scale * root[i, j]
            B[i * W + j] = noise_scale * noise[i, j]
        for j in range(i + 1, width):
            B[i * W + j] = 0.0
    for i in range(N):
        pivot_row = i * W
        pivot = A[pivot_row + i]
        squared = pivot * pivot
        for j in range(width):
            squared += B[pivot_row + j] * B[pivot_row + j]
        norm = sqrt(squared)
        sign = 1.0 if pivot >= 0.0 else -1.0
        head = pivot + sign * norm
        scale = norm * (norm + abs(pivot))
        scale = 1.0 / scale if scale > 0.0 else 0.0
        L[i, i] = norm
        for j in range(i + 1, N):
            L[i, j] = 0.0
        for k in range(i + 1, N):
            row = k * W
            projection = A[row + i] * head
            for j in range(width):
                projection += B[row + j] * B[pivot_row + j]
            projection *= scale
            for j in range(width):
                B[row + j] -= projection * B[pivot_row + j]
            L[k, i] = -sign * (A[row + i] - projection * head)


@njit(**FLOATING_POINT)
def _draw(mean, factor, X, width):
    """Sigma points mean, mean +- sqrt(n + kappa) factor[:, i] along the rows of X."""
    for i in range(N):
        centre = mean[i]
        for j in range(width):
            X[i * W + j] = centre
        for j in range(i + 1):
            offset = SPREAD * factor[i, j]
            X[i * W + 1 + j] = centre + offset
            X[i * W + 1 + N + j] = centre - offset


@njit(**FLOATING_POINT)
def _predict_one(mean, factor, u, dt, weights, new_mean, root, noise, X, width):
    """Propagate one filter; root and noise are the two parts of its predicted factor."""
    inputs = input_components(u)
    _draw(mean, factor, X, width)
    for j in range(width):
        store_state(X, j, step(state_components(X, j), inputs, dt))
    for i in range(N):
        row = i * W
        centre = X[row]
        offset = 0.0
        for j in range(width):
            deviation = X[row + j] - centre
            if STATE_IS_ANGLE[i]:
                deviation = _wrap(deviation)
            X[row + j] = deviation
            offset += weights[j] * deviation
        new_mean[i] = centre + offset
        if STATE_IS_ANGLE[i]:
            new_mean[i] = _wrap(new_mean[i])
        for j in range(width):
            X[row + j] = sqrt(weights[j]) * (X[row + j] - offset)
    _triangularise(X, root, N, width)
    for i in range(N):
        for j in range(N):
            noise[i, j] = 0.0
            if j > i:
                root[i, j] = 0.0
    _draw(mean, factor, X, 1)
    entries = noise_factor(state_components(X, 0), inputs, dt)
    for k in range(len(NOISE_PATTERN)):
        noise[NOISE_PATTERN[k][0], NOISE_PATTERN[k][1]] = entries[k]


@njit(**FLOATING_POINT)
def _innovate_one(
    mean, factor, s, z, sd, weights, innovation, variance, whitened, present, X, Z, A, U, Re, C,
    width, width_noise, width_cross,
):  # fmt: skip
    """Innovation of one filter; fills U, Re, C for the channels present, returns their number."""
    inputs = sensor_components(s)
    _draw(mean, factor, X, width)
    for j in range(2 * N + 1):
        store_channels(Z, j, measure(state_components(X, j), inputs))
    count = 0
    for c in range(M):
        innovation[c] = nan
        variance[c] = nan
        whitened[c] = nan
        if isnan(z[c]):
            continue
        row = c * W
        centre = Z[row]
        for j in range(2 * N + 1, width):
            Z[row + j] = centre  # padding, or what a former filter left there would count
        offset = 0.0
        for j in range(width):
            deviation = Z[row + j] - centre
            if CHANNEL_IS_ANGLE[c]:
                deviation = _wrap(deviation)
            Z[row + j] = deviation
            offset += weights[j] * deviation
        nu = z[c] - centre - offset
        if CHANNEL_IS_ANGLE[c]:
            nu = _wrap(nu)
        innovation[c] = nu
        out = count * W
        for j in range(width_noise):
            A[out + j] = 0.0
        for j in range(N):
            plus, minus = Z[row + 1 + j], Z[row + 1 + N + j]
            U[out + j] = ODD * (plus - minus)
            A[out + j] = EVEN * (plus + minus - 2.0 * offset)
        A[out + N] = -CENTRE * offset
        A[out + N + 1 + count] = sd[c]
        present[count] = c
        count += 1
    _triangularise(A, Re, count, width_noise)
    for r in range(count):
        for j in range(width_cross):
            A[r * W + j] = 0.0
        for j in range(N):
            A[r * W + j] = U[r * W + j]
        for q in range(r + 1):
            A[r * W + N + q] = Re[r, q]
    _triangularise(A, C, count, width_cross)
    for r in range(count):
        residual = innovation[present[r]]
        total = C[r, r] * C[r, r]
        for q in range(r):
            residual -= C[r, q] * whitened[present[q]]
            total += C[r, q] * C[r, q]
        whitened[present[r]] = residual / C[r, r]
        variance[present[r]] = total
    return count


@njit(**FLOATING_POINT)
def _correct_one(mean, factor, count, present, innovation, A, U, Re, C, K, new_mean, new_factor,
                 width, width_cross):  # fmt: skip
    """K = S U^T C^-T C^-1 and S+ = tria[S - K U, K Re] for the channels present.

    K is held transposed, one row a channel.
    """
    for r in range(count):
        row = r * W
        for i in range(N, width):
            K[row + i] = 0.0
        for i in range(N):
            value = 0.0
            for k in range(i + 1):
                value += factor[i, k] * U[row + k]
            K[row + i] = value
        for q in range(r):
            for i in range(width):
                K[row + i] -= C[r, q] * K[q * W + i]
        inverse = 1.0 / C[r, r]
        for i in range(width):
            K[row + i] *= inverse
    for r in range(count - 1, -1, -1):
        row = r * W
        for q in range(r + 1, count):
            for i in range(width):
                K[row + i] -= C[q, r] * K[q * W + i]
        inverse = 1.0 / C[r, r]
        for i in range(width):
            K[row + i] *= inverse
    for i in range(N):
        row = i * W
        for j in range(width_cross):
            A[row + j] = 0.0
        for k in range(i + 1):
            A[row + k] = factor[i, k]
        correction = 0.0
        for r in range(count):
            gain = K[r * W + i]
            correction += gain * innovation[present[r]]
            for k in range(N):
                A[row + k] -= gain * U[r * W + k]
            for q in range(r + 1):
                A[row + N + q] += gain * Re[r, q]
        new_mean[i] = mean[i] + correction
        if STATE_IS_ANGLE[i]:
            new_mean[i] = _wrap(new_mean[i])
    _triangularise(A, new_factor, N, width_cross)
    for i in range(N):
        for j in range(i + 1, N):
            new_factor[i, j] = 0.0


@njit(**FLOATING_POINT)
def _copy(mean, factor, new_mean, new_factor):
    # Loops, since Numba takes seconds to compile an assignment to a slice.
    for i in range(N):
        new_mean[i] = mean[i]
        for j in range(N):
            new_factor[i, j] = factor[i, j]


@njit(forceinline=True, **FLOATING_POINT)
def _is_finite(value):
    # math.isfinite compiles to value - value, which reassociation cancels to zero: always true
    return abs(value) <= LARGEST


@njit(**FLOATING_POINT)
def _finite(mean, factor):
    total = 0.0
    for i in range(N):
        total += mean[i]
        for j in range(i + 1):
            total += factor[i, j]
    return _is_finite(total)


@njit(**FLOATING_POINT)
def _assess(count, present, whitened, C):
    """Normalised innovation squared and log-likelihood; NaN and 0 if nothing arrived."""
    squared, log_determinant = 0.0, 0.0
    for r in range(count):
        squared += whitened[present[r]] * whitened[present[r]]
        log_determinant += log(C[r, r])
    if count == 0:
        return nan, 0.0
    return squared, -0.5 * (squared + count * log(TWO_PI)) - log_determinant


@entry_point
def predict(mean, factor, u, dt, weights, scratch, new_mean, root, noise, status):
    """Time update of a batch. Filters whose status is not zero are left alone."""
    X = scratch[0]
    for b in range(mean.shape[0]):
        if status[b] != OK:
            continue
        _predict_one(mean[b], factor[b], u[b], dt[b], weights, new_mean[b], root[b], noise[b],
                     X, weights.size)  # fmt: skip
        if not _finite(new_mean[b], root[b]):
            status[b] = BAD_PREDICTION


@entry_point
def update(mean, root, noise, fading, process_scale, s, z, sd, weights, widths, scratch, correct,
           new_mean, new_factor, innovation, variance, whitened, nis, log_likelihood,
           status):  # fmt: skip
    """Measurement update of a batch with the knobs applied.

    Unless ``correct``, the innovation alone is formed and the predicted state returned.
    """
    X, Z, A, B, U, K, Re, C, present, joined = scratch
    for b in range(mean.shape[0]):
        if status[b] != OK:
            continue
        _add_noise(root[b], sqrt(fading[b]), noise[b], sqrt(process_scale[b]), joined, A, B,
                   widths[0])  # fmt: skip
        count = _innovate_one(mean[b], joined, s[b], z[b], sd[b], weights, innovation[b],
                              variance[b], whitened[b], present, X, Z, A, U, Re, C,
                              weights.size, widths[1], widths[2])  # fmt: skip
        nis[b], log_likelihood[b] = _assess(count, present, whitened[b], C)
        if count > 0 and not _is_finite(nis[b]):
            status[b] = BAD_INNOVATION
            continue
        if correct and count > 0:
            _correct_one(mean[b], joined, count, present, innovation[b], A, U, Re, C, K,
                         new_mean[b], new_factor[b], widths[0], widths[2])  # fmt: skip
        else:
            _copy(mean[b], joined, new_mean[b], new_factor[b])
        if not _finite(new_mean[b], new_factor[b]):
            status[b] = BAD_UPDATE


@entry_point
def run(mean, factor, dt, u, s, z, sd, fading, process_scale, weights, widths, scratch,
        pending, means, nis, status, failed_at):  # fmt: skip
    """Filter whole recordings with constant knobs; mean and factor end as the last posterior."""
    X, Z, A, B, U, K, Re, C, present, joined = scratch
    predicted, root, noise, innovation, variance, whitened = pending
    for b in range(mean.shape[0]):
        for t in range(z.shape[1]):
            if t > 0:
                _predict_one(mean[b], factor[b], u[b, t], dt[t], weights, predicted, root, noise,
                             X, weights.size)  # fmt: skip
            else:
                _copy(mean[b], factor[b], predicted, root)
                for i in range(N):
                    for j in range(N):
                        noise[i, j] = 0.0
            if not _finite(predicted, root):
                status[b] = BAD_PREDICTION
                failed_at[b] = t
                break
            _add_noise(root, sqrt(fading[b]), noise, sqrt(process_scale[b]), joined, A, B,
                       widths[0])  # fmt: skip
            count = _innovate_one(predicted, joined, s[b, t], z[b, t], sd[b, t], weights,
                                  innovation, variance, whitened, present, X, Z, A, U, Re, C,
                                  weights.size, widths[1], widths[2])  # fmt: skip
            nis[b, t] = _assess(count, present, whitened, C)[0]
            if count > 0 and not _is_finite(nis[b, t]):
                status[b] = BAD_INNOVATION
                failed_at[b] = t
                break
            if count > 0:
                _correct_one(predicted, joined, count, present, innovation, A, U, Re, C, K,
                             mean[b], factor[b], widths[0], widths[2])  # fmt: skip
            else:
                _copy(predicted, joined, mean[b], factor[b])
            if not _finite(mean[b], factor[b]):
                status[b] = BAD_UPDATE
                failed_at[b] = t
                break
            for i in range(N):
                means[b, t, i] = mean[b, i]
