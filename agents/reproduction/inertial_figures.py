"""Figures of inertial navigation: estimates with zooms, their errors, RMSE over the runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..plotting import COLOURS, clean
from .figures import DASHES

Array = NDArray[np.float64]
Span = tuple[float, float]

AXES = {
    "velocity": ("north, m/s", "east, m/s", "down, m/s"),
    "attitude": ("roll, deg", "pitch, deg", "yaw, deg"),
}
GROUPS = ("position, m", "velocity, m/s", "attitude, deg")
SHADES = {"outliers": "#999999", "unit fault": "#D55E00"}


def estimates(
    quantity: str,
    time: Array,
    truth: Array,
    fixes: Array,
    paths: Mapping[str, Array],
    outliers: Span,
    zoom: Span,
) -> Figure:
    """Velocity or attitude of one run, whole on the left and a stretch of it on the right.

    Args:
        quantity: ``"velocity"`` or ``"attitude"``.
        truth, fixes: (T, 3), SI; NaN where no fix came.
        paths: estimates (T, 3) by filter.
        outliers, zoom: s.
    """
    figure = Figure((11.0, 7.5), layout="constrained")
    unit = _unit(quantity)
    for axis, (whole, close) in enumerate(figure.subplots(3, 2, sharex="col")):
        for axes in (whole, close):
            seen = np.isfinite(fixes[:, axis])
            axes.plot(time[seen], unit * fixes[seen, axis], ".", color="#bbbbbb", ms=3,
                      label="GNSS")  # fmt: skip
            axes.plot(time, unit * truth[:, axis], color="black", lw=2.4, label="truth")
            for number, (label, path) in enumerate(paths.items()):
                axes.plot(time, unit * path[:, axis], lw=1.3, label=label, **_style(number))
            clean(axes)
        _shade(whole, {"outliers": outliers})
        shown = np.stack([truth[:, axis], *(path[:, axis] for path in paths.values())])
        _fit(whole, unit * shown)
        near = (time >= zoom[0]) & (time <= zoom[1])
        close.set_xlim(*zoom)
        _fit(close, unit * shown[:, near])
        whole.set_ylabel(AXES[quantity][axis])
    for axes in (whole, close):
        axes.set_xlabel("time, s")
    _legend(figure, whole)
    return figure


def errors(quantity: str, time: Array, paths: Mapping[str, Array], outliers: Span) -> Figure:
    """Errors of one run's velocity or attitude, (K, 3) by filter; symmetric-logarithmic."""
    figure = Figure((9.0, 7.0), layout="constrained")
    unit = _unit(quantity)
    panels = figure.subplots(3, sharex=True)
    for axis, axes in enumerate(panels):
        for number, (label, error) in enumerate(paths.items()):
            axes.plot(time, unit * error[:, axis], lw=1.3, label=label, **_style(number))
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylabel(f"error {AXES[quantity][axis]}")
        _shade(axes, {"outliers": outliers})
        clean(axes)
    panels[-1].set_xlabel("time, s")
    _legend(figure, panels[-1])
    return figure


def rmse(time: Array, runs: Mapping[str, Array], spans: Mapping[str, Span]) -> Figure:
    """RMSE over the runs of position, velocity and attitude against time.

    An extended filter is a broad line, and its cubature twin a thin one upon it.

    Args:
        runs: errors (N, K, 9) by filter, SI.
        spans: what to shade, s.
    """
    figure = Figure((9.0, 8.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for group, axes in enumerate(panels):
        unit = _unit("attitude") if group == 2 else 1.0
        for label, error in runs.items():
            squared = np.sum(error[..., 3 * group : 3 * group + 3] ** 2, axis=2)
            rms = unit * np.sqrt(np.mean(squared, axis=0))
            axes.plot(time, rms, label=label, **_twin_style(label, list(runs)))
        axes.set_yscale("log")
        axes.set_ylabel(f"RMSE of {GROUPS[group]}")
        _shade(axes, spans)
        clean(axes)
    panels[-1].set_xlabel("time, s")
    _legend(figure, panels[-1])
    return figure


def _unit(quantity: str) -> float:
    return 180.0 / np.pi if quantity == "attitude" else 1.0


def _style(number: int) -> dict[str, Any]:
    """Colour and dashes of an estimate beside the truth, which is black."""
    return {"color": COLOURS[1 + number], "ls": DASHES[number % len(DASHES)]}


def _twin_style(label: str, labels: list[str]) -> dict[str, Any]:
    """Of a filter among these, one colour for an extended filter and its cubature twin."""
    kinds = list(dict.fromkeys(name.replace("EKF", "CKF") for name in labels))
    colour = COLOURS[kinds.index(label.replace("EKF", "CKF"))]
    broad = {"lw": 4.0, "alpha": 0.35} if "EKF" in label else {"lw": 1.3}
    return {"color": colour} | broad


def _fit(axes: Axes, shown: Array) -> None:
    """Limits that hold the lines, wherever the fixes lie."""
    low, high = np.nanmin(shown), np.nanmax(shown)
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)


def _shade(axes: Axes, spans: Mapping[str, Span]) -> None:
    for label, (start, stop) in spans.items():
        axes.axvspan(start, stop, color=SHADES[label], alpha=0.15, lw=0, label=label)


def _legend(figure: Figure, axes: Axes) -> None:
    figure.legend(*axes.get_legend_handles_labels(), frameon=False, ncols=6, fontsize=9,
                  loc="outside upper center")  # fmt: skip
