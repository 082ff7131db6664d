"""The full observation: what a learner with or without a memory of its own can tell faults by.

Of the innovations alone, their variances under nominal knobs, the noise that the filter is told,
and its estimate. One filter after the other in plain loops, as in `kfenv.envs.statistics`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, isnan, log, log1p, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.envs.channels import AXES
from kfenv.envs.statistics import BOUND, bounded, signed_log
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Update
from kfenv.models.model import Motion, Sensor

Array = NDArray[np.float64]

# Exponential windows, in arrivals: of squares, of signed values, of logs over the told noise
# and of products with the value before.
SQUARES, SIGNED, RATIOS, PRODUCTS = (3.0, 10.0, 30.0), (3.0, 10.0), (5.0, 20.0), 10.0
SMOOTHING = 1.0  # s, of an acceleration that the state does not hold
MOST = exp(BOUND)  # of a ratio: its log ends there
# Columns of a group: a mean per window, then the first told noise (0: none yet)
SIGN = len(SQUARES)
RATIO = SIGN + len(SIGNED)
PRODUCT, TOLD, COLUMNS = RATIO + 2, RATIO + 3, RATIO + 4
# and of a channel
LOG = len(SIGNED)
SQUARE, LAST, CHANNEL_COLUMNS = LOG + 2, LOG + 3, LOG + 4
COMMON = 4
PER_CHANNEL = len(RATIOS) + len(SIGNED) + 3  # of those that have a knob
STILL = np.zeros(3)
NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0)  # `_present` where nothing is


class Memory:
    """What B filters met so far in their episodes.

    Args:
        scenario: gives motion, sensor and scales.
        chosen: (K,) the channels whose knobs are exposed.
        held: (T,) for how long an action taken at each instant will hold, s.
        batch: B.
    """

    def __init__(self, scenario: Any, chosen: NDArray[np.int64], held: Array, batch: int) -> None:
        self._scenario, self._chosen, self._held = scenario, chosen, held
        motion, sensor = scenario.motion, scenario.sensor
        self._position, self._velocity = np.array(motion.position), np.array(motion.velocity)
        self._acceleration = accelerations(motion)
        self._group = np.array(sensor.group_of_channel)
        self._size = np.bincount(self._group)
        self._channels = np.zeros((batch, len(sensor.channels), CHANNEL_COLUMNS))
        self._groups = np.zeros((batch, len(sensor.groups), COLUMNS))
        self._origin, self._last, self._change = np.zeros((3, batch, 3))
        self._features = np.zeros((batch, len(self.feature_names())))

    def restart(self, chosen: NDArray[np.int64], mean: Array) -> None:
        """Forget the episodes of these filters; new ones begin at the estimates (C, n)."""
        self._channels[chosen] = 0.0
        self._channels[chosen, :, SQUARE] = 1.0
        self._groups[chosen] = 0.0
        self._groups[chosen, :, : len(SQUARES)] = 1.0
        self._change[chosen] = 0.0
        for place, start in zip(chosen, mean[:, self._position], strict=True):
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
            pending.innovation, pending.variance, told.noise, self._group, active,
            self._channels, self._groups,
        )  # fmt: skip
        if not len(self._acceleration):
            differentiate(pending.mean, self._velocity, dt, active, self._last, self._change)

    def observe(
        self, pending: Update, noise: Array, instant: NDArray[np.int64], pends: NDArray[np.bool_]
    ) -> Array:
        """The features (B, D), valid until the next call.

        Args:
            pending: with nominal knobs.
            noise: (B, m) deviations that the filter is told.
            instant: (B,) indices of the instants.
            pends: (B,) whether a measurement waits for its update.
        """
        now = pending.innovation, pending.variance, noise
        at = tell_groups(
            *now, self._group, self._size, pends, self._channels, self._groups, self._features
        )
        held, known = self._held[instant], len(self._acceleration) > 0
        turn = (pending.mean, self._acceleration) if known else (self._change, np.arange(3))
        tell_motion(
            pending.mean, self._position, self._velocity, self._origin, *turn,
            self._scenario.error_scale, held, self._features[:, at:],
        )  # fmt: skip
        alone = self._features[:, at + COMMON :]
        tell_channels(*now, self._chosen, pends, self._channels, alone)
        return self._features

    def feature_names(self) -> tuple[str, ...]:
        """What each of them is."""
        return feature_names(self._scenario.sensor, self._chosen)


def feature_names(sensor: Sensor, chosen: Sequence[int] = ()) -> tuple[str, ...]:
    """What each feature is, with the chosen channels' own."""
    names: list[str] = []
    for group in sensor.groups:
        members = [channel.name for channel in sensor.channels if channel.group == group]
        if len(members) <= AXES:
            names += [f"{name}: {what}" for name in members for what in signed_features()]
        else:
            names += [f"{group}: {what}" for what in signed_features()[1:]]
        names += [f"{group}: {what}" for what in group_features(several=len(members) > 1)]
    names += common_features()
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


