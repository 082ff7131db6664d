"""Where a radar sees its target, and how a flight is laid into that region."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]

# The radar faces north with its boresight 20 deg up (SPEC 4.2); targets are kept
# within 55 deg of it, 5 deg inside the array's own limit of 60 deg.
MIN_RANGE, MAX_RANGE = 1_500.0, 17_000.0  # m
MAX_AZIMUTH = np.radians(55.0)
MIN_ELEVATION, MAX_ELEVATION = np.radians(20.0 - 55.0), np.radians(20.0 + 55.0)

# A flight is checked once a second, against tighter limits, so that it may not leave
# coverage between two checks (bounds for 250 m/s, and 140 m/s at the smallest range).
CHECK_STEP = 1.0  # s
RANGE_MARGIN = 20.0  # m
ANGLE_MARGIN = np.radians(0.5)

CANDIDATES = 16  # placements tried at once


class Placement(NamedTuple):
    """A turn about the vertical and a horizontal shift.

    Attributes:
        angle: clockwise seen from above, so that it adds to headings, rad.
        shift: (2,) added to east and north after the turn, m.
    """

    angle: float
    shift: Array


def in_coverage(position: Array, range_margin: float = 0.0, angle_margin: float = 0.0) -> NDArray:
    """Say which positions the radar at the origin sees.

    Args:
        position: east, north and up along the first axis, (3, ...), m.
        range_margin: how far inside the range limits to stay, m.
        angle_margin: how far inside the azimuth and elevation limits to stay, rad.

    Returns:
        Booleans (...).
    """
    x, y, z = position
    ground_squared = x * x + y * y
    range_squared = ground_squared + z * z
    # Tangents instead of angles: no inverse function per sample.
    steepest = np.tan(np.where(z > 0.0, MAX_ELEVATION, -MIN_ELEVATION) - angle_margin)
    return (
        (range_squared >= (MIN_RANGE + range_margin) ** 2)
        & (range_squared <= (MAX_RANGE - range_margin) ** 2)
        & (np.abs(x) <= np.tan(MAX_AZIMUTH - angle_margin) * y)
        & (z * z <= steepest**2 * ground_squared)
    )


def place(
    rng: Generator, path: Array, anchor: Array, ground_range: tuple[float, float]
) -> Placement | None:
    """Turn and shift a path at random so that all of it lies in coverage.

    Args:
        rng: source of the angle, and of the range and bearing where the anchor goes.
        path: (3, N) points about a second apart, m.
        anchor: (2,) the point, east and north, that goes to the drawn place, m.
        ground_range: least and greatest horizontal distance of the anchor, m.

    Returns:
        The first of 16 drawn placements that keeps the path inside the limits by the
        margins above, or None where none does.
    """
    angle = rng.uniform(0.0, 2.0 * np.pi, CANDIDATES)
    distance = rng.uniform(*ground_range, CANDIDATES)
    bearing = rng.uniform(-MAX_AZIMUTH, MAX_AZIMUTH, CANDIDATES)
    goal = distance * np.array([np.sin(bearing), np.cos(bearing)])
    shift = goal - turn(anchor, angle)
    x, y = turn(path[:2, None, :], angle[:, None]) + shift[:, :, None]
    inside = in_coverage(
        np.stack([x, y, np.broadcast_to(path[2], x.shape)]), RANGE_MARGIN, ANGLE_MARGIN
    ).all(axis=1)
    best = int(np.argmax(inside))
    return Placement(float(angle[best]), shift[:, best]) if inside[best] else None


def turn(vector: Array, angle: Array | float) -> Array:
    """Turn horizontal vectors (2, ...), east and north, clockwise by the angle in rad."""
    sine, cosine = np.sin(angle), np.cos(angle)
    east, north = vector
    return np.stack([cosine * east + sine * north, cosine * north - sine * east])


def check_time(time: object) -> Array:
    """Return the times as an array (T,), or complain.

    Raises:
        ValueError: if they are not one or more finite, increasing numbers of seconds.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size == 0:
        raise ValueError(f"time must be a list of one or more seconds, got shape {time.shape}.")
    if not (np.diff(time) > 0.0).all() or not np.isfinite(time[[0, -1]]).all():
        raise ValueError("time must be finite and increase from each sample to the next.")
    return time
