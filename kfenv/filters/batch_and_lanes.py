"""What the kernels do between a batch and its lanes; the same for every pair of models.

These functions know sizes from a batch's arrays, and the number of lanes from the type of the
working rows ``w`` (`kfenv.filters.engine.Scratch`). Numba compiles them once and keeps them,
where the templates' own are compiled for each pair.
"""

import sys
from math import log, nan

from numba import njit

from kfenv.filters.transposed import abreast, hand_out, put, row_address
from kfenv.models.namespaces.compiled import INNER, TWO_PI
from kfenv.models.namespaces.lanes import lanes_of, load, peek, poke, sqrt, store, where_greater

LARGEST = sys.float_info.max
OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE = 0, 1, 2, 3


@njit(cache=True, **INNER)
def gather(source, first, target):
    """Lane l of the target takes row first + l of the source (B, K); the last row fills up."""
    for k in range(source.shape[1]):
        store(target, k, abreast(target, source, first, k))


@njit(cache=True, **INNER)
def gather_factor(source, first, target):
    """The same for lower factors (B, n, n): what they have above the diagonal is not read."""
    n = source.shape[1]
    for i in range(n):
        for k in range(i * n, i * n + i + 1):
            store(target, k, abreast(target, source, first, k))


@njit(cache=True, **INNER)
def gather_posterior(mean, factor, u, dt, first, w):
    """What a prediction begins with."""
    gather(mean, first, w.posterior)
    gather_factor(factor, first, w.S)
    gather(u, first, w.u)
    store(w.dt, 0, abreast(w.dt, dt, first, 0))


@njit(cache=True, **INNER)
def gather_prediction(mean, root, noise, first, w):
    """What an innovation begins with."""
    gather(mean, first, w.predicted)
    gather_factor(root, first, w.S)
    gather_factor(noise, first, w.Q)


@njit(cache=True, **INNER)
def gather_scales(fading, process_scale, first, w):
    """The roots of the two factors (B,) of covariances."""
    store(w.scales, 0, sqrt(abreast(w.scales, fading, first, 0)))
    store(w.scales, 1, sqrt(abreast(w.scales, process_scale, first, 0)))


@njit(cache=True, **INNER)
def gather_measurement(measurement, noise, first, w):
    """Mark what arrived; what did not gets a harmless value and unit noise.

    Returns how many channels any lane heard, whose numbers `order` then has in its first lane.
    """
    heard = 0
    for c in range(measurement.shape[1]):
        value = abreast(w.z, measurement, first, c)
        here = where_greater(abs(value), -1.0, 1.0, 0.0)  # not where it is NaN
        store(w.z, c, where_greater(here, 0.5, value, 0.0))
        store(w.sd, c, where_greater(here, 0.5, abreast(w.sd, noise, first, c), 1.0))
        store(w.arrived, c, here)
        store(w.count, 0, load(w.count, 0) + here if c > 0 else here)
        for lane in range(lanes_of(w.z)):
            if peek(w.arrived, c, lane) > 0.5:
                poke(w.order, heard, 0, float(c))
                heard += 1
                break
    return heard


@njit(cache=True, **INNER)
def who_runs(status, first, w):
    """Which lanes of a block have a filter to work for: a bit for each."""
    runs = 0
    for lane in range(min(lanes_of(w.dt), status.shape[0] - first)):
        runs |= (1 << lane) if status[first + lane] == OK else 0
    return runs


@njit(cache=True, **INNER)
def scatter(source, target, first, runs):
    """Give the filters that run their lanes back, in rows (B, K) of the target."""
    _scatter(source, target.shape[1], *row_address(target, first), runs)


@njit(cache=True, **INNER)
def scatter_factor(source, target, first, runs):
    """The same for lower factors (B, n, n), whose rows of lanes are zero above the diagonal."""
    _scatter(source, target.shape[1] * target.shape[1], *row_address(target, first), runs)


@njit(cache=True, **INNER)
def _scatter(source, count, address, stride, runs):
    lanes = lanes_of(source)
    if count >= lanes:
        for k in range(0, count, lanes):
            hand_out(source, min(k, count - lanes), address, stride, runs)
        return
    for lane in range(lanes):
        if runs >> lane & 1:
            for k in range(count):
                put(address + lane * stride, k, peek(source, k, lane))


@njit(cache=True, **INNER)
def scatter_prediction(w, first, runs, status, mean, root, noise):
    """Give the running filters their prediction, or blame it; returns who runs on."""
    scatter(w.predicted, mean, first, runs)
    scatter_factor(w.L, root, first, runs)
    scatter_factor(w.Q, noise, first, runs)
    find_unsound(w.predicted, w.L, mean.shape[1], w)
    for lane in range(lanes_of(w.dt)):
        if runs >> lane & 1 and not is_sound(w, lane):
            status[first + lane] = BAD_PREDICTION
            runs ^= 1 << lane
    return runs


@njit(cache=True, **INNER)
def scatter_update(
    w, first, runs, skips, heard, corrects, status, mean, factor, innovation, variance, whitened,
    nis, log_likelihood,
):  # fmt: skip
    """Give the running filters their innovation and a state, the predicted one unless it
    corrects; or blame them."""
    new_mean = w.posterior if corrects else w.predicted
    new_factor = w.S if corrects else w.L
    scatter(new_mean, mean, first, runs)
    scatter_factor(new_factor, factor, first, runs)
    find_unsound(new_mean, new_factor, mean.shape[1], w)
    for lane in range(lanes_of(w.dt)):
        if not runs >> lane & 1:
            continue
        b = first + lane
        for c in range(innovation.shape[1]):
            here = peek(w.arrived, c, lane) > 0.5
            innovation[b, c] = peek(w.innovation, c, lane) if here else nan
            variance[b, c] = peek(w.variance, c, lane) if here else nan
            whitened[b, c] = peek(w.whitened, c, lane) if here else nan
        nis[b], log_likelihood[b] = assess(w, skips, heard, lane, innovation.shape[1])
        if peek(w.count, 0, lane) > 0.5 and not abs(nis[b]) <= LARGEST:
            status[b] = BAD_INNOVATION
        elif not is_sound(w, lane):
            status[b] = BAD_UPDATE if corrects else BAD_PREDICTION


@njit(cache=True, **INNER)
def find_unsound(mean, factor, n, w):
    """Mark lanes that hold anything infinite or NaN, see `is_sound`."""
    total = 0.0 * load(mean, 0)
    for i in range(n):
        row = 0.0 * load(mean, i)
        for k in range(i * n, i * n + i + 1):
            row = row + 0.0 * load(factor, k)
        total = total + row
    store(w.unsound, 0, total)


@njit(cache=True, **INNER)
def is_sound(w, lane):
    """Whether a lane held nothing infinite and no NaN: zero times that is NaN."""
    return peek(w.unsound, 0, lane) == 0.0


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
