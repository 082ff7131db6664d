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


def in_coverage(
    east: Array,
    north: Array,
    up: Array,
    range_margin: float = 0.0,
    angle_margin: float = 0.0,
) -> NDArray[np.bool_]:
    """Say which positions the radar at the origin sees.

    Args:
        east, north, up: coordinates, which broadcast against each other, m.
        range_margin: how far inside the range limits to stay, m.
        angle_margin: how far inside the azimuth and elevation limits to stay, rad.

    Returns:
        Booleans of the common shape.
    """
    ground_squared = east * east + north * north
    height_squared = up * up
    range_squared = ground_squared + height_squared
    # Tangents instead of angles: no inverse function per sample.
    widest = np.tan(MAX_AZIMUTH - angle_margin)
    steepest = np.tan(np.where(up > 0.0, MAX_ELEVATION, -MIN_ELEVATION) - angle_margin)
    return (
        (range_squared >= (MIN_RANGE + range_margin) ** 2)
        & (range_squared <= (MAX_RANGE - range_margin) ** 2)
        & (np.abs(east) <= widest * north)
        & (height_squared <= steepest**2 * ground_squared)
    )


def place(
    rng: Generator, path: Array, anchor: Array, ground_range: tuple[float, float]
) -> Placement | None:
    """Turn and shift a path at random so that all of it lies in coverage.

    Args:
        rng: source of the angle, and of the distance and bearing where the anchor goes.
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
    goal = np.array([distance * np.sin(bearing), distance * np.cos(bearing)]).T
    placed = turn(path[:2] - anchor[:, None], angle) + goal[:, :, None]
    inside = in_coverage(placed[:, 0], placed[:, 1], path[2], RANGE_MARGIN, ANGLE_MARGIN)
    first = int(np.argmax(inside.all(axis=1)))
    if not inside[first].all():
        return None
    shift = goal[first] - turn(anchor[:, None], angle[first])[:, 0]
    return Placement(float(angle[first]), shift)


def turn(vectors: Array, angle: Array | float) -> Array:
    """Turn horizontal vectors (..., 2, N), east and north, clockwise.

    Args:
        vectors: of any unit.
        angle: one, or (M,) of which each turns the N vectors, rad.

    Returns:
        The turned vectors (..., 2, N), or (M, 2, N).
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    rotation = np.array([[cosine, sine], [-sine, cosine]])
    return np.moveaxis(rotation, (0, 1), (-2, -1)) @ vectors


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
