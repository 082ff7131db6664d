# ruff: noqa: F821
"""The fused kernel: batches of filters through the cycle, eight at a time (SPEC section 9).

This file is the second of two templates; see ``cycle.py``, whose functions it calls. Its
entry points are what the engine calls and what Numba keeps on disk.
"""

import sys
from math import isnan, log, nan

from numba import njit

from kfenv.models.namespaces.compiled import FLOATING_POINT, TWO_PI
from kfenv.models.namespaces.lanes import LANES, load, spread, store

LARGEST = sys.float_info.max
OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE = 0, 1, 2, 3


@njit(**FLOATING_POINT)
def _anything_arrived(count):
    """Whether any lane has a measurement: filters may predict more often than they update."""
    for lane in range(LANES):
        if count[0, lane] > 0.5:
            return True
    return False


@njit(**FLOATING_POINT)
def _gather(source, first, target):
    """Lane l of the target takes row first + l of the source (B, K); the last row fills up."""
    last = source.shape[0] - 1
    for lane in range(LANES):
        b = min(first + lane, last)
        for k in range(source.shape[1]):
            target[k, lane] = source[b, k]


@njit(**FLOATING_POINT)
def _scatter(source, first, status, target):
    """Give each running filter its lane back."""
    for lane in range(min(LANES, target.shape[0] - first)):
        if status[first + lane] == OK:
            for k in range(target.shape[1]):
                target[first + lane, k] = source[k, lane]


@njit(**FLOATING_POINT)
def _scatter_factor(source, first, status, target):
    """The same for lower factors, zero above the diagonal."""
    for lane in range(min(LANES, target.shape[0] - first)):
        if status[first + lane] == OK:
            for i in range(N):
                for j in range(N):
                    value = source[i * N + j, lane] if j <= i else 0.0
                    target[first + lane, i * N + j] = value


@njit(**FLOATING_POINT)
def _gather_measurement(measurement, noise, first, w):
    """Mark what arrived; what did not gets a harmless value and unit noise."""
    last = measurement.shape[0] - 1
    for lane in range(LANES):
        b = min(first + lane, last)
        w.count[0, lane] = 0.0
        for c in range(M):
            here = not isnan(measurement[b, c])
            w.z[c, lane] = measurement[b, c] if here else 0.0
            w.sd[c, lane] = noise[b, c] if here else 1.0
            w.arrived[c, lane] = 1.0 if here else 0.0
            w.count[0, lane] += w.arrived[c, lane]


@njit(**FLOATING_POINT)
def _is_finite(mean, factor, lane):
    """Whether a lane holds nothing infinite and no NaN."""
    for i in range(N):
        if not abs(mean[i, lane]) <= LARGEST:
            return False
        for j in range(i + 1):
            if not abs(factor[i * N + j, lane]) <= LARGEST:
                return False
    return True


@njit(**FLOATING_POINT)
def _assess(whitened, C, arrived, lane):
    """Normalised innovation squared and log-likelihood; NaN and 0 if nothing arrived."""
    squared, log_likelihood, count = 0.0, 0.0, 0.0
    for c in range(M):
        if arrived[c, lane] > 0.5:
            squared += whitened[c, lane] * whitened[c, lane]
            log_likelihood -= log(C[c * M + c, lane]) + 0.5 * log(TWO_PI)
            count += 1.0
    if count == 0.0:
        return nan, 0.0
    return squared, log_likelihood - 0.5 * squared


@njit(**FLOATING_POINT)
def _mark_missing(arrived, lane, b, innovation, variance, whitened):
    for c in range(M):
        if arrived[c, lane] < 0.5:
            innovation[b, c] = nan
            variance[b, c] = nan
            whitened[b, c] = nan


@entry_point
def predict(mean, factor, u, dt, scratch, new_mean, root, noise, status):
    """Time update of a batch. Filters whose status is not zero are left alone."""
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], LANES):
        _gather(mean, first, w.posterior)
        _gather(factor, first, w.S)
        _gather(u, first, w.u)
        _gather(dt, first, w.dt)
        _predict_lanes(w.posterior, w.S, w.u, load(w.dt, 0), w.predicted, w.L, w.Q, w.X)
        _scatter(w.predicted, first, status, new_mean)
        _scatter_factor(w.L, first, status, root)
        _scatter_factor(w.Q, first, status, noise)
        for lane in range(min(LANES, mean.shape[0] - first)):
            if status[first + lane] == OK and not _is_finite(w.predicted, w.L, lane):
                status[first + lane] = BAD_PREDICTION


