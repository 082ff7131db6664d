"""Compiled steps of `kfenv.filters.pointwise`: one filter after the other, in plain loops."""

from __future__ import annotations

from math import floor, isnan, log, nan, pi, sqrt

import numpy as np
from numba import njit

from kfenv.filters.results import BAD_INNOVATION, BAD_PREDICTION, BAD_UPDATE, OK

TWO_PI = 2.0 * pi
LARGEST = np.finfo(np.float64).max


@njit(cache=True, error_model="numpy")
def scatter(mean, factor, spread, points):
    """Write the sigma points (n, B P): mean, mean + spread S e_i, mean - spread S e_i."""
    n = mean.shape[1]
    count = 2 * n + 1
    for b in range(mean.shape[0]):
        for i in range(n):
            centre = mean[b, i]
            points[i, b * count] = centre
            for j in range(n):
                offset = spread * factor[b, i, j] if j <= i else 0.0
                points[i, b * count + 1 + j] = centre + offset
                points[i, b * count + 1 + n + j] = centre - offset


@njit(cache=True, error_model="numpy")
def gather(values, angle, kappa, mean, root, status):
    """Mean and lower factor of what became of the sigma points, (n, B P)."""
    n = mean.shape[1]
    A = np.empty((n, 2 * n + 1))
    for b in range(mean.shape[0]):
        _centred(values, b, n, angle, kappa, mean[b], A)
        triangularise(A, root[b])
        if status[b] == OK and not _finite(mean[b], root[b]):
            status[b] = BAD_PREDICTION


@njit(cache=True, error_model="numpy")
def add_noise(root, noise, fading, process_scale, factor):
    """Lower factor of fading root root^T + process_scale noise noise^T."""
    n = root.shape[1]
    A = np.empty((n, 2 * n))
    for b in range(root.shape[0]):
        A[:, :n] = sqrt(fading[b]) * root[b]
        A[:, n:] = sqrt(process_scale[b]) * noise[b]
        triangularise(A, factor[b])


@njit(cache=True, error_model="numpy")
def correct(
    seen, value, noise, channel_angle, state_angle, kappa, takes, mean, factor, innovation,
    variance, whitened, nis, log_likelihood, status,
):  # fmt: skip
    """Innovation of each filter and, if it takes the measurement, its posterior in place.

    Args:
        seen: (m, B P) what the sensor makes of the sigma points of mean and factor.
        value, noise: (B, m), NaN where nothing arrived.
    """
    n, m = mean.shape[1], value.shape[1]
    Z, C, K = np.empty((m, 2 * n + 1)), np.empty((m, m)), np.empty((n, m))
    A, expected, sd = np.zeros((m, 2 * n + 1 + m)), np.empty(m), np.empty(m)
    for b in range(mean.shape[0]):
        count = 0
        _centred(seen, b, n, channel_angle, kappa, expected, Z)
        for c in range(m):
            if isnan(value[b, c]):  # a constant zero, measured as zero: without effect
                Z[c] = 0.0
                innovation[b, c], sd[c] = 0.0, 1.0
            else:
                off = value[b, c] - expected[c]
                innovation[b, c] = _wrapped(off) if channel_angle[c] else off
                sd[c] = noise[b, c]
                count += 1
        if count == 0:
            innovation[b], nis[b] = nan, nan
            _blame(mean[b], factor[b], 0.0, takes, b, status)
            continue
        A[:, : 2 * n + 1], A[:, 2 * n + 1 :] = Z, 0.0
        for c in range(m):
            A[c, 2 * n + 1 + c] = sd[c]
        triangularise(A, C)
        _assess(innovation[b], value[b], C, count, b, variance, whitened, nis, log_likelihood)
        if takes:
            _gain(factor[b], Z, C, kappa, K)
            for i in range(n):
                for c in range(m):
                    mean[b, i] += K[i, c] * innovation[b, c]
                if state_angle[i]:
                    mean[b, i] = _wrapped(mean[b, i])
            _posterior_factor(K, Z, sd, factor[b], kappa)
        _blame(mean[b], factor[b], nis[b], takes, b, status)
        for c in range(m):
            if isnan(value[b, c]):
                innovation[b, c] = variance[b, c] = whitened[b, c] = nan


@njit(error_model="numpy")
def _blame(mean, factor, nis, takes, b, status):
    """Say why a filter, so far sound, has failed, if it has."""
    if status[b] != OK:
        return
    if not abs(nis) <= LARGEST:
        status[b] = BAD_INNOVATION
    elif not _finite(mean, factor):
        status[b] = BAD_UPDATE if takes else BAD_PREDICTION


