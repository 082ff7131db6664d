"""What the kernels do between a batch and its lanes; the same for every pair of models.

These functions know sizes from a batch's arrays, and the number of lanes from the type of the
working rows ``w`` (`kfenv.filters.engine.Scratch`). Numba compiles them once and keeps them,
where the templates' own are compiled for each pair.
"""

import sys
from math import isnan, log, nan

from numba import njit

from kfenv.models.namespaces.compiled import INNER, TWO_PI
from kfenv.models.namespaces.lanes import lanes_of, peek, poke, sqrt

LARGEST = sys.float_info.max
OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE = 0, 1, 2, 3


@njit(cache=True, **INNER)
def gather(source, first, target):
    """Lane l of the target takes row first + l of the source (B, K); the last row fills up."""
    last = source.shape[0] - 1
    for lane in range(lanes_of(target)):
        b = min(first + lane, last)
        for k in range(source.shape[1]):
            poke(target, k, lane, source[b, k])


@njit(cache=True, **INNER)
def gather_factor(source, first, target):
    """The same for lower factors (B, n, n): what they have above the diagonal is not read."""
    last, n = source.shape[0] - 1, source.shape[1]
    for lane in range(lanes_of(target)):
        b = min(first + lane, last)
        for i in range(n):
            for j in range(i + 1):
                poke(target, i * n + j, lane, source[b, i, j])


@njit(cache=True, **INNER)
def gather_posterior(mean, factor, u, dt, first, w):
    """What a prediction begins with."""
    gather(mean, first, w.posterior)
    gather_factor(factor, first, w.S)
    gather(u, first, w.u)
    last = dt.shape[0] - 1
    for lane in range(lanes_of(w.dt)):
        poke(w.dt, 0, lane, dt[min(first + lane, last)])


@njit(cache=True, **INNER)
def gather_prediction(mean, root, noise, first, w):
    """What an innovation begins with."""
    gather(mean, first, w.predicted)
    gather_factor(root, first, w.S)
    gather_factor(noise, first, w.Q)


@njit(cache=True, **INNER)
def gather_scales(fading, process_scale, first, w):
    """The roots of the two factors (B,) of covariances."""
    last = fading.shape[0] - 1
    for lane in range(lanes_of(w.scales)):
        b = min(first + lane, last)
        poke(w.scales, 0, lane, sqrt(fading[b]))
        poke(w.scales, 1, lane, sqrt(process_scale[b]))


@njit(cache=True, **INNER)
def gather_measurement(measurement, noise, first, w):
    """Mark what arrived; what did not gets a harmless value and unit noise.

    Returns how many channels any lane heard, whose numbers `order` then has in its first lane.
    """
    last = measurement.shape[0] - 1
    for lane in range(lanes_of(w.z)):
        b = min(first + lane, last)
        count = 0.0
        for c in range(measurement.shape[1]):
            here = not isnan(measurement[b, c])
            poke(w.z, c, lane, measurement[b, c] if here else 0.0)
            poke(w.sd, c, lane, noise[b, c] if here else 1.0)
            poke(w.arrived, c, lane, 1.0 if here else 0.0)
            count += 1.0 if here else 0.0
        poke(w.count, 0, lane, count)
    heard = 0
    for c in range(measurement.shape[1]):
        for lane in range(lanes_of(w.z)):
            if peek(w.arrived, c, lane) > 0.5:
                poke(w.order, heard, 0, float(c))
                heard += 1
                break
    return heard


@njit(cache=True, **INNER)
def anyone_runs(status, first, w):
    """Whether a block has a filter to work for."""
    for b in range(first, min(first + lanes_of(w.dt), status.shape[0])):
        if status[b] == OK:
            return True
    return False


@njit(cache=True, **INNER)
def scatter(source, lane, target, b):
    """Give a filter its lane back."""
    for k in range(target.shape[1]):
        target[b, k] = peek(source, k, lane)


@njit(cache=True, **INNER)
def scatter_factor(source, lane, target, b):
    """The same for a lower factor; what the target has above the diagonal is left alone."""
    n = target.shape[1]
    for i in range(n):
        for j in range(i + 1):
            target[b, i, j] = peek(source, i * n + j, lane)


@njit(cache=True, **INNER)
def scatter_prediction(w, first, status, mean, root, noise):
    """Give the running filters their prediction, or blame it."""
    for lane in range(min(lanes_of(w.dt), status.shape[0] - first)):
        b = first + lane
        if status[b] == OK:
            scatter(w.predicted, lane, mean, b)
            scatter_factor(w.L, lane, root, b)
            scatter_factor(w.Q, lane, noise, b)
            if not is_finite(w.predicted, w.L, lane, mean.shape[1]):
                status[b] = BAD_PREDICTION


@njit(cache=True, **INNER)
def scatter_update(
    w, first, skips, heard, corrects, status, mean, factor, innovation, variance, whitened, nis,
    log_likelihood,
):  # fmt: skip
    """Give the running filters their innovation and a state, the predicted one unless it
    corrects; or blame them."""
    n = mean.shape[1]
    for lane in range(min(lanes_of(w.dt), status.shape[0] - first)):
        b = first + lane
        if status[b] != OK:
            continue
        new_mean = w.posterior if corrects else w.predicted
        new_factor = w.S if corrects else w.L
        scatter(new_mean, lane, mean, b)
        scatter_factor(new_factor, lane, factor, b)
        for c in range(innovation.shape[1]):
            here = peek(w.arrived, c, lane) > 0.5
            innovation[b, c] = peek(w.innovation, c, lane) if here else nan
            variance[b, c] = peek(w.variance, c, lane) if here else nan
            whitened[b, c] = peek(w.whitened, c, lane) if here else nan
        nis[b], log_likelihood[b] = assess(w, skips, heard, lane, innovation.shape[1])
        if peek(w.count, 0, lane) > 0.5 and not abs(nis[b]) <= LARGEST:
            status[b] = BAD_INNOVATION
        elif not is_finite(new_mean, new_factor, lane, n):
            status[b] = BAD_UPDATE if corrects else BAD_PREDICTION


@njit(cache=True, **INNER)
def is_finite(mean, factor, lane, n):
    """Whether a lane holds nothing infinite and no NaN."""
    for i in range(n):
        if not abs(peek(mean, i, lane)) <= LARGEST:
            return False
        for j in range(i + 1):
            if not abs(peek(factor, i * n + j, lane)) <= LARGEST:
                return False
    return True


@njit(cache=True, **INNER)
def assess(w, skips, heard, lane, m):
    """Normalised innovation squared and log-likelihood; NaN and 0 if nothing arrived.

    C has a row for each channel, or, if it skips, for each that was heard.
    """
    squared, log_likelihood, count = 0.0, 0.0, 0.0
    for r in range(heard):
        c = int(peek(w.order, r, 0))
        if peek(w.arrived, c, lane) > 0.5:
            row = r if skips else c
            value = peek(w.whitened, c, lane)
            squared += value * value
            log_likelihood -= log(peek(w.C, row * m + row, lane)) + 0.5 * log(TWO_PI)
            count += 1.0
    if count == 0.0:
        return nan, 0.0
    return squared, log_likelihood - 0.5 * squared
