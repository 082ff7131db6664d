"""The full observation: what a learner with or without a memory of its own can tell faults by.

Of the innovations alone, their variances under nominal knobs, the noise that the filter is told,
and its estimate. One filter after the other in plain loops, as in `kfenv.envs.statistics`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, isnan, log, log1p, nan, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.envs.channels import AXES
from kfenv.envs.statistics import BOUND, bounded, signed_log
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Update
from kfenv.kernel_cache import INNER_KERNEL, KERNEL
from kfenv.models.model import Motion, Sensor

Array = NDArray[np.float64]

# Exponential windows, in arrivals: of squares, of signed values, of logs over the told noise
# and of products with the value before.
SQUARES, SIGNED, RATIOS, PRODUCTS = (3.0, 10.0, 30.0), (3.0, 10.0), (5.0, 20.0), 10.0
SMOOTHING = 1.0  # s, of an acceleration that the state does not hold
MOST = exp(BOUND)  # of a ratio: its log ends there
# Columns of a channel: means of n, then the others; n now is NaN where it is missing
LOG = len(SIGNED)
SQUARE, LAST, NOW, OVER, SHARE, LAGGED, CHANNEL_COLUMNS = range(LOG + 2, LOG + 9)
# and of a group: means of squares, then of signs, logs and products, the first told noise
# (the log of its square, NaN where there is none yet), and four features of the present
SIGN = len(SQUARES)
RATIO = SIGN + len(SIGNED)
PRODUCT, TOLD, PRESENT = range(RATIO + 2, RATIO + 5)
COLUMNS = PRESENT + 4
COMMON = 4  # the last two only where rates of what is scored are told
PER_CHANNEL = len(RATIOS) + len(SIGNED) + 3  # of those that have a knob


class Memory:
    """What B filters met so far in their episodes.

    Args:
        scenario: gives motion, sensor and scales.
        chosen: (K,) the channels whose knobs are exposed.
        batch: B.
    """

    def __init__(self, scenario: Any, chosen: NDArray[np.int64], batch: int) -> None:
        self._scenario, self._chosen = scenario, chosen
        motion, sensor = scenario.motion, scenario.sensor
        self._yardstick = yardstick = scenario.yardstick
        self._rates = np.array(yardstick.rates, np.int64)
        self._acceleration = accelerations(motion)
        self._group = np.array(sensor.group_of_channel)
        self._size = np.bincount(self._group)
        self._channels = np.zeros((batch, len(sensor.channels), CHANNEL_COLUMNS))
        self._groups = np.zeros((batch, len(sensor.groups), COLUMNS))
        self._origin = np.zeros((batch, len(yardstick)))
        self._last, self._change = np.zeros((2, batch, len(self._rates)))

    def restart(self, chosen: NDArray[np.int64], mean: Array) -> None:
        """Forget the episodes of these filters; new ones begin at the estimates (C, n)."""
        self._channels[chosen] = 0.0
        self._channels[chosen, :, SQUARE] = 1.0
        self._groups[chosen] = 0.0
        self._groups[chosen, :, : len(SQUARES)] = 1.0
        self._groups[chosen, :, TOLD] = np.nan
        self._change[chosen] = 0.0
        for place, start in zip(chosen, self._yardstick.values(mean), strict=True):
            self._origin[place] = self._scenario.local_frame(start)[0]

    def collect(
        self, pending: Update, told: Measurement, dt: Array, active: NDArray[np.bool_]
    ) -> None:
        """Take the pending innovations of the active filters into the memory.

        Args:
            pending: with nominal knobs.
            told: what arrived, with the noise that the filter is told.
            dt: (B,) since the instant before, s.
            active: (B,) which filters.
        """
        remember(
            pending.innovation, pending.variance, told.noise, self._group, self._chosen, active,
            self._channels, self._groups,
        )  # fmt: skip
        if not len(self._acceleration):
            differentiate(pending.mean, self._rates, dt, active, self._last, self._change)

    def observe(self, mean: Array, held: Array, pends: NDArray[np.bool_], out: Array) -> None:
        """Write the features into the first columns of (B, D).

        Args:
            mean: (B, n) predicted for the instants.
            held: (B,) for how long an action taken there will hold, s.
            pends: (B,) whether the measurement last collected waits for its update.
            out: (B, D) with a column for each feature at least.
        """
        at = tell_groups(self._group, self._size, pends, self._channels, self._groups, out)
        known, weight = len(self._acceleration) > 0, self._yardstick.weight
        turn = (mean, self._acceleration) if known else (self._change, np.arange(len(self._rates)))
        value = np.ascontiguousarray(self._yardstick.values(mean))
        tell_motion(
            value, self._origin, mean, self._rates, *turn, weight,
            np.ones(len(self._acceleration)) if known else weight,
            self._scenario.error_scale, held, out[:, at:],
        )  # fmt: skip
        at += len(common_features(self._rates))
        tell_channels(self._chosen, pends, self._channels, out[:, at:])

    def state(self) -> dict[str, Array]:
        """What is remembered, by name: arrays (B, ...) to be read or set."""
        return {
            "memory_channels": self._channels, "memory_groups": self._groups,
            "memory_origin": self._origin, "memory_last": self._last,
            "memory_change": self._change,
        }  # fmt: skip

    def feature_names(self) -> tuple[str, ...]:
        """What each of them is."""
        return feature_names(self._scenario.sensor, self._chosen, self._rates)


def feature_names(
    sensor: Sensor, chosen: Sequence[int] = (), rates: Sequence[int] = (0,)
) -> tuple[str, ...]:
    """What each feature is, with the chosen channels' own; `rates` are the yardstick's."""
    names: list[str] = []
    for group in sensor.groups:
        members = [channel.name for channel in sensor.channels if channel.group == group]
        if len(members) <= AXES:
            names += [f"{name}: {what}" for name in members for what in signed_features()]
        else:
            names += [f"{group}: {what}" for what in signed_features()[1:]]
        names += [f"{group}: {what}" for what in group_features(several=len(members) > 1)]
    names += common_features(rates)
    for channel in chosen:
        names += [f"{sensor.channels[channel].name} alone: {what}" for what in of_channel()]
    return tuple(names)


def accelerations(motion: Motion) -> NDArray[np.int64]:
    """Indices of the states that are accelerations: three or none."""
    return np.flatnonzero([state.unit == "m/s^2" for state in motion.states])


def signed_features() -> tuple[str, ...]:
    """What is told of the signs of a channel's, or a large group's, normalised innovations n."""
    means = (f"signed log of the mean of n over {window:g} arrivals" for window in SIGNED)
    return ("signed log of n now", *means)


def group_features(several: bool) -> tuple[str, ...]:
    """What is told of the sizes in a group of several channels, or of one."""
    return (
        "log RMS of n now",
        *(("log of the largest abs(n) now",) if several else ()),
        "log RMS of the innovation over the told noise now",
        "log of the told noise over the episode's first",
        *(f"log RMS of n over {window:g} arrivals" for window in SQUARES),
        *(f"mean log over the told noise over {window:g} arrivals" for window in RATIOS),
        f"signed log of the mean product of n and the one before over {PRODUCTS:g} arrivals",
    )


def common_features(rates: Sequence[int] = (0,)) -> tuple[str, ...]:
    """What is told of the flight as the filter sees it, and of the decision."""
    features = (
        "log of the seconds for which the action holds",
        "log(1 + distance of the estimate over the error scale)",
        "log(1 + estimated speed over a tenth of the error scale per second)",
        "log(1 + estimated acceleration over a hundredth of it per second squared)",
    )
    return features if len(rates) else features[: COMMON - 2]


def of_channel() -> tuple[str, ...]:
    """What is told of each channel that has a knob of its own."""
    return (
        "log of abs(innovation) over the told noise now",
        *(f"the mean of that over {window:g} arrivals" for window in RATIOS),
        *(f"signed log of the mean of n over {window:g} arrivals" for window in SIGNED),
        f"log RMS of n over {SQUARES[1]:g} arrivals",
        "share of the noise in the innovation variance",
    )


@njit(**KERNEL)
def remember(innovation, variance, noise, group_of_channel, chosen, active, channels, groups):
    """Take the innovations (B, m) of the active filters into the memory."""
    for b in range(innovation.shape[0]):
        if not active[b]:
            continue
        for c in range(innovation.shape[1]):
            row = channels[b, c]
            row[NOW] = nan
            if not isnan(innovation[b, c]):
                value = _capped(innovation[b, c] / sqrt(variance[b, c]))
                row[NOW] = value
                row[OVER] = _capped(innovation[b, c] / noise[b, c]) ** 2
                row[SHARE] = noise[b, c] ** 2 / variance[b, c]
                row[LAGGED] = value * row[LAST]
                row[LAST] = value
                for w in range(len(SIGNED)):
                    row[w] += (value - row[w]) / SIGNED[w]
        for k in range(chosen.shape[0]):
            row = channels[b, chosen[k]]
            if not isnan(row[NOW]):
                for w in range(len(RATIOS)):
                    row[LOG + w] += (_log_root(row[OVER]) - row[LOG + w]) / RATIOS[w]
                row[SQUARE] += (row[NOW] ** 2 - row[SQUARE]) / SQUARES[1]
        for g in range(groups.shape[1]):
            _remember_group(noise, group_of_channel, channels, b, g, groups)


@njit(**INNER_KERNEL)
def _remember_group(noise, group_of_channel, channels, b, g, groups):
    total, square, largest, over, lagged, told, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for c in range(group_of_channel.shape[0]):
        if group_of_channel[c] == g and not isnan(channels[b, c, NOW]):
            value = channels[b, c, NOW]
            total += value
            square += value * value
            largest = max(largest, value * value)
            over += channels[b, c, OVER]
            lagged += channels[b, c, LAGGED]
            told += noise[b, c] ** 2
            count += 1
    row = groups[b, g]
    row[PRESENT : PRESENT + 4] = 0.0
    if count == 0:
        return
    row[PRESENT] = _log_root(square / count)
    row[PRESENT + 1] = _log_root(largest)
    row[PRESENT + 2] = _log_root(over / count)
    told = log(told / count)
    if isnan(row[TOLD]):
        row[TOLD] = told
    row[PRESENT + 3] = bounded(0.5 * (told - row[TOLD]))
    for w in range(len(SQUARES)):
        row[w] += (square / count - row[w]) / SQUARES[w]
    for w in range(len(SIGNED)):
        row[SIGN + w] += (total / sqrt(count) - row[SIGN + w]) / SIGNED[w]
    for w in range(len(RATIOS)):
        row[RATIO + w] += (row[PRESENT + 2] - row[RATIO + w]) / RATIOS[w]
    row[PRODUCT] += (lagged / count - row[PRODUCT]) / PRODUCTS


@njit(**KERNEL)
def tell_groups(group_of_channel, size, pends, channels, groups, out):
    """Write what is told of the groups, zero for the present where nothing pends.

    Returns:
        The number of features.
    """
    at = 0
    for b in range(groups.shape[0]):
        at = 0
        for g in range(groups.shape[1]):
            if size[g] > AXES:
                for w in range(len(SIGNED)):
                    out[b, at + w] = signed_log(groups[b, g, SIGN + w])
                at += len(SIGNED)
            else:
                for c in range(channels.shape[1]):
                    if group_of_channel[c] == g:
                        now = channels[b, c, NOW]
                        out[b, at] = signed_log(now) if pends[b] and not isnan(now) else 0.0
                        for w in range(len(SIGNED)):
                            out[b, at + 1 + w] = signed_log(channels[b, c, w])
                        at += 1 + len(SIGNED)
            at = _tell_sizes(groups, size[g], pends, b, g, out, at)
    return at


@njit(**INNER_KERNEL)
def _tell_sizes(groups, size, pends, b, g, out, at):
    row = groups[b, g]
    for i in range(4):
        if i != 1 or size > 1:  # alone it is the largest
            out[b, at] = row[PRESENT + i] if pends[b] else 0.0
            at += 1
    for w in range(len(SQUARES)):
        out[b, at + w] = _log_root(row[w])
    at += len(SQUARES)
    for w in range(len(RATIOS)):
        out[b, at + w] = row[RATIO + w]
    at += len(RATIOS)
    out[b, at] = signed_log(row[PRODUCT])
    return at + 1


@njit(**KERNEL)
def tell_motion(
    value, origin, mean, rates, turn, acceleration, weight, turn_weight, error_scale, held, out
):  # fmt: skip
    """Write what is told of the decision and of the estimate, with its acceleration in `turn`."""
    for b in range(mean.shape[0]):
        out[b, 0] = bounded(log(held[b]))
        distance = _length(value[b] - origin[b], np.arange(len(value[b])), weight) / error_scale
        out[b, 1] = bounded(log1p(distance))
        if len(rates) > 0:
            speed = _length(mean[b], rates, weight) / (0.1 * error_scale)
            strength = _length(turn[b], acceleration, turn_weight) / (0.01 * error_scale)
            out[b, 2] = bounded(log1p(speed))
            out[b, 3] = bounded(log1p(strength))


@njit(**KERNEL)
def tell_channels(chosen, pends, channels, out):
    """Write what is told of the single channels that have a knob."""
    for b in range(channels.shape[0]):
        for k in range(chosen.shape[0]):
            row, at = channels[b, chosen[k]], k * PER_CHANNEL
            here = pends[b] and not isnan(row[NOW])
            out[b, at] = _log_root(row[OVER]) if here else 0.0
            at += 1
            for w in range(len(RATIOS)):
                out[b, at + w] = row[LOG + w]
            at += len(RATIOS)
            for w in range(len(SIGNED)):
                out[b, at + w] = signed_log(row[w])
            at += len(SIGNED)
            out[b, at] = _log_root(row[SQUARE])
            out[b, at + 1] = row[SHARE] if here else 0.0


@njit(**KERNEL)
def differentiate(mean, velocity, dt, active, last, change):
    """Follow how fast the estimated velocity changes, over about `SMOOTHING` seconds."""
    for b in range(mean.shape[0]):
        if not active[b]:
            continue
        for i in range(len(velocity)):
            now = mean[b, velocity[i]]
            if dt[b] > 0.0:  # not at the episode's first instant
                gain = 1.0 - exp(-dt[b] / SMOOTHING)
                change[b, i] += gain * ((now - last[b, i]) / dt[b] - change[b, i])
            last[b, i] = now


@njit(**INNER_KERNEL)
def _length(state, rows, weight):
    total = 0.0
    for i in range(len(rows)):
        total += (weight[i] * state[rows[i]]) ** 2
    return sqrt(total)


@njit(**INNER_KERNEL)
def _capped(value):
    return max(-MOST, min(MOST, value))


@njit(**INNER_KERNEL)
def _log_root(square):
    return bounded(0.5 * log(square + 1e-4))
