"""Whether plots are in the units that their columns name, by how their target would move."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import gathered
from kfenv.models.model import Sensor
from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.scenario import MAX_RATE

Array = NDArray[np.float64]

SLOWEST_SCAN = 20.0  # s from plot to plot: no radar turns slower
SPAN = 10.0  # s over which speeds are told, so that noise averages out
STRETCH = 60.0  # s over which ranges alone tell a speed
CREEPING, PLAUSIBLE = 1.0, (10.0, 1000.0)  # m/s
NEAR = 1000.0  # m: who creeps within it may be given in kilometres
RADIANS = {"azimuth": 2.0 * np.pi, "elevation": 0.5 * np.pi}  # within which these would lie
ALIKE, SLOWER = 2.0, 3.0  # ratios of two speeds


def check_units(path: str, sensor: Sensor, time: Array, value: Array) -> None:
    """Complain of times, distances and angles in other units.

    Args:
        path: of the file, for complaints.
        sensor: whose channels are told.
        time: (N,) increasing, s.
        value: (N, m) in SI units, as the columns' names say, NaN where nothing was detected.

    Raises:
        ValueError: naming the column and the remedy.
    """
    seen = ~np.isnan(value).all(axis=1)
    check_pace(path, time[seen])
    whole = ~np.isnan(value).any(axis=1)
    gathered(
        partial(_check_metres, path, sensor, time[whole], value[whole]),
        partial(_check_degrees, path, sensor, time[whole], value[whole]),
    )


def check_pace(path: str, time: Array) -> None:
    """Complain of plots that come too rarely or too often to be timed in seconds."""
    usual = float(np.median(np.diff(time)))
    if usual > SLOWEST_SCAN:
        raise ValueError(
            f"{path}: column 't' advances by {usual:g} from plot to plot; if these are "
            f"milliseconds (or finer), divide it; more than {SLOWEST_SCAN:g} s is too slow."
        )
    if usual < 1.0 / MAX_RATE:
        raise ValueError(
            f"{path}: column 't' advances by {usual:.2g} s from plot to plot, and more than "
            f"{MAX_RATE:g} plots a second are too many: give seconds, or thin them out."
        )


def _check_metres(path: str, sensor: Sensor, time: Array, value: Array) -> None:
    speed = _speed(sensor, time, value)
    distance = np.linalg.norm(measured_positions(sensor, value), axis=1).max()
    low, high = PLAUSIBLE
    if speed < CREEPING and distance < NEAR and low <= 1000.0 * speed <= high:
        raise ValueError(
            f"{path}: taken as metres its target is within {distance:.3g} m and moves at "
            f"{speed:.2g} m/s: distances are in kilometres, it seems; multiply them by 1000."
        )


def _check_degrees(path: str, sensor: Sensor, time: Array, value: Array) -> None:
    """Angles against what ranges alone tell of a target that flies straight: (r^2)'' = 2 v^2."""
    names = [channel.name for channel in sensor.channels]
    angles = [names.index(name) for name in RADIANS if name in names]
    degrees = np.degrees(value[:, angles])
    if not angles or (np.abs(degrees) > [RADIANS[names[i]] for i in angles]).any():
        return
    turned = value.copy()
    turned[:, angles] = degrees  # if the numbers were radians
    distance = value[:, names.index("range")]
    told, other = (_across(sensor, time, reading, distance) for reading in (value, turned))
    alone = _across_by_ranges(time, distance)
    if max(alone, other) <= ALIKE * min(alone, other) and told < alone / SLOWER:
        columns = " and ".join(repr(f"{names[i]}_deg") for i in angles)
        raise ValueError(
            f"{path}: the ranges are those of a target that moves across at {alone:.0f} m/s; "
            f"{columns} agree as radians ({other:.0f} m/s), not as degrees ({told:.0f} m/s): "
            "multiply them by 180/pi."
        )


def _speed(sensor: Sensor, time: Array, value: Array) -> float:
    """Median over pairs of plots some seconds apart."""
    first, second = _pairs(time)
    position = measured_positions(sensor, value)
    moved = np.linalg.norm(position[second] - position[first], axis=1)
    return float(np.median(moved / (time[second] - time[first])))


def _across(sensor: Sensor, time: Array, value: Array, distance: Array) -> float:
    """The same of the motion across the line of sight."""
    first, second = _pairs(time)
    position = measured_positions(sensor, value)
    moved = np.sum((position[second] - position[first]) ** 2, axis=1)
    across = np.sqrt(np.maximum(moved - (distance[second] - distance[first]) ** 2, 0.0))
    return float(np.median(across / (time[second] - time[first])))


def _pairs(time: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    span = min(SPAN, 0.25 * (time[-1] - time[0]))
    first = np.flatnonzero(time <= time[-1] - span)
    return first, np.searchsorted(time, time[first] + span - 1e-9)


def _across_by_ranges(time: Array, distance: Array) -> float:
    """What parabolas through r^2 and r tell of it, the median over stretches."""
    squares = []
    edges = np.linspace(time[0], time[-1], max(1, int((time[-1] - time[0]) / STRETCH)) + 1)
    for begin, end in pairwise(edges):
        inside = (time >= begin) & (time <= end)
        if inside.sum() > 3:
            since = time[inside] - time[inside].mean()
            speed = np.polynomial.polynomial.polyfit(since, distance[inside] ** 2, 2)[2]
            rate = np.polynomial.polynomial.polyfit(since, distance[inside], 2)
            squares.append(speed - rate[1] ** 2 - 4.0 * rate[2] ** 2 * np.mean(since**2))
    return float(np.sqrt(np.maximum(np.median(squares), 0.0))) if squares else 0.0
