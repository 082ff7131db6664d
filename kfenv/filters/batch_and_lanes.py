"""What the kernels do between a batch and its lanes; the same for every pair of models.

These functions know sizes from their arrays alone. Numba compiles them once and keeps them,
where the templates' own are compiled for each pair.
"""

import sys
from math import isnan, log, nan

from numba import njit

from kfenv.models.namespaces.compiled import INNER, TWO_PI
from kfenv.models.namespaces.lanes import LANES, sqrt

LARGEST = sys.float_info.max
OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE = 0, 1, 2, 3


@njit(cache=True, **INNER)
def gather(source, first, target):
    """Lane l of the target takes row first + l of the source (B, K); the last row fills up."""
    last = source.shape[0] - 1
    for lane in range(LANES):
        b = min(first + lane, last)
        for k in range(source.shape[1]):
            target[k, lane] = source[b, k]


@njit(cache=True, **INNER)
def gather_scales(fading, process_scale, first, w):
    """The roots of the two factors (B,) of covariances."""
    last = fading.shape[0] - 1
    for lane in range(LANES):
        b = min(first + lane, last)
        w.scales[0, lane] = sqrt(fading[b])
        w.scales[1, lane] = sqrt(process_scale[b])


@njit(cache=True, **INNER)
def anyone_runs(status, first):
    """Whether a block has a filter to work for."""
    for b in range(first, min(first + LANES, status.shape[0])):
        if status[b] == OK:
            return True
    return False


@njit(cache=True, **INNER)
def rows(matrices):
    """Matrices (B, n, n) as rows (B, n * n), without a copy."""
    return matrices.reshape((matrices.shape[0], matrices.shape[1] * matrices.shape[2]))


@njit(cache=True, **INNER)
def scatter(source, first, status, target):
    """Give each running filter its lane back."""
    for lane in range(min(LANES, target.shape[0] - first)):
        if status[first + lane] == OK:
            for k in range(target.shape[1]):
                target[first + lane, k] = source[k, lane]


@njit(cache=True, **INNER)
def scatter_factor(source, first, status, target, n):
    """The same for lower factors (n, n), zero above the diagonal."""
    for lane in range(min(LANES, target.shape[0] - first)):
        if status[first + lane] == OK:
            for i in range(n):
                for j in range(n):
                    value = source[i * n + j, lane] if j <= i else 0.0
                    target[first + lane, i * n + j] = value


@njit(cache=True, **INNER)
def gather_measurement(measurement, noise, first, w):
    """Mark what arrived; what did not gets a harmless value and unit noise.

    Returns how many channels any lane heard, whose numbers `order` then has in its first lane.
    """
    last = measurement.shape[0] - 1
    for lane in range(LANES):
        b = min(first + lane, last)
        w.count[0, lane] = 0.0
        for c in range(measurement.shape[1]):
            here = not isnan(measurement[b, c])
            w.z[c, lane] = measurement[b, c] if here else 0.0
            w.sd[c, lane] = noise[b, c] if here else 1.0
            w.arrived[c, lane] = 1.0 if here else 0.0
            w.count[0, lane] += w.arrived[c, lane]
    heard = 0
    for c in range(measurement.shape[1]):
        for lane in range(LANES):
            if w.arrived[c, lane] > 0.5:
                w.order[heard, 0] = c
                heard += 1
                break
    return heard


@njit(cache=True, **INNER)
def is_finite(mean, factor, lane):
    """Whether a lane holds nothing infinite and no NaN."""
    n = mean.shape[0]
    for i in range(n):
        if not abs(mean[i, lane]) <= LARGEST:
            return False
        for j in range(i + 1):
            if not abs(factor[i * n + j, lane]) <= LARGEST:
                return False
    return True


@njit(cache=True, **INNER)
def assess(w, skips, heard, lane):
    """Normalised innovation squared and log-likelihood; NaN and 0 if nothing arrived.

    C has a row for each channel, or, if it skips, for each that was heard.
    """
    m = w.arrived.shape[0]
    squared, log_likelihood, count = 0.0, 0.0, 0.0
    for r in range(heard):
        c = int(w.order[r, 0])
        if w.arrived[c, lane] > 0.5:
            row = r if skips else c
            squared += w.whitened[c, lane] * w.whitened[c, lane]
            log_likelihood -= log(w.C[row * m + row, lane]) + 0.5 * log(TWO_PI)
            count += 1.0
    if count == 0.0:
        return nan, 0.0
    return squared, log_likelihood - 0.5 * squared


@njit(cache=True, **INNER)
def mark_missing(arrived, lane, b, innovation, variance, whitened):
    for c in range(arrived.shape[0]):
        if arrived[c, lane] < 0.5:
            innovation[b, c] = nan
            variance[b, c] = nan
            whitened[b, c] = nan
