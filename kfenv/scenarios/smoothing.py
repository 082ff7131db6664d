"""A robust smoothing spline through a flight's position reports, whatever spoils their times.

What jitters is mostly the time of a report: rounded to seconds, stamped late. An aircraft at
220 m/s is then off by tens of metres along its track and by nothing across it, one that taxies
is off by nothing. So the jitter along the track counts as an error of time, measured once for
the flight and weighted by speed, and reports that lie far off are judged by those around them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# What the cutoff suits as it stands: 10 m of jitter in one report a second
USUAL_JITTER = 10.0**2  # m^2 s
NEIGHBOURS = 31  # reports among which one is judged
SPACINGS = 5  # reports whose spacing says for how long each stands at most
FLOOR = 6.0  # m: least deviation that is held against a report
DOUBTFUL, OUTLYING = 2.0, 5.0  # deviations at which a report counts less, and nothing
PASSES = 8
SLOW = 30.0  # m/s, below which the time error is not measured
NORMAL = 1.4826  # deviation over median of the absolute value


def robust_spline(time: Array, position: Array, cutoff: float) -> tuple[CubicSpline, Mask]:
    """Fit a cubic smoothing spline, and say which reports it was fitted to.

    Minimised is the squared distance to the reports, each weighted by the time it stands
    for, plus (cutoff / 2 pi)^4 times the squared acceleration, both integrated over time.
    Along the track a report whose time jitters weighs less: as if the cutoff there were
    longer by the fourth root of the jitter's density over that of 10 m once a second.

    Args:
        time: (N,) increasing, s.
        position: (N, 3) m.
        cutoff: period at which the gain is a half, s.
    """
    spacing = np.gradient(time)
    stands_for = np.minimum(spacing, 3.0 * _local_median(spacing, SPACINGS))
    time_error = _time_error(time, position)
    covariance = np.eye(3) / stands_for[:, None, None]
    kept = np.ones(time.size, dtype=bool)
    for _ in range(PASSES):
        spline = _spline(time[kept], position[kept], covariance[kept], cutoff)
        velocity = spline(time, 1)
        speed = np.linalg.norm(velocity, axis=1)
        track = velocity / np.maximum(speed, 1e-3)[:, None]
        residual = position - spline(time)
        along = np.sum(residual * track, axis=1)
        off = np.linalg.norm(residual - along[:, None] * track, axis=1)
        jitter = speed * time_error
        doubt_along = _doubt(np.abs(along), NORMAL, np.maximum(jitter, FLOOR))
        doubt_off = _doubt(off, 1.0, FLOOR)
        kept = (doubt_along <= OUTLYING) & (doubt_off <= OUTLYING)
        less = np.maximum(doubt_off / DOUBTFUL, 1.0)
        usual = np.maximum(jitter**2 * stands_for / USUAL_JITTER, 1.0)
        stretch = usual * np.maximum(doubt_along / DOUBTFUL, 1.0) - less
        outer = track[:, :, None] * track[:, None, :]
        covariance = less[:, None, None] * np.eye(3) + stretch[:, None, None] * outer
        covariance /= stands_for[:, None, None]
    return spline, kept


def _doubt(distance: Array, normal: float, least: Array | float) -> Array:
    """Distances over the deviation that the reports around each show."""
    return distance / np.maximum(normal * _local_median(distance, NEIGHBOURS), least)


def _local_median(values: Array, count: int) -> Array:
    from scipy.ndimage import median_filter

    return median_filter(values, size=count, mode="nearest")


def too_stiff(time: Array, position: Array, spline: CubicSpline, kept: Mask) -> float:
    """Return the share of reports that were left out though they lie on their neighbours' way.

    A late report lies off its neighbours; those of a turn that the cutoff is too long for do not.
    """
    away = np.linalg.norm(position - spline(time), axis=1)
    off, _ = off_neighbours(time, position)
    return float(np.mean(~kept & (np.linalg.norm(off, axis=1) < 0.5 * away)))


def _time_error(time: Array, position: Array) -> float:
    """Deviation of the reports' times, s, from how far along each lies off its neighbours."""
    off, gain = off_neighbours(time, position)
    chord = np.gradient(position, axis=0)
    passed = np.gradient(time)
    length = np.maximum(np.linalg.norm(chord, axis=1), 1e-9)
    seconds = np.sum(off * chord, axis=1) / length**2 * passed / gain
    fast = (length > SLOW * passed) & np.isfinite(seconds)
    return NORMAL * float(np.median(np.abs(seconds[fast]))) if fast.any() else 0.0


def off_neighbours(time: Array, position: Array) -> tuple[Array, Array]:
    """From the cubic through the two reports before and the two after to each report (N, 3), m.

    And how much of independent errors adds up in that (N,); NaN at the two first and last.
    """
    around = np.arange(2, time.size - 2)[:, None] + (-2, -1, 1, 2)
    since = time[around] - time[2:-2, None]
    apart = since[:, :, None] - since[:, None, :] + np.eye(4)
    others = np.where(np.eye(4, dtype=bool), 1.0, -since[:, None, :])
    weight = np.prod(others / apart, axis=2)
    off, gain = np.full(position.shape, np.nan), np.full(time.size, np.nan)
    off[2:-2] = position[2:-2] - np.sum(weight[:, :, None] * position[around], axis=1)
    gain[2:-2] = np.sqrt(1.0 + np.sum(weight**2, axis=1))
    return off, gain


def _spline(time: Array, position: Array, covariance: Array, cutoff: float) -> CubicSpline:
    """The smoothing spline of positions with covariances (N, 3, 3), by Reinsch's equations.

    Green and Silverman, Nonparametric Regression and Generalized Linear Models (1994), 2.3.
    """
    from scipy.interpolate import CubicSpline
    from scipy.sparse import bsr_array, diags_array, eye_array, kron
    from scipy.sparse.linalg import spsolve

    count, gap = time.size, np.diff(time)
    slopes = [1.0 / gap[:-1], -1.0 / gap[:-1] - 1.0 / gap[1:], 1.0 / gap[1:]]
    bends = diags_array(slopes, offsets=[0, -1, -2], shape=(count, count - 2))
    overlap = diags_array(
        [gap[1:-1] / 6.0, (gap[:-1] + gap[1:]) / 3.0, gap[1:-1] / 6.0], offsets=[-1, 0, 1]
    )
    each = eye_array(3)
    bends, overlap = kron(bends, each, format="csr"), kron(overlap, each, format="csr")
    blocks = bsr_array((covariance, np.arange(count), np.arange(count + 1)))
    spread = (cutoff / (2.0 * np.pi)) ** 4 * (blocks.tocsr() @ bends)
    bend = spsolve((overlap + bends.T @ spread).tocsc(), bends.T @ position.ravel())
    fitted = position - (spread @ bend).reshape(-1, 3)
    return CubicSpline(time, fitted, bc_type="natural")
