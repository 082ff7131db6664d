"""What a file of plots says of itself, as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from kfenv.models.position import position
from kfenv.models.radar import radar
from kfenv.scenarios.columns import column_names
from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.radar.plot_log import MAX_GAP, instants_of, measured_noise
from kfenv.scenarios.radar.plots import WHAT, Plots, column, read_plots

LONG = 1.5  # of the usual interval, from which on a plot is missing


def plots_table(path: Path) -> Table:
    """Counts, intervals, whereabouts and noise.

    Raises:
        FileNotFoundError, ValueError: as `kfenv.scenarios.radar.plots.read_plots`.
    """
    header = column_names(path, WHAT)
    local = all(column(channel) in header for channel in position().channels)
    sensor = position() if local else radar()
    plots = read_plots(path, sensor)
    table = Table("of the plots", "value", box=SIMPLE_HEAD)
    for what, value in (*_times(plots), *_places(plots, sensor)):
        table.add_row(what, value)
    angles = [i for i, channel in enumerate(sensor.channels) if channel.angle]
    measured = measured_noise(plots.time, plots.value, angles)
    told = np.array([np.nanmedian(spread) if np.isfinite(spread).any() else np.nan
                     for spread in plots.deviation.T])  # fmt: skip
    for channel, found, given in zip(sensor.channels, measured, told, strict=True):
        unit = np.degrees(1.0) if channel.angle else 1.0
        beside = "none told" if np.isnan(given) else f"{unit * given:.3g} told in the median"
        table.add_row(f"noise of {column(channel)}", f"{unit * found:.3g} measured, {beside}")
    return table


def _times(plots: Plots) -> list[tuple[str, str]]:
    gap = np.diff(plots.time)
    usual = float(np.median(gap))
    _, row, _ = instants_of(plots.time, plots.path) if gap.max() <= MAX_GAP else (None, None, None)
    steps = "more than can be bridged: cut the log" if row is None else f"{row[-1] + 1}"
    missing = np.sum(np.rint(gap[gap > LONG * usual] / usual) - 1.0)
    late = int(np.argmax(gap))
    return [
        ("rows, without repetitions", f"{len(plots.time)}"),
        ("rows that repeat another", f"{plots.repeated}"),
        ("rows with every channel", f"{int(plots.complete.sum())}"),
        ("from, to, s", f"{plots.time[0]:.10g}, {plots.time[-1]:.10g}"),
        ("usual interval, s", f"{usual:.4g} (80 % within {_middle(gap)})"),
        ("missing at that interval", f"{missing:.0f}"),
        ("longest gap, s", f"{gap[late]:.4g} after t = {plots.time[late]:.10g}"),
        ("filter steps", steps),
    ]


def _middle(values: np.ndarray) -> str:
    low, high = np.percentile(values, (10.0, 90.0))
    return f"{low:.4g} to {high:.4g}"


def _places(plots: Plots, sensor) -> list[tuple[str, str]]:
    rows = []
    for channel, values in zip(sensor.channels, plots.value.T, strict=True):
        unit = np.degrees(1.0) if channel.angle else 1.0
        low, high = np.nanmin(values) * unit, np.nanmax(values) * unit
        rows.append((column(channel), f"{low:.5g} to {high:.5g}"))
    whole = plots.complete
    place, time = measured_positions(sensor, plots.value[whole]), plots.time[whole]
    span = max(1, round(10.0 / float(np.median(np.diff(time)))))
    if len(time) > span:
        moved = np.linalg.norm(place[span:] - place[:-span], axis=1) / (time[span:] - time[:-span])
        rows.append(("speed over 10 s or a plot, m/s", f"{np.median(moved):.4g} in the median"))
    return rows
