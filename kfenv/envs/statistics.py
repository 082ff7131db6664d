"""Compiled arithmetic of the decision process: knobs, scores, observations.

One filter after the other in plain loops, so that a filter alone and inside a batch
gets the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, floor, inf, isnan, log, nan, pi, sqrt

import numpy as np
from numba import njit

# Exponential windows of the squared innovations, in arrivals; the last one also
# serves the correlation.
WINDOWS = (3.0, 10.0, 30.0)
PER_GROUP = 7  # features of a channel group
COMMON = 3  # time since the last arrival, position deviation and, if it is told, velocity's
# Columns of the statistics of a group: a mean square per window, lag product, last value
LAG, LAST, COLUMNS = len(WINDOWS), len(WINDOWS) + 1, len(WINDOWS) + 2
BOUND = 10.0  # of every feature
TWO_PI = 2.0 * pi
RUNAWAY, RUNAWAY_WINDOW = 100.0, 1  # RMS of whitened innovations, and over which window


def common_size(rates: Sequence[int]) -> int:
    """Number of the common features: without rates of what is scored one less."""
    return COMMON if len(rates) else COMMON - 1


def feature_names(
    groups: Sequence[str], scored: str = "position", rates: Sequence[int] = (0,)
) -> tuple[str, ...]:
    """What each component of the observation is, but for the previous action.

    Args:
        scored, rates: name and rates of the yardstick.
    """
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
    rate = "velocity" if scored == "position" else f"{scored} rate"
    names.append(f"log {scored} deviation over the error scale")
    if len(rates):
        names.append(f"log {rate} deviation over a tenth of the error scale per second")
    return tuple(names)


@njit(cache=True, error_model="numpy")
def turn_knobs(action, log_low, log_high, position, factors):
    """Write the factors of the exposed knobs; `position` is each one's place in `factors`."""
    for b in range(action.shape[0]):
        for k in range(action.shape[1]):
            a = action[b, k]
            factors[b, position[k]] = exp(a * log_high[k]) if a >= 0.0 else exp(-a * log_low[k])


@njit(cache=True, error_model="numpy")
def score(mean, factor, truth, lines, weight, status, error, nees):
    """Error and NEES of what each running filter is scored by; see `Yardstick` for the lines.

    The NEES works on the factor's rows: their products lose the smaller of two deviations that
    differ by 1e8.
    """
    place, width, angle = lines[0], lines[1], lines[2]
    size, states = lines.shape[1], factor.shape[2]
    rows, e = np.zeros((size, states)), np.zeros(size)
    for b in range(mean.shape[0]):
        if status[b] != 0:
            continue
        squared = 0.0
        for i in range(size):
            off = mean[b, place[i]] - truth[b, place[i]]
            if angle[i]:
                off -= TWO_PI * floor(off / TWO_PI + 0.5)
            e[i] = weight[i] * off
            squared += e[i] * e[i]
            for k in range(states):
                rows[i, k] = weight[i] * factor[b, place[i], k] if k < width[i] else 0.0
        error[b] = sqrt(squared)
        nees[b] = _normalised_square(rows, e)


@njit(error_model="numpy")
def _normalised_square(rows, e):
    """e^T (R R^T)^-1 e from the rows of R, by modified Gram-Schmidt; both are used up.

    NaN where the rows depend on each other, so that R R^T is not positive definite.
    """
    total = 0.0
    size = len(e)
    for i in range(size):
        length = sqrt(_product(rows[i], rows[i]))
        if not 0.0 < length < inf:
            return nan
        rows[i] /= length
        e[i] /= length
        total += e[i] * e[i]
        for j in range(i + 1, size):
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
def note_runaways(statistics, factor, lines, weight, lost_distance, active, error):
    """Put the error just above the loss distance where it is unknown and all speaks for a loss.

    That is: innovations a hundred times what the filter expects, in the mean square over some
    ten measurements, or a deviation by which the filter itself takes it for lost.
    """
    for b in range(error.shape[0]):
        if active[b] and isnan(error[b]):
            away = _deviation(factor[b], lines, weight) > lost_distance
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
    whitened, variance, sd, rows, lines, factor, rates, weight, error_scale, group_of_channel,
    statistics, since, pending, out,
):  # fmt: skip
    """Write each filter's observation, all but the previous action.

    Where nothing is pending (an episode's end) the group features of the present are zero.

    Args:
        rows, lines: of the quantities that are scored.
        factor, rates: of the states and those that are the quantities' rates, if there are any.
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
        out[b, at + 1] = bounded(log(_deviation(rows[b], lines, weight) / error_scale))
        if rates.shape[1] > 0:
            rate = _deviation(factor[b], rates, weight)
            out[b, at + 2] = bounded(log(rate / (0.1 * error_scale)))


@njit(error_model="numpy")
def signed_log(value):
    """sign(value) log(1 + abs(value)), within the bound of a feature."""
    return bounded(log(1.0 + value) if value >= 0.0 else -log(1.0 - value))


@njit(error_model="numpy")
def bounded(value):
    """The value, or the bound of a feature beyond it."""
    return max(-BOUND, min(BOUND, value)) if not isnan(value) else nan


@njit(error_model="numpy")
def _deviation(factor, lines, weight):
    total = 0.0
    for i in range(lines.shape[1]):
        for k in range(lines[1, i]):
            total += (weight[i] * factor[lines[0, i], k]) ** 2
    return sqrt(total)
