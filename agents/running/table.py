"""Estimates as a CSV file, in the units of the boundary: metres, seconds and degrees."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Component

from ..files import written_whole
from .estimates import Estimates

Array = NDArray[np.float64]

PLACE = ("lat_deg", "lon_deg", "height_m")


def write_table(run: Estimates, rows: NDArray[np.int64], path: Path) -> None:
    """Write instants of a run: time, place, states, their deviations, knobs and NIS.

    An empty cell is a number that there is not: no NIS where nothing arrived.

    Args:
        rows: indices of the instants.
    """
    columns = {"t_s": run.time, "stretch": run.stretch} | _places(run)
    deviation = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2))
    states = run.scenario.motion.states
    for i, state in enumerate(states):
        columns[_named(state)] = run.mean[:, i] * _unit(state)
    for i, state in enumerate(states):
        columns[_named(state, "_std")] = deviation[:, i] * _unit(state)
    columns |= {f"knob_{name}": run.factors[:, i] for i, name in enumerate(run.knobs)}
    columns |= {"nis": run.nis, "channels": run.channels}
    if np.isfinite(run.error).any():
        columns[f"error_{run.scenario.yardstick.unit}"] = run.error
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow(_cell(name, values[row]) for name, values in columns.items())
    with written_whole(path) as file:
        file.write(text.getvalue().encode())


def _places(run: Estimates) -> dict[str, Array]:
    """Latitude, longitude and height, where the frame has a place on Earth."""
    told = run.scenario.geodetic(run.position) if run.has_position else None
    return {} if told is None else dict(zip(PLACE, told.T, strict=True))


def _named(state: Component, told: str = "") -> str:
    return f"{state.name.replace(' ', '_')}{told}_{state.unit.replace('rad', 'deg')}"


def _unit(state: Component) -> float:
    """Factor from SI; rates of angles are in degrees as well."""
    return float(np.degrees(1.0)) if "rad" in state.unit else 1.0


def _cell(name: str, value: float) -> str:
    if not np.isfinite(value):
        return ""
    return f"{value:.10f}" if name in PLACE[:2] else f"{value:.12g}"