def common_features() -> tuple[str, ...]:
    """What is told of the flight as the filter sees it, and of the decision."""
    return (
        "log of the seconds for which the action holds",
        "log(1 + distance of the estimate over the error scale)",
        "log(1 + estimated speed over a tenth of the error scale per second)",
        "log(1 + estimated acceleration over a hundredth of it per second squared)",
    )


def of_channel() -> tuple[str, ...]:
    """What is told of each channel that has a knob of its own."""
    return (
        "log of abs(innovation) over the told noise now",
        *(f"the mean of that over {window:g} arrivals" for window in RATIOS),
        *(f"signed log of the mean of n over {window:g} arrivals" for window in SIGNED),
        f"log RMS of n over {SQUARES[1]:g} arrivals",
        "share of the noise in the innovation variance",
    )


@njit(cache=True)
def remember(innovation, variance, noise, group_of_channel, active, channels, groups):
    """Take the innovations (B, m) of the active filters into the memory."""
    for b in range(innovation.shape[0]):
        if not active[b]:
            continue
        for g in range(groups.shape[1]):
            total, square, _, ratio, told, count = _present(
                innovation[b], variance[b], noise[b], group_of_channel, g
            )
            if count == 0:
                continue
            product = 0.0
            for c in range(innovation.shape[1]):
                if group_of_channel[c] == g and not isnan(innovation[b, c]):
                    value = _ratio(innovation[b, c], sqrt(variance[b, c]))
                    product += value * channels[b, c, LAST]
                    _remember_one(value, innovation[b, c], noise[b, c], channels[b, c])
            row = groups[b, g]
            for w in range(len(SQUARES)):
                row[w] += (square - row[w]) / SQUARES[w]
            for w in range(len(SIGNED)):
                row[SIGN + w] += (total - row[SIGN + w]) / SIGNED[w]
            for w in range(len(RATIOS)):
                row[RATIO + w] += (_log_root(ratio) - row[RATIO + w]) / RATIOS[w]
            row[PRODUCT] += (product / count - row[PRODUCT]) / PRODUCTS
            if row[TOLD] == 0.0:
                row[TOLD] = told


@njit
def _remember_one(value, innovation, noise, row):
    for w in range(len(SIGNED)):
        row[w] += (value - row[w]) / SIGNED[w]
    told = _log_root(_ratio(innovation, noise) ** 2)
    for w in range(len(RATIOS)):
        row[LOG + w] += (told - row[LOG + w]) / RATIOS[w]
    row[SQUARE] += (value * value - row[SQUARE]) / SQUARES[1]
    row[LAST] = value


@njit
def _present(innovation, variance, noise, group_of_channel, g):
    """Of a group's channels that arrived.

    Returns:
        Sum of n over the root of their number, mean and largest of n^2, mean of the squares over
        the told noise, RMS of the told noise, and their number.
    """
    total, square, largest, ratio, told, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for c in range(innovation.shape[0]):
        if group_of_channel[c] == g and not isnan(innovation[c]):
            value = _ratio(innovation[c], sqrt(variance[c]))
            total += value
            square += value * value
            largest = max(largest, value * value)
            ratio += _ratio(innovation[c], noise[c]) ** 2
            told += noise[c] ** 2
            count += 1
    many = max(count, 1)
    return total / sqrt(many), square / many, largest, ratio / many, sqrt(told / many), count