@entry_point
def update(mean, root, noise, scales, s, measurement, deviation, scratch, correct,
           new_mean, new_factor, innovation, variance, whitened, nis, log_likelihood,
           status):  # fmt: skip
    """Measurement update of a batch; scales are the roots of fading and process scale (B, 2).

    Unless ``correct``, the innovation alone is formed and the predicted state returned.
    """
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], LANES):
        _gather(mean, first, w.predicted)
        _gather(root, first, w.S)
        _gather(noise, first, w.Q)
        _gather(scales, first, w.scales)
        _gather(s, first, w.s)
        _gather_measurement(measurement, deviation, first, w)
        _add_noise(w.S, load(w.scales, 0), w.Q, load(w.scales, 1), w.L, w.A)
        heard = _anything_arrived(w.count)
        if heard:
            _innovate_lanes(w)
        if correct:
            if heard:
                _correct_lanes(w)
            else:
                _keep_lanes(w)
            _scatter(w.posterior, first, status, new_mean)
            _scatter_factor(w.S, first, status, new_factor)
        else:
            _scatter(w.predicted, first, status, new_mean)
            _scatter_factor(w.L, first, status, new_factor)
        _scatter(w.innovation, first, status, innovation)
        _scatter(w.variance, first, status, variance)
        _scatter(w.whitened, first, status, whitened)
        for lane in range(min(LANES, mean.shape[0] - first)):
            b = first + lane
            if status[b] != OK:
                continue
            _mark_missing(w.arrived, lane, b, innovation, variance, whitened)
            nis[b], log_likelihood[b] = _assess(w.whitened, w.C, w.arrived, lane)
            if w.count[0, lane] > 0.5 and not abs(nis[b]) <= LARGEST:
                status[b] = BAD_INNOVATION
            elif correct and not _is_finite(w.posterior, w.S, lane):
                status[b] = BAD_UPDATE
            elif not correct and not _is_finite(w.predicted, w.L, lane):
                status[b] = BAD_PREDICTION


@entry_point
def run(mean, factor, dt, u, s, measurement, deviation, scales, scratch, means, nis, status,
        failed_at):  # fmt: skip
    """Filter whole recordings with constant knobs; posterior means (B, T, n)."""
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], LANES):
        lanes = min(LANES, mean.shape[0] - first)
        _gather(mean, first, w.posterior)
        _gather(factor, first, w.S)
        _gather(scales, first, w.scales)
        for t in range(measurement.shape[1]):
            if t > 0:
                _gather(u[:, t], first, w.u)
                _gather(dt[:, t], first, w.dt)
                _predict_lanes(w.posterior, w.S, w.u, load(w.dt, 0), w.predicted, w.L, w.Q, w.X)
            else:
                for k in range(N * N):
                    store(w.Q, k, spread(0.0))
                    store(w.L, k, load(w.S, k))
                for i in range(N):
                    store(w.predicted, i, load(w.posterior, i))
            for lane in range(lanes):
                if status[first + lane] == OK and not _is_finite(w.predicted, w.L, lane):
                    status[first + lane] = BAD_PREDICTION
                    failed_at[first + lane] = t
            for k in range(N * N):
                store(w.S, k, load(w.L, k))
            _gather(s[:, t], first, w.s)
            _gather_measurement(measurement[:, t], deviation[:, t], first, w)
            _add_noise(w.S, load(w.scales, 0), w.Q, load(w.scales, 1), w.L, w.A)
            if _anything_arrived(w.count):
                _innovate_lanes(w)
                _correct_lanes(w)
            else:
                _keep_lanes(w)
            for lane in range(lanes):
                b = first + lane
                if status[b] != OK:
                    continue
                nis[b, t] = _assess(w.whitened, w.C, w.arrived, lane)[0]
                if w.count[0, lane] > 0.5 and not abs(nis[b, t]) <= LARGEST:
                    status[b], failed_at[b] = BAD_INNOVATION, t
                elif not _is_finite(w.posterior, w.S, lane):
                    status[b], failed_at[b] = BAD_UPDATE, t
                else:
                    for i in range(N):
                        means[b, t, i] = w.posterior[i, lane]
