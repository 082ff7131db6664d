"""Figures of a tuned filter's innovations, and of what was chosen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from ..plotting import COLOURS, clean, save
from .diagnostics import BINS, LAGS, expected_quantiles

MOST_CHANNELS = 12  # drawn; the report has them all


def draw_study(report: dict[str, Any], output: Path) -> list[Path]:
    """Write the figures of a report and return their paths."""
    paths = [output / "innovations.png", output / "noise.png"]
    save(_innovations(report), paths[0])
    save(_noise(report), paths[1])
    return paths


def _innovations(report: dict[str, Any]) -> Figure:
    """A row per channel: histogram, Q-Q plot, lag correlations."""
    channels = report["channels"][:MOST_CHANNELS]
    figure = Figure((11.0, 2.5 * len(channels) + 0.8), layout="constrained")
    rows = figure.subplots(len(channels), 3, squeeze=False)
    for axes, channel in zip(rows, channels, strict=True):
        _histogram(axes[0], channel)
        _quantiles(axes[1], channel)
        _lags(axes[2], channel)
    for axes, label in zip(
        rows[-1], ("innovation in expected deviations", "standard normal", "arrivals later"),
        strict=True,
    ):  # fmt: skip
        axes.set_xlabel(label)
    figure.suptitle(
        f"{report['environment']}: innovations of {report['windows']['test']} windows kept from "
        f"tuning, static noise by {report['by'][0]}", x=0.01, ha="left",
    )  # fmt: skip
    return figure


def _histogram(axes: Axes, channel: dict[str, Any]) -> None:
    width = BINS[1] - BINS[0]
    axes.bar(BINS[:-1], np.array(channel["histogram"]) / width, width, align="edge",
             color=COLOURS[2])  # fmt: skip
    grid = np.linspace(BINS[0], BINS[-1], 200)
    axes.plot(grid, norm.pdf(grid), color="black", lw=1.2)
    mean = f"{channel['mean']:.3g}, deviation {channel['deviation']:.3g} {channel['unit']}"
    axes.set_title(f"{channel['name']}: mean {mean}", loc="left", fontsize=9)
    axes.set_ylabel("density")
    clean(axes)


def _quantiles(axes: Axes, channel: dict[str, Any]) -> None:
    expected = expected_quantiles()
    axes.plot(expected, expected, color="black", lw=1.0)
    axes.plot(expected, channel["quantiles"], ".", color=COLOURS[4], ms=4)
    between = f"{channel['nis_low']:.2f} to {channel['nis_high']:.2f}"
    axes.set_title(f"NIS {channel['nis']:.2f} (chi-square {between})", loc="left", fontsize=9)
    axes.set_ylabel("quantile")
    clean(axes)


def _lags(axes: Axes, channel: dict[str, Any]) -> None:
    bound = channel["lag_bound"]
    axes.axhspan(-bound, bound, color=COLOURS[7], alpha=0.3, lw=0)
    axes.bar(range(1, LAGS + 1), channel["lags"], 0.5, color=COLOURS[3])
    axes.axhline(0.0, color="black", lw=0.8)
    top = max(0.3, 1.2 * np.abs(channel["lags"]).max())
    axes.set_ylim(-top, top)
    axes.set_title(f"correlation, bound {bound:.3f}", loc="left", fontsize=9)
    clean(axes)


def _noise(report: dict[str, Any]) -> Figure:
    """Each parameter's value and interval under every criterion."""
    names = [
        name for name, row in report["static"][report["by"][0]]["parameters"].items()
        if row["what"] != "coupling"
    ]  # fmt: skip
    figure = Figure((8.0, 0.5 * len(names) + 1.8), layout="constrained")
    axes = figure.subplots()
    for k, by in enumerate(report["by"]):
        rows = [report["static"][by]["parameters"][name] for name in names]
        place = np.arange(len(names)) + 0.7 * ((k + 0.5) / len(report["by"]) - 0.5)
        axes.plot([row["value"] for row in rows], place, "o", color=COLOURS[k + 1], label=by)
        for y, row in zip(place, rows, strict=True):
            if row["low"] is not None and row["high"] is not None:
                axes.plot([row["low"], row["high"]], [y, y], color=COLOURS[k + 1], lw=3, alpha=0.5)
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel("factor on what the filter is told (Q: variance; R: deviation), 95 % interval")
    axes.legend(frameon=False, title="tuned by", loc="center left", bbox_to_anchor=(1.0, 0.5))
    clean(axes)
    return figure
