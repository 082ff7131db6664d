"""Compiled arithmetic of the decision process: knobs, scores, observations.

One filter after the other in plain loops, so that a filter alone and inside a batch
gets the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, isnan, log, nan, sqrt

import numpy as np
from numba import njit

# Exponential windows of the squared innovations, in arrivals; the last one also
# serves the correlation.
WINDOWS = (3.0, 10.0, 30.0)
PER_GROUP = 7  # features of a channel group
COMMON = 3  # time since the last arrival, position and velocity deviation
# Columns of the statistics of a group: a mean square per window, lag product, last value
LAG, LAST, COLUMNS = len(WINDOWS), len(WINDOWS) + 1, len(WINDOWS) + 2
BOUND = 10.0  # of every feature
RUNAWAY, RUNAWAY_WINDOW = 100.0, 1  # RMS of whitened innovations, and over which window


def feature_names(groups: Sequence[str]) -> tuple[str, ...]:
    """What each component of the observation is, but for the previous action."""
    names = []
    for group in groups:
        names.append(f"{group}: whitened innovation, signed log")
        names.extend(
            f"{group}: log RMS of whitened innovations, window {window:g}" for window in WINDOWS
        )
        names.append(f"{group}: lag-1 correlation of whitened innovations")
        names.append(f"{group}: share of channels that arrived")
        names.append(f"{group}: share of the noise in the innovation variance")
    names.append("log(1 + seconds since the last measurement)")
    names.append("log position deviation over the error scale")
    names.append("log velocity deviation over a tenth of the error scale per second")
    return tuple(names)


@njit(cache=True, error_model="numpy")
def turn_knobs(action, log_low, log_high, position, factors):
    """Write the factors of the exposed knobs; `position` is each one's place in `factors`."""
    for b in range(action.shape[0]):
        for k in range(action.shape[1]):
            a = action[b, k]
            factors[b, position[k]] = exp(a * log_high[k]) if a >= 0.0 else exp(-a * log_low[k])


@njit(cache=True, error_model="numpy")
def score(mean, factor, truth, position, status, error, nees):
    """Position error and position NEES (3 degrees of freedom) of each running filter.

    The NEES works on the factor's rows: their products lose the smaller of two deviations that
    differ by 1e8.
    """
    states = factor.shape[2]
    rows, e = np.zeros((3, states)), np.zeros(3)
    for b in range(mean.shape[0]):
        if status[b] != 0:
            continue
        squared = 0.0
        for i in range(3):
            e[i] = mean[b, position[i]] - truth[b, position[i]]
            squared += e[i] * e[i]
            for k in range(states):
                rows[i, k] = factor[b, position[i], k] if k <= position[i] else 0.0
        error[b] = sqrt(squared)
        nees[b] = _normalised_square(rows, e)


@njit(error_model="numpy")
def _normalised_square(rows, e):
    """e^T (R R^T)^-1 e from the rows of R, by modified Gram-Schmidt; both are used up.

    NaN where the rows depend on each other, so that R R^T is not positive definite.
    """
    total = 0.0
    for i in range(3):
        length = sqrt(_product(rows[i], rows[i]))
        if not 0.0 < length < inf:
            return nan
        rows[i] /= length
        e[i] /= length
        total += e[i] * e[i]
        for j in range(i + 1, 3):
            along = _product(rows[i], rows[j])
            rows[j] -= along * rows[i]
            e[j] -= along * e[i]
    return total


@njit(error_model="numpy")
def _product(one, other):
    total = 0.0
    for k in range(one.shape[0]):
        total += one[k] * other[k]
    return total


@njit(cache=True, error_model="numpy")
def note_runaways(statistics, factor, position, lost_distance, active, error):
    """Put the error just above the loss distance where it is unknown and all speaks for a loss.

    That is: innovations a hundred times what the filter expects, in the mean square over some
    ten measurements, or a position that the filter itself takes for lost.
    """
    for b in range(error.shape[0]):
        if active[b] and isnan(error[b]):
            away = _deviation(factor[b], position) > lost_distance
            for g in range(statistics.shape[1]):
                away = away or statistics[b, g, RUNAWAY_WINDOW] > RUNAWAY**2
            if away:
                error[b] = lost_distance * (1.0 + 1e-9)


