"""Compiled arithmetic of episodes: what arrives, errors against the truth, sums, ends.

One filter after the other in plain loops, as in `kfenv.envs.statistics`.
"""

from __future__ import annotations

from math import floor, inf, isnan, nan, pi, sqrt

import numpy as np
from numba import njit

from kfenv.addresses import arrays_at
from kfenv.envs.statistics import RUNAWAY, RUNAWAY_WINDOW, deviation, select
from kfenv.kernel_cache import INNER_KERNEL, KERNEL

TWO_PI = 2.0 * pi


@njit(**KERNEL)
def arrive(table, steps_per_measurement):
    """Take what episodes (B, T, ...) hold at each filter's index, or at the last one beyond it.

    Args:
        table: the addresses of the index, of the episodes, and of what is taken; of that `due`
            (B,) is whether the instant is one of the sensor's, and `held` (B,) the seconds from
            the instant before, at first those to the next.
    """
    (
        index, measurement, noise, sensor_inputs, motion_inputs, dt, truth, scored,
        value, told, sensor_input, motion_input, passed, due, here, known, held,
    ) = arrays_at(table, "i fff fff fff fff ff fff ff ff ff ff ff f b ff b f")  # fmt: skip
    last = dt.shape[1] - 1
    for b in range(index.shape[0]):
        t = min(index[b], last)
        for c in range(value.shape[1]):
            value[b, c] = measurement[b, t, c]
            told[b, c] = noise[b, t, c]
        for c in range(sensor_input.shape[1]):
            sensor_input[b, c] = sensor_inputs[b, t, c]
        for c in range(motion_input.shape[1]):
            motion_input[b, c] = motion_inputs[b, t, c]
        for c in range(here.shape[1]):
            here[b, c] = truth[b, t, c]
        known[b] = scored[b, t] != 0.0
        passed[b] = dt[b, t]
        held[b] = dt[b, min(max(t, 1), last)]
        due[b] = index[b] % steps_per_measurement == 0


@njit(**KERNEL)
def score(mean, factor, truth, lines, weight, status, error, nees):
    """Error and NEES of what each running filter is scored by; see `Yardstick` for the lines.

    The NEES works on the factor's rows: their products lose the smaller of two deviations that
    differ by 1e8.
    """
    place, width, angle = lines[0], lines[1], lines[2]
    size, states = lines.shape[1], factor.shape[2]
    rows, e = np.empty((size, states)), np.empty(size)
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


@njit(**INNER_KERNEL)
def _normalised_square(rows, e):
    """e^T (R R^T)^-1 e from the rows of R, by modified Gram-Schmidt; both are used up.

    NaN where the rows depend on each other, so that R R^T is not positive definite. Entry by
    entry: whole rows at once take seconds to compile.
    """
    total = 0.0
    size, states = rows.shape
    for i in range(size):
        length = sqrt(_product(rows, i, i))
        if not 0.0 < length < inf:
            return nan
        for k in range(states):
            rows[i, k] /= length
        e[i] /= length
        total += e[i] * e[i]
        for j in range(i + 1, size):
            along = _product(rows, i, j)
            for k in range(states):
                rows[j, k] -= along * rows[i, k]
            e[j] -= along * e[i]
    return total


@njit(**INNER_KERNEL)
def _product(rows, i, j):
    total = 0.0
    for k in range(rows.shape[1]):
        total += rows[i, k] * rows[j, k]
    return total


@njit(**KERNEL)
def assess(
    mean, rows, truth, known, lines, weight, statistics, lost_distance, active, status, work,
    error, nees,
):  # fmt: skip
    """Error and NEES of the active filters: NaN where unknown, of failed ones that of a loss.

    Args:
        truth: (B, n), or (B, 0) where there is none.
        known: whether the truth says anything of the instant.
        work: (B,) is overwritten.
    """
    select(active, status, work)
    if truth.shape[1] > 0:
        score(mean, rows, truth, lines, weight, work, error, nees)
        for b in range(error.shape[0]):
            if active[b] and not known[b]:
                error[b] = nees[b] = nan
    note_runaways(statistics, rows, lines, weight, lost_distance, active, error)
    for b in range(error.shape[0]):
        if active[b] and status[b] != 0:
            error[b], nees[b] = lost_distance, nan