@njit(cache=True)
def tell_groups(
    innovation, variance, noise, group_of_channel, size, pends, channels, groups, out
):  # fmt: skip
    """Write what is told of the groups, zero for the present where nothing pends.

    Returns:
        The number of features.
    """
    at = 0
    for b in range(innovation.shape[0]):
        at = 0
        for g in range(groups.shape[1]):
            if size[g] > AXES:
                at = _tell_signed(groups[b, g, SIGN:RATIO], out[b], at)
            else:
                for c in range(innovation.shape[1]):
                    if group_of_channel[c] == g:
                        here = pends[b] and not isnan(innovation[b, c])
                        out[b, at] = signed_log(channels[b, c, LAST]) if here else 0.0
                        at = _tell_signed(channels[b, c, :LOG], out[b], at + 1)
            present = NOTHING
            if pends[b]:
                present = _present(innovation[b], variance[b], noise[b], group_of_channel, g)
            at = _tell_sizes(present, size[g], groups[b, g], out[b], at)
    return at


@njit
def _tell_sizes(present, size, row, out, at):
    _, square, largest, ratio, told, count = present
    here = count > 0
    out[at] = _log_root(square) if here else 0.0
    if size > 1:
        at += 1
        out[at] = _log_root(largest) if here else 0.0
    out[at + 1] = _log_root(ratio) if here else 0.0
    out[at + 2] = bounded(log(told / row[TOLD])) if here else 0.0
    at += 3
    for w in range(len(SQUARES)):
        out[at + w] = _log_root(row[w])
    at += len(SQUARES)
    for w in range(len(RATIOS)):
        out[at + w] = row[RATIO + w]
    out[at + len(RATIOS)] = signed_log(row[PRODUCT])
    return at + len(RATIOS) + 1


@njit
def _tell_signed(means, out, at):
    for w in range(means.shape[0]):
        out[at + w] = signed_log(means[w])
    return at + means.shape[0]


@njit(cache=True)
def tell_motion(
    mean, position, velocity, origin, turn, acceleration, error_scale, held, out
):  # fmt: skip
    """Write what is told of the decision and of the estimate, with its acceleration in `turn`."""
    for b in range(mean.shape[0]):
        out[b, 0] = bounded(log(held[b]))
        distance = _distance(mean[b], position, origin[b]) / error_scale
        speed = _distance(mean[b], velocity, STILL) / (0.1 * error_scale)
        strength = _distance(turn[b], acceleration, STILL) / (0.01 * error_scale)
        out[b, 1] = bounded(log1p(distance))
        out[b, 2] = bounded(log1p(speed))
        out[b, 3] = bounded(log1p(strength))


@njit(cache=True)
def tell_channels(innovation, variance, noise, chosen, pends, channels, out):
    """Write what is told of the single channels that have a knob."""
    for b in range(innovation.shape[0]):
        for k in range(chosen.shape[0]):
            c, at = chosen[k], k * PER_CHANNEL
            row = channels[b, c]
            here = pends[b] and not isnan(innovation[b, c])
            ratio = _ratio(innovation[b, c], noise[b, c]) if here else 0.0
            out[b, at] = _log_root(ratio * ratio) if here else 0.0
            for w in range(len(RATIOS)):
                out[b, at + 1 + w] = row[LOG + w]
            at = _tell_signed(row[: len(SIGNED)], out[b], at + 1 + len(RATIOS))
            out[b, at] = _log_root(row[SQUARE])
            out[b, at + 1] = noise[b, c] ** 2 / variance[b, c] if here else 0.0


@njit(cache=True)
def differentiate(mean, velocity, dt, active, last, change):
    """Follow how fast the estimated velocity changes, over about `SMOOTHING` seconds."""
    for b in range(mean.shape[0]):
        if not active[b]:
            continue
        for i in range(3):
            now = mean[b, velocity[i]]
            if dt[b] > 0.0:  # not at the episode's first instant
                gain = 1.0 - exp(-dt[b] / SMOOTHING)
                change[b, i] += gain * ((now - last[b, i]) / dt[b] - change[b, i])
            last[b, i] = now


@njit
def _distance(state, rows, origin):
    total = 0.0
    for i in range(3):
        total += (state[rows[i]] - origin[i]) ** 2
    return sqrt(total)


@njit
def _ratio(value, deviation):
    return max(-MOST, min(MOST, value / deviation))


@njit
def _log_root(square):
    return bounded(0.5 * log(square + 1e-4))