@njit(cache=True, error_model="numpy")
def account(
    error, nees, status, nominal_error, lost_distance, index, active, lost,
    squared, nominal, total_nees, count,
):  # fmt: skip
    """Book an instant of each active filter, if its error is known, and move it on.

    A filter that has lost its track, or has reached its episode's end, becomes inactive;
    a lost one stays at the instant of the loss, whose error counts as the loss distance.
    """
    for b in range(error.shape[0]):
        if not active[b]:
            continue
        if not isnan(error[b]):
            squared[b] += min(error[b], lost_distance) ** 2
            nominal[b] += nominal_error[b, index[b]] ** 2
            total_nees[b] += nees[b]
            count[b] += 1.0
        if status[b] != 0 or error[b] > lost_distance:
            lost[b] = True
            active[b] = False
        else:
            index[b] += 1
            active[b] = index[b] < nominal_error.shape[1]


@njit(cache=True, error_model="numpy")
def collect(whitened, group_of_channel, statistics, since, dt, status):
    """Take a pending innovation into the running statistics of each running filter."""
    groups = statistics.shape[1]
    for b in range(whitened.shape[0]):
        if status[b] != 0:
            continue
        arrived = False
        for g in range(groups):
            total, squared, count = 0.0, 0.0, 0
            for c in range(whitened.shape[1]):
                if group_of_channel[c] == g and not isnan(whitened[b, c]):
                    total += whitened[b, c]
                    squared += whitened[b, c] ** 2
                    count += 1
            if count == 0:
                continue
            arrived = True
            value = total / sqrt(count)
            row = statistics[b, g]
            for w in range(len(WINDOWS)):
                row[w] += (squared / count - row[w]) / WINDOWS[w]
            row[LAG] += (value * row[LAST] - row[LAG]) / WINDOWS[-1]
            row[LAST] = value
        since[b] = 0.0 if arrived else since[b] + dt[b]


@njit(cache=True, error_model="numpy")
def observe(
    whitened, variance, sd, factor, position, velocity, error_scale, group_of_channel,
    statistics, since, pending, out,
):  # fmt: skip
    """Write each filter's observation, all but the previous action.

    Where nothing is pending (an episode's end) the group features of the present are zero.
    """
    groups = statistics.shape[1]
    for b in range(whitened.shape[0]):
        for g in range(groups):
            total, share, count, channels = 0.0, 0.0, 0, 0
            for c in range(whitened.shape[1]):
                if group_of_channel[c] != g:
                    continue
                channels += 1
                if pending[b] and not isnan(whitened[b, c]):
                    total += whitened[b, c]
                    share += sd[b, c] ** 2 / variance[b, c]
                    count += 1
            at = g * PER_GROUP
            row = statistics[b, g]
            out[b, at] = signed_log(total / sqrt(count)) if count > 0 else 0.0
            for w in range(len(WINDOWS)):
                out[b, at + 1 + w] = bounded(0.5 * log(row[w] + 1e-4))
            out[b, at + 4] = max(-1.0, min(1.0, row[LAG] / (row[len(WINDOWS) - 1] + 1e-4)))
            out[b, at + 5] = count / channels
            out[b, at + 6] = share / count if count > 0 else 0.0
        at = groups * PER_GROUP
        out[b, at] = bounded(log(1.0 + since[b]))
        out[b, at + 1] = bounded(log(_deviation(factor[b], position) / error_scale))
        out[b, at + 2] = bounded(log(_deviation(factor[b], velocity) / (0.1 * error_scale)))


@njit(error_model="numpy")
def signed_log(value):
    """sign(value) log(1 + abs(value)), within the bound of a feature."""
    return bounded(log(1.0 + value) if value >= 0.0 else -log(1.0 - value))


@njit(error_model="numpy")
def bounded(value):
    """The value, or the bound of a feature beyond it."""
    return max(-BOUND, min(BOUND, value)) if not isnan(value) else nan


@njit(error_model="numpy")
def _deviation(factor, rows):
    total = 0.0
    for i in range(rows.shape[0]):
        for k in range(rows[i] + 1):
            total += factor[rows[i], k] ** 2
    return sqrt(total)
