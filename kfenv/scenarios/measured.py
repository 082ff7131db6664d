"""Measurements as positions, for pictures and where a filter begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Sensor

Array = NDArray[np.float64]


def measured_positions(sensor: Sensor, measurement: Array) -> Array | None:
    """Measurements (T, m) as positions (T, 3), NaN where a part of one is missing.

    None for a sensor that measures no position, such as a satellite receiver's
    pseudoranges: its film has no dots.
    """
    names = [channel.name for channel in sensor.channels]
    if {"pN", "pE", "pD"} <= set(names):
        north, east, down = (measurement[:, names.index(name)] for name in ("pN", "pE", "pD"))
        return np.stack([east, north, -down], axis=1)
    if {"x", "y", "z"} <= set(names):
        return measurement[:, [names.index(axis) for axis in "xyz"]]
    if not {"range", "azimuth", "elevation"} <= set(names):
        return None
    distance, azimuth, elevation = (
        measurement[:, names.index(name)] for name in ("range", "azimuth", "elevation")
    )
    horizontal = distance * np.cos(elevation)
    return np.stack(
        [
            horizontal * np.sin(azimuth),
            horizontal * np.cos(azimuth),
            distance * np.sin(elevation),
        ],
        axis=1,
    )


def measured_spreads(sensor: Sensor, measurement: Array, deviation: Array) -> Array:
    """How far (T, m, 3) a channel's deviation (T, m) moves the position of a measurement (T, m).

    The covariance of the position is the sum over the channels of their outer products.
    """
    moved = []
    for channel in range(measurement.shape[1]):
        off = np.zeros_like(measurement)
        off[:, channel] = deviation[:, channel]
        above, below = (
            measured_positions(sensor, measurement + sign * off) for sign in (1.0, -1.0)
        )
        moved.append(0.5 * (above - below))
    return np.stack(moved, axis=1)