@njit(**INNER_KERNEL)
def note_runaways(statistics, factor, lines, weight, lost_distance, active, error):
    """Put the error just above the loss distance where it is unknown and all speaks for a loss.

    That is: innovations a hundred times what the filter expects, in the mean square over some
    ten measurements, or a deviation by which the filter itself takes it for lost.
    """
    for b in range(error.shape[0]):
        if active[b] and isnan(error[b]):
            away = deviation(factor[b], lines, weight) > lost_distance
            for g in range(statistics.shape[1]):
                away = away or statistics[b, g, RUNAWAY_WINDOW] > RUNAWAY**2
            if away:
                error[b] = lost_distance * (1.0 + 1e-9)


@njit(**KERNEL)
def account(
    error, nees, status, nominal_error, lost_distance, index, active, lost,
    squared, nominal, total_nees, count, known_error,
):  # fmt: skip
    """Book an instant of each active filter, if its error is known, and move it on.

    A filter that has lost its track, or has reached its episode's end, becomes inactive;
    a lost one stays at the instant of the loss, whose error counts as the loss distance.

    Returns:
        Whether one goes on.
    """
    goes_on = False
    for b in range(error.shape[0]):
        if not active[b]:
            continue
        if not isnan(error[b]):
            known_error[b] = error[b]
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
        goes_on = goes_on or active[b]
    return goes_on


@njit(**KERNEL)
def take_stock(table, mean, rows, truth, active, lost_distance, begins):
    """`assess` and `account` for an instant, with empty sums where the decision begins.

    Args:
        table: the addresses of all else that these two are given, and of the instant at which
            each active filter was scored.
    """
    (
        known, lines, weight, statistics, status, work, error, nees, nominal_error, index,
        scored, lost, squared, nominal, total_nees, count, known_error,
    ) = arrays_at(table, "b ii f fff i i f f ff i i b f f f f f")  # fmt: skip
    for b in range(error.shape[0]):
        if begins:
            squared[b] = nominal[b] = count[b] = 0.0
            known_error[b] = nan
        if active[b]:
            scored[b] = index[b]
    assess(
        mean, rows, truth, known, lines, weight, statistics, lost_distance, active, status, work,
        error, nees,
    )  # fmt: skip
    return account(
        error, nees, status, nominal_error, lost_distance, index, active, lost, squared, nominal,
        total_nees, count, known_error,
    )  # fmt: skip


@njit(**KERNEL)
def close(table, running, steps, lost_now, ended):
    """Add a decision's sums to the episodes', and tell whose ended by it, and how.

    Args:
        table: the addresses of the decision's last error, its sum of squares and their count, of
            what `waiting` is given and tells, and of the episodes' error, sum and count.
    """
    known_error, squared, count, lost, index, status, pends, error, total_squared, total_count = (
        arrays_at(table, "f f f b i i b f f f")
    )
    waiting(index, steps, lost, status, pends)
    for b in range(error.shape[0]):
        total_squared[b] += squared[b]
        total_count[b] += count[b]
        lost_now[b] = running[b] and lost[b]
        ended[b] = running[b] and not lost[b] and index[b] >= steps
        if running[b]:
            error[b] = known_error[b]


@njit(**KERNEL)
def recall(scored, times, truths, time, truth):
    """Copy time and truth of the instant that each filter was scored at last."""
    for b in range(scored.shape[0]):
        time[b] = times[b, scored[b]]
        for i in range(truth.shape[1]):
            truth[b, i] = truths[b, scored[b], i]


@njit(**KERNEL)
def waiting(index, steps, lost, status, pends):
    """Whether a measurement waits for its update; not where the episode is over."""
    for b in range(index.shape[0]):
        pends[b] = index[b] < steps and not lost[b] and status[b] == 0
