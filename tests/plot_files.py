"""Plots of simulated flights, written as the CSV files that a user brings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Sensor
from kfenv.scenarios.radar.plots import column
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]


def written(
    path: Path, sensor: Sensor, time: Array, value: Array, deviation: Array | None = None,
    digits: str = "%.17g",
) -> str:  # fmt: skip
    """Write values (N, m) and perhaps their deviations, in SI; NaN becomes an empty cell."""
    unit = np.array([np.degrees(1.0) if channel.angle else 1.0 for channel in sensor.channels])
    names, table = ["t", *map(column, sensor.channels)], [time, *(value * unit).T]
    if deviation is not None:
        names += [column(channel, "_std") for channel in sensor.channels]
        table += [*(deviation * unit).T]
    lines = [",".join(names)]
    for row in zip(*table, strict=True):
        lines.append(",".join("" if np.isnan(number) else digits % number for number in row))
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def of_episode(path: Path, sensor: Sensor, recording: Recording, digits: str = "%.17g") -> str:
    """Write the plots of a recording's first episode with their told noise."""
    first = recording.measurement[0], recording.noise[0]
    return written(path, sensor, recording.times[0], *first, digits)


def truth_of(path: Path, recording: Recording, digits: str = "%.17g") -> str:
    """Write the true positions of a recording's first episode."""
    table = np.column_stack([recording.times[0], recording.truth[0][:, [0, 3, 6]]])
    np.savetxt(path, table, digits, ",", header="t,x_m,y_m,z_m", comments="")
    return str(path)
