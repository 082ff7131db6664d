"""Which satellite a receiver's channel follows, and when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import CHANNELS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def assign_channels(visible: NDArray[np.bool_], elevation: Array) -> Indices:
    """The satellite in each channel at each epoch, (E, 12), or -1.

    A satellite keeps its channel for as long as it is visible, so that others may rise
    and set without disturbing it. Free channels go to the highest visible satellite
    without one; with more than twelve visible, the rest wait until a channel is free.

    Args:
        visible: (E, K) whether a satellite can be used at an epoch.
        elevation: (E, K) in any unit; of satellites that can be used, not NaN.
    """
    channel = np.full((len(visible), CHANNELS), -1)
    now = np.full(CHANNELS, -1)
    changed = np.append(True, (visible[1:] != visible[:-1]).any(axis=1))
    for epoch, seen in enumerate(visible):
        if not changed[epoch]:
            channel[epoch] = now
            continue
        now[(now >= 0) & ~seen[now]] = -1
        free = np.flatnonzero(now < 0)
        waiting = np.setdiff1d(np.flatnonzero(seen), now)
        if len(free) and len(waiting):
            highest = waiting[np.argsort(-elevation[epoch, waiting], kind="stable")]
            chosen = highest[: len(free)]
            now[free[: len(chosen)]] = chosen
        channel[epoch] = now
    return channel


def by_channel(values: Array, channel: Indices, idle: float) -> Array:
    """Satellites' values as those of channels, `idle` where there is none.

    Args:
        values: (..., K) of satellites, or (..., K, d) with channels (..., 12) alike in front.
        channel: (..., 12) the satellite in each, or -1.
        idle: where it is -1.
    """
    empty = channel < 0
    place = np.where(empty, 0, channel)
    place = place if values.ndim == channel.ndim else place[..., None]
    chosen = np.take_along_axis(values, place, axis=channel.ndim - 1)
    chosen[empty] = idle
    return chosen
