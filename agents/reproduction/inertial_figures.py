"""Figures of inertial navigation: estimates with zooms and errors, RMSE over the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..plotting import COLOURS, clean

Array = NDArray[np.float64]
Span = tuple[float, float]
Panel = tuple[str, tuple[int, ...]]  # what is drawn, and the channels that it sums over

CHANNELS = (
    "north, m", "east, m", "down, m",
    "velocity north, m/s", "velocity east, m/s", "velocity down, m/s",
    "roll, deg", "pitch, deg", "yaw, deg",
)  # fmt: skip
DRAWN = {8: "yaw", 7: "pitch", 6: "roll",
         3: "velocity_north", 4: "velocity_east", 5: "velocity_down"}  # fmt: skip
PER_AXIS: tuple[Panel, ...] = tuple((name, (i,)) for i, name in enumerate(CHANNELS))
IN_3D: tuple[Panel, ...] = (
    ("position, m", (0, 1, 2)), ("velocity, m/s", (3, 4, 5)), ("attitude, deg", (6, 7, 8))
)  # fmt: skip
SHADES = {"outliers": "#999999", "unit fault": "#D55E00"}
KINDS = ("CKF", "ACKF", "GSCKF", "GSACKF", "GSACKF, β = 3")


class Run(NamedTuple):
    """One channel of one run at the kept instants (K,), SI."""

    time: Array
    truth: Array
    fixes: Array  # NaN where none came
    errors: Mapping[str, Array]  # by filter


def estimates(channel: int, run: Run, outliers: Span, zoom: Span) -> Figure:
    """An angle or a velocity of one run: whole, a stretch of it, and the errors, log beyond one.

    Filters without a Gaussian sum stand on the left, those with one on the right; an extended
    filter is a broad line, and its cubature twin a thin one upon it.
    """
    figure = Figure((12.0, 8.5), layout="constrained")
    unit, name = _unit(channel), CHANNELS[channel]
    columns = figure.subplots(3, 2).T
    for (whole, close, error), sums in zip(columns, (False, True), strict=True):
        labels = [label for label in run.errors if label.startswith("GS") == sums]
        for axes in (whole, close):
            _follow(axes, run, labels, unit)
        for label in labels:
            error.plot(run.time, unit * run.errors[label], label=label, **_twin_style(label))
        near = (run.time >= zoom[0]) & (run.time <= zoom[1])
        close.set_xlim(*zoom)
        for axes, when in ((whole, slice(None)), (close, near)):
            off = np.stack([np.zeros_like(run.truth), *(run.errors[label] for label in labels)])
            _fit(axes, unit * (run.truth + off)[:, when])
        error.axhline(0.0, color="black", lw=0.8)
        error.set_yscale("symlog", linthresh=1.0)
        error.set_xlabel("time, s")
        clean(error)
        for axes in (whole, error):
            axes.set_xlim(run.time[0], run.time[-1])
            _shade(axes, {"outliers": outliers})
        whole.set_title("Gaussian sums" if sums else "no Gaussian sum", loc="left", fontsize=10)
    columns[1, 2].sharey(columns[0, 2])
    for axes, label in zip(columns[0], (name, name, f"error of {name}"), strict=True):
        axes.set_ylabel(label)
    _legend(figure, columns[:, 0])
    return figure


def rmse(
    time: Array, runs: Mapping[str, Array], spans: Mapping[str, Span], panels: Sequence[Panel]
) -> Figure:
    """RMSE over the runs against time, three panels in a column.

    An extended filter is a broad line, and its cubature twin a thin one upon it.

    Args:
        runs: errors (N, K, 9) by filter, SI.
        spans: what to shade, s.
        panels: `PER_AXIS` or `IN_3D`.
    """
    columns = len(panels) // 3
    figure = Figure((5.0 + 4.0 * columns, 8.5), layout="constrained")
    grid = figure.subplots(3, columns, sharex=True, sharey="row").ravel()
    for axes, (name, channels) in zip(grid, panels, strict=True):
        for label, error in runs.items():
            squared = np.sum(error[..., list(channels)] ** 2, axis=2)
            rms = _unit(channels[0]) * np.sqrt(np.mean(squared, axis=0))
            axes.plot(time, rms, label=label, **_twin_style(label))
        axes.set_yscale("log")
        axes.set_ylabel(f"RMSE of {name}")
        _shade(axes, spans)
        clean(axes)
    for axes in grid[-columns:]:
        axes.set_xlabel("time, s")
    _legend(figure, grid[:1])
    return figure


def _follow(axes: Axes, run: Run, labels: Sequence[str], unit: float) -> None:
    """Fixes, truth and estimates of one channel."""
    seen = np.isfinite(run.fixes)
    axes.plot(run.time[seen], unit * run.fixes[seen], ".", color="#bbbbbb", ms=3, label="GNSS")
    axes.plot(run.time, unit * run.truth, color="black", lw=2.4, label="truth")
    for label in labels:
        path = run.truth + run.errors[label]
        axes.plot(run.time, unit * path, label=label, **_twin_style(label))
    clean(axes)


def _unit(channel: int) -> float:
    return degrees(1.0) if channel >= 6 else 1.0


def _twin_style(label: str) -> dict[str, Any]:
    """One colour for an extended filter and its cubature twin; those that fade lie below."""
    kind = KINDS.index(label.replace("EKF", "CKF"))
    broad = {"lw": 4.0, "alpha": 0.35} if "EKF" in label else {"lw": 1.2}
    return {"color": COLOURS[1 + kind], "zorder": 3.0 - 0.5 * ("ACKF" in KINDS[kind])} | broad


def _fit(axes: Axes, shown: Array) -> None:
    """Limits that hold the lines, wherever the fixes lie."""
    low, high = np.nanmin(shown), np.nanmax(shown)
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)


def _shade(axes: Axes, spans: Mapping[str, Span]) -> None:
    for label, (start, stop) in spans.items():
        axes.axvspan(start, stop, color=SHADES[label], alpha=0.15, lw=0, label=label)


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """What the panels show, each once."""
    shown = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    columns = len(shown) if len(shown) < 8 else (len(shown) + 1) // 2
    figure.legend(shown.values(), shown, frameon=False, ncols=columns, fontsize=9,
                  loc="outside upper center")  # fmt: skip
