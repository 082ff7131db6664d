"""Where a radar sees its target, and how a flight is laid into that region."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.kernel_cache import INNER_KERNEL, KERNEL
from kfenv.scenarios.draws import Draws

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
    limits = _limits(range_margin, angle_margin)
    return _sees.py_func(*map(np.asarray, (east, north, up)), limits)


def place(
    rng: Generator, path: Array, anchor: Array, ground_range: tuple[float, float]
) -> Placement | None:
    """Turn and shift a path (3, N) at random, see `places`; None where no drawn one fits."""
    found, angle, shift = places([rng], path[:, None], anchor[:, None], ground_range)
    return Placement(float(angle[0]), shift[:, 0]) if found[0] else None


def places(
    rngs: Sequence[Generator], path: Array, anchor: Array, ground_range: tuple[float, float]
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Turn and shift paths at random so that all of each lies in coverage.

    Args:
        rngs: B sources of the angle, and of the distance and bearing where the anchor goes.
        path: (3, B, N) points about a second apart, m.
        anchor: (2, B) the point, east and north, that goes to the drawn place, m.
        ground_range: least and greatest horizontal distance of the anchor, m.

    Returns:
        Of the first of 16 drawn placements that keeps a path inside the limits by the margins
        above: whether there is one (B,), its angle (B,) and shift (2, B).
    """
    draws = Draws(rngs, 3 * CANDIDATES)
    angles = draws.uniform(0.0, 2.0 * np.pi, CANDIDATES)
    distance = draws.uniform(*ground_range, CANDIDATES)
    bearing = draws.uniform(-MAX_AZIMUTH, MAX_AZIMUTH, CANDIDATES)
    goal = np.stack([distance * np.sin(bearing), distance * np.cos(bearing)], axis=-1)
    first = np.empty(len(rngs), np.int64)
    limits = _limits(RANGE_MARGIN, ANGLE_MARGIN)
    _first_inside(*map(np.ascontiguousarray, (path, anchor, angles, goal)), limits, first)
    chosen = np.arange(len(rngs)), first
    angle = angles[chosen]
    shift = goal[chosen].T - turn(anchor.T[..., None], angle)[..., 0].T
    return first >= 0, angle, shift


def turn(vectors: Array, angle: Array | float) -> Array:
    """Turn horizontal vectors, east and north, clockwise.

    Args:
        vectors: (..., 2, N) of any unit.
        angle: (...) rad, each of which turns N vectors; both broadcast.

    Returns:
        The turned vectors (..., 2, N).
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    rotation = np.stack([cosine, sine, -sine, cosine], axis=-1)
    return rotation.reshape(*rotation.shape[:-1], 2, 2) @ vectors


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


def _limits(range_margin: float, angle_margin: float) -> tuple[float, ...]:
    """Squares of least and greatest range, tangent of azimuth, its square up and down."""
    angles = MAX_AZIMUTH, MAX_ELEVATION, -MIN_ELEVATION
    # Tangents instead of angles: no inverse function per sample.
    widest, rise, fall = (float(np.tan(angle - angle_margin)) for angle in angles)
    least, most = MIN_RANGE + range_margin, MAX_RANGE - range_margin
    return least**2, most**2, widest, rise**2, fall**2


@njit(**INNER_KERNEL)
def _sees(east, north, up, limits):
    least_squared, most_squared, widest, rise_squared, fall_squared = limits
    ground_squared = east * east + north * north
    height_squared = up * abs(up)  # with the height's sign
    range_squared = ground_squared + abs(height_squared)
    return (
        (range_squared >= least_squared)
        & (range_squared <= most_squared)
        & (abs(east) <= widest * north)
        & (height_squared <= rise_squared * ground_squared)
        & (-height_squared <= fall_squared * ground_squared)
    )


@njit(**KERNEL)
def _first_inside(path, anchor, angle, goal, limits, first):
    """Write which of the placements (B, C) is the first in coverage, -1 where none is."""
    for b in range(first.size):
        first[b] = -1
        for c in range(angle.shape[1]):
            sine, cosine = sin(angle[b, c]), cos(angle[b, c])
            inside = True
            for t in range(path.shape[2]):
                x, y = path[0, b, t] - anchor[0, b], path[1, b, t] - anchor[1, b]
                east = cosine * x + sine * y + goal[b, c, 0]
                north = cosine * y - sine * x + goal[b, c, 1]
                if not _sees(east, north, path[2, b, t], limits):
                    inside = False
                    break
            if inside:
                first[b] = c
                break