@njit(error_model="numpy")
def _finite(mean, factor):
    total = 0.0
    for i in range(len(mean)):
        total += abs(mean[i])
        for j in range(i + 1):
            total += abs(factor[i, j])
    return total <= LARGEST


@njit(error_model="numpy")
def _centred(values, b, n, angle, kappa, mean, A):
    """The mean of a filter's points, and their weighted deviations in the rows of A."""
    count = 2 * n + 1
    weight = 0.5 / (n + kappa)
    root, root_of_centre = sqrt(weight), sqrt(kappa / (n + kappa))
    for i in range(values.shape[0]):
        centre, shift = values[i, b * count], 0.0
        for j in range(1, count):
            off = values[i, b * count + j] - centre
            if angle[i]:
                off = _wrapped(off)
            A[i, j] = off
            shift += off
        shift *= weight
        A[i, 0] = -root_of_centre * shift
        for j in range(1, count):
            A[i, j] = root * (A[i, j] - shift)
        mean[i] = _wrapped(centre + shift) if angle[i] else centre + shift


@njit(error_model="numpy")
def _assess(innovation, value, C, count, b, variance, whitened, nis, log_likelihood):
    """What an innovation says beside its factor C."""
    total, determinant = 0.0, 0.0
    for c in range(len(C)):
        rest, square = innovation[c], 0.0
        for q in range(c):
            rest -= C[c, q] * whitened[b, q]
        for q in range(c + 1):
            square += C[c, q] * C[c, q]
        whitened[b, c], variance[b, c] = rest / C[c, c], square
        total += whitened[b, c] ** 2
        determinant += log(C[c, c])
    nis[b] = total
    log_likelihood[b] = -0.5 * (total + count * log(TWO_PI)) - determinant


@njit(error_model="numpy")
def _gain(S, Z, C, kappa, K):
    """K = X Z^T C^-T C^-1: rows of the cross covariance through both triangles."""
    n, m = K.shape
    root = sqrt(0.5)  # spread times the root of a point's weight
    for i in range(n):
        for c in range(m):
            cross = 0.0
            for j in range(i + 1):
                cross += S[i, j] * (Z[c, 1 + j] - Z[c, 1 + n + j])
            rest = root * cross
            for q in range(c):
                rest -= C[c, q] * K[i, q]
            K[i, c] = rest / C[c, c]
        for c in range(m - 1, -1, -1):
            for q in range(c + 1, m):
                K[i, c] -= C[q, c] * K[i, q]
            K[i, c] /= C[c, c]


@njit(error_model="numpy")
def _posterior_factor(K, Z, sd, S, kappa):
    """S becomes the lower factor of (X - K Z)(X - K Z)^T + K R K^T (SPEC section 9)."""
    n, m = K.shape
    root = sqrt(0.5)
    A = np.zeros((n, 2 * n + 1 + m))
    for i in range(n):
        for j in range(i + 1):
            A[i, 1 + j], A[i, 1 + n + j] = root * S[i, j], -root * S[i, j]
        for c in range(m):
            for j in range(2 * n + 1):
                A[i, j] -= K[i, c] * Z[c, j]
            A[i, 2 * n + 1 + c] = K[i, c] * sd[c]
    triangularise(A, S)


@njit(error_model="numpy")
def _wrapped(angle):
    return angle - TWO_PI * floor(angle / TWO_PI + 0.5)


@njit(cache=True, error_model="numpy")
def triangularise(A, L):
    """Lower factor L with L L^T = A A^T and diagonal >= 0, by Householder reflections.

    A is (n, k) with k >= n, and used up.
    """
    n, k = A.shape
    for i in range(n):
        norm = 0.0
        for j in range(i, k):
            norm += A[i, j] * A[i, j]
        norm = sqrt(norm)
        head = A[i, i]
        L[i, i] = norm
        for j in range(i + 1, n):
            L[i, j] = 0.0
        if norm == 0.0:
            for r in range(i + 1, n):
                L[r, i] = 0.0
            continue
        # v = a + sign(head) norm e; what becomes of a is -sign(head) norm e, so turn it round
        sign = 1.0 if head >= 0.0 else -1.0
        A[i, i] = head + sign * norm
        beta = 1.0 / (norm * (norm + abs(head)))
        for r in range(i + 1, n):
            along = 0.0
            for j in range(i, k):
                along += A[i, j] * A[r, j]
            along *= beta
            for j in range(i, k):
                A[r, j] -= along * A[i, j]
            L[r, i] = -sign * A[r, i]
