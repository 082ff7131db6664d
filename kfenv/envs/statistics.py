"""Compiled arithmetic of the decision process: knobs, statistics of innovations, observations.

One filter after the other in plain loops, so that a filter alone and inside a batch
gets the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, isfinite, isnan, log, nan, sqrt

from numba import njit

from kfenv.addresses import arrays_at
from kfenv.kernel_cache import INNER_KERNEL, KERNEL

# Exponential windows of the squared innovations, in arrivals; the last one also
# serves the correlation.
WINDOWS = (3.0, 10.0, 30.0)
PER_GROUP = 7  # features of a channel group
COMMON = 3  # time since the last arrival, position deviation and, if it is told, velocity's
# Columns of the statistics of a group: a mean square per window, lag product, last value
LAG, LAST, COLUMNS = len(WINDOWS), len(WINDOWS) + 1, len(WINDOWS) + 2
BOUND = 10.0  # of every feature
RUNAWAY, RUNAWAY_WINDOW = 100.0, 1  # RMS of whitened innovations, and over which window
IDLE = -1  # status of a filter that has nothing to do


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


@njit(**KERNEL)
def bound_actions(action):
    """Bring actions (B, K) within [-1, 1]; whether none of them is NaN."""
    sound = True
    for b in range(action.shape[0]):
        for k in range(action.shape[1]):
            sound = sound and not isnan(action[b, k])
            action[b, k] = max(-1.0, min(1.0, action[b, k]))
    return sound


@njit(**KERNEL)
def turn_knobs(action, running, log_low, log_high, position, factors, last_action):
    """Write the factors of the exposed knobs; `position` is each one's place in `factors`.

    The last action is that of the running filters.
    """
    for b in range(action.shape[0]):
        for k in range(action.shape[1]):
            a = action[b, k]
            factors[b, position[k]] = exp(a * log_high[k]) if a >= 0.0 else exp(-a * log_low[k])
            if running[b]:
                last_action[b, k] = a


@njit(**KERNEL)
def apply_knobs(table, due, noise, active):
    """Write what the factors make of a filter's numbers, and the status to work by.

    Args:
        table: the addresses of factors, of the places (m,) in them of the knobs of each channel's
            group and of each channel, and (n,) of those of each state's group, -1 for none, ()
            without such knobs; of the factors (B, n, n) of the process noise, and the status;
            then of what is written: fading, scale of the process noise, deviations (B, m) that
            the filter is told, turned factors of the process noise where there are such knobs,
            status to work by.
        due: fading acts where the instant is one of the sensor's.
        noise: deviations (B, m).
    """
    (
        factors, group_knob, channel_knob, state_knob, process, status,
        fading, process_scale, told, turned, work,
    ) = arrays_at(table, "ff i i i fff i f f ff fff i")  # fmt: skip
    select(active, status, work)
    for b in range(factors.shape[0]):
        fading[b] = factors[b, 0] if due[b] else 1.0
        process_scale[b] = factors[b, 1]
        for c in range(noise.shape[1]):
            told[b, c] = noise[b, c] * factors[b, group_knob[c]] * factors[b, channel_knob[c]]
        for i in range(state_knob.shape[0]):
            deviation = sqrt(factors[b, state_knob[i]]) if state_knob[i] >= 0 else 1.0
            for j in range(process.shape[2]):
                turned[b, i, j] = process[b, i, j] * deviation


@njit(**KERNEL)
def select(active, status, work):
    """The status for filters to work by: idle where they are not active."""
    for b in range(work.shape[0]):
        work[b] = status[b] if active[b] else IDLE


@njit(**KERNEL)
def settle(work, active, status, mean, nis):
    """Take over how the active filters' updates ended; what a failed one gives means nothing."""
    for b in range(work.shape[0]):
        if active[b]:
            status[b] = work[b]
            if work[b] != 0:
                nis[b] = nan
                for i in range(mean.shape[1]):
                    mean[b, i] = nan


@njit(**KERNEL)
def notice(table, dt, active):
    """Take over how forming the innovations ended, and the innovations into the statistics.

    Args:
        table: the addresses of what `collect` is given, and of the status to be kept.
    """
    whitened, group_of_channel, statistics, since, work, status = arrays_at(table, "ff i fff f i i")
    for b in range(work.shape[0]):
        if active[b]:
            status[b] = work[b]
    collect(whitened, group_of_channel, statistics, since, dt, work)


@njit(**KERNEL)
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


@njit(**KERNEL)
def observe(table, sd, rows, error_scale, pending, out):
    """Write each filter's observation, without that of single channels and of a memory.

    Where nothing is pending (an episode's end) the group features of the present are zero.

    Args:
        table: the addresses of the innovations, whitened, and their variance; of the lines of the
            quantities that are scored, the factor of the states, and the lines of those that are
            the quantities' rates, if there are any; then of their weights, the channels' groups,
            the statistics, the seconds since something arrived, the last action, the status.
        sd: (B, m) deviations that the filter is told.
        rows: of the quantities.
    """
    (
        whitened, variance, lines, factor, rates, weight, group_of_channel, statistics, since,
        action, status,
    ) = arrays_at(table, "ff ff ii fff ii f i fff f ff i")  # fmt: skip
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
        out[b, at + 1] = bounded(log(deviation(rows[b], lines, weight) / error_scale))
        if rates.shape[1] > 0:
            rate = deviation(factor[b], rates, weight)
            out[b, at + 2] = bounded(log(rate / (0.1 * error_scale)))
    complete(action, status, out)


@njit(**KERNEL)
def complete(action, status, out):
    """Write the previous action behind the features, and zeros for a filter that has failed."""
    features = out.shape[1]
    for b in range(action.shape[0]):
        for k in range(action.shape[1]):
            out[b, features - action.shape[1] + k] = action[b, k]
        for k in range(features if status[b] != 0 else 0):
            out[b, k] = 0.0


@njit(**KERNEL)
def conceal(pends, innovation, variance):
    """NaN stands for innovations that do not wait for their update."""
    for b in range(innovation.shape[0]):
        if not pends[b]:
            for c in range(innovation.shape[1]):
                innovation[b, c] = variance[b, c] = nan


@njit(**KERNEL)
def tell_without_nan(estimate, innovation, variance, nis):
    """A missing channel tells zero with infinite variance; if all are missing the NIS is zero."""
    for b in range(innovation.shape[0]):
        for c in range(innovation.shape[1]):
            if isnan(variance[b, c]):
                innovation[b, c], variance[b, c] = 0.0, inf
        finite = True
        for i in range(estimate.shape[1]):
            finite = finite and isfinite(estimate[b, i])
        if isnan(nis[b]) and finite:
            nis[b] = 0.0


@njit(**INNER_KERNEL)
def signed_log(value):
    """sign(value) log(1 + abs(value)), within the bound of a feature."""
    return bounded(log(1.0 + value) if value >= 0.0 else -log(1.0 - value))


@njit(**INNER_KERNEL)
def bounded(value):
    """The value, or the bound of a feature beyond it."""
    return max(-BOUND, min(BOUND, value)) if not isnan(value) else nan


@njit(**INNER_KERNEL)
def deviation(factor, lines, weight):
    total = 0.0
    for i in range(lines.shape[1]):
        for k in range(lines[1, i]):
            total += (weight[i] * factor[lines[0, i], k]) ** 2
    return sqrt(total)
