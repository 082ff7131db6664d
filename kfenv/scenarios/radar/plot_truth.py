"""The true track beside a log of plots: where the target was, at the log's instants.

A truth file is a flight as `kfenv.scenarios.reports` reads it (``t, lat, lon, alt_m`` or
``alt_ft``), smoothed and seen from the radar's place, or has the columns ``t, x_m, y_m, z_m`` in
the sensor's own axes (of a radar east, north and up of it), which count as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Sensor
from kfenv.scenarios.columns import CLOCK, column_names, read_columns
from kfenv.scenarios.measured import measured_positions, measured_spreads
from kfenv.scenarios.radar.plots import Plots
from kfenv.scenarios.reports import Site
from kfenv.scenarios.tracks import flight, from_radar

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOCAL = ("x_m", "y_m", "z_m")
WIDEST = 2.5  # of the usual spacing: wider stretches between two positions tell nothing
LITTLE = 0.1  # share of the plots that the truth should cover
FAR = 10.0, 100.0  # median deviations of a plot, and m: plots of that target are nearer
AZIMUTHS: dict[str, Callable[[Array], Array]] = {
    "counts from east against the clock": lambda azimuth: 0.5 * np.pi - azimuth,
    "counts against the clock": lambda azimuth: -azimuth,
    "points away from the target": lambda azimuth: azimuth + np.pi,
}


def true_states(
    path: str | PathLike[str], time: Array, site: Site | None, smoothing: tuple[float | None, float]
) -> tuple[Array, Mask]:
    """States (N, 9) at times (N,) of the file's clock, and whether the file tells them (N,).

    Args:
        path: of the file.
        time: increasing, s.
        site: latitude and longitude (deg) and height (m) of the radar, for a flight.
        smoothing: `cutoff` and `longest_gap` of `kfenv.scenarios.tracks.smooth_track`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none, or is a flight without a site; the message names it.
    """
    if set(LOCAL) & set(column_names(path, "truth")):
        return _local(path, time)
    if site is None:
        raise ValueError(
            f"{path} tells latitudes and longitudes: give radar_position=(lat, lon, height), or "
            f"the columns {CLOCK},{','.join(LOCAL)}."
        )
    smooth = flight(path, *smoothing)
    since = time - smooth.begin
    known = (since >= 0.0) & (since <= smooth.duration)
    for begin, end in smooth.gaps:
        known &= (since <= begin) | (since >= end)
    states = np.zeros((len(time), 9))
    if known.any():
        states[known] = from_radar(smooth, site, since[known])
    return states, known


def _local(path: str | PathLike[str], time: Array) -> tuple[Array, Mask]:
    """The cubic spline through positions in the sensor's axes."""
    from scipy.interpolate import CubicSpline

    told, *position = read_columns(path, "truth", (CLOCK, *LOCAL))
    _check_rows(str(path), told, np.array(position))
    spline = CubicSpline(told, np.array(position).T)
    right = np.clip(np.searchsorted(told, time, side="right"), 1, len(told) - 1)
    near = told[right] - told[right - 1] <= WIDEST * np.median(np.diff(told))
    known = (time >= told[0]) & (time <= told[-1]) & near
    inside = np.clip(time, told[0], told[-1])
    motion = np.stack([spline(inside, order) for order in range(3)], axis=-1)  # (N, 3, 3)
    return motion.reshape(len(time), 9), known


def _check_rows(path: str, time: Array, position: Array) -> None:
    if len(time) < 4:
        raise ValueError(f"{path}: at least 4 rows are needed, found {len(time)}.")
    bad = ~np.isfinite(np.vstack([time, position])).all(axis=0)
    if bad.any():
        raise ValueError(f"{path}: data row {int(np.argmax(bad)) + 1} holds NaN; leave it out.")
    if not (np.diff(time) > 0.0).all():
        row = int(np.argmin(np.diff(time) > 0.0))
        raise ValueError(
            f"{path}: column {CLOCK!r} does not increase in data row {row + 2}; sort the rows and "
            "keep one per time."
        )


def check_truth(
    path: str, plots: Plots, sensor: Sensor, states: Array, known: Mask, deviation: Array
) -> None:
    """Complain of a truth that covers little of the plots, or is far from them.

    Args:
        path: of the truth.
        plots: measured at N times.
        sensor: whose channels these tell.
        states, known: of the truth (N, 9), (N,) at these times.
        deviation: (N, m) of the plots.

    Raises:
        ValueError: naming both files and what would bring them together, if anything does.
    """
    both = known & plots.complete
    if both.sum() < LITTLE * plots.complete.sum():
        raise ValueError(
            f"{path} tells where the target was at {int(both.sum())} of the "
            f"{int(plots.complete.sum())} plots of {plots.path} (t = {plots.time[0]:.15g} to "
            f"{plots.time[-1]:.15g} s): give the times of both on one clock."
        )
    value, truth = plots.value[both], states[both][:, [0, 3, 6]]
    spread = measured_spreads(sensor, value, deviation[both])
    usual = float(np.median(np.sqrt((spread**2).sum(axis=(1, 2)))))
    allowed = FAR[0] * usual + FAR[1]
    away = _away(sensor, value, truth)
    if away <= allowed:
        return
    raise ValueError(
        f"{path} lies {away:.0f} m from the plots of {plots.path} in the median"
        f"{_remedy(sensor, value, truth, allowed)}"
    )


def _away(sensor: Sensor, value: Array, truth: Array) -> float:
    off = measured_positions(sensor, value) - truth
    return float(np.median(np.linalg.norm(off, axis=1)))


def _remedy(sensor: Sensor, value: Array, truth: Array, allowed: float) -> str:
    names: Sequence[str] = [channel.name for channel in sensor.channels]
    for what, turned in AZIMUTHS.items() if "azimuth" in names else ():
        other, place = value.copy(), names.index("azimuth")
        other[:, place] = turned(value[:, place])
        if _away(sensor, other, truth) <= allowed:
            return f": 'azimuth_deg' {what}, it seems; count it clockwise from north."
    return (
        ": is it of the same target, are both on one clock, is radar_position right, and are "
        "azimuths clockwise from true north?"
    )
