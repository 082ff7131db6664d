"""Figures of rounding: what is kept when, and how far rounding moves what is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..plotting import COLOURS, clean

Array = NDArray[np.float64]


def survival(
    names: Sequence[str],
    dtypes: Sequence[str],
    cases: Mapping[str, tuple[Array, Mapping[tuple[str, str], NDArray[np.bool_]]]],
) -> Figure:
    """Share of the runs on track, by design over time.

    Args:
        names: of the designs.
        dtypes: a column of panels each.
        cases: times (K,), and who is on track (N, K) by design and dtype.
    """
    height = 1.5 + (0.6 + 0.16 * len(names)) * len(cases)
    figure = Figure((11.0, height), layout="constrained")
    panels = figure.subplots(len(cases), len(dtypes), sharey=True, squeeze=False)
    for line, (case, (time, kept)) in zip(panels, cases.items(), strict=True):
        for axes, dtype in zip(line, dtypes, strict=True):
            shares = [np.mean(kept[name, dtype], axis=0) for name in names]
            extent = (time[0], time[-1], len(names) - 0.5, -0.5)
            image = axes.imshow(shares, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto",
                                extent=extent, interpolation="nearest")  # fmt: skip
            axes.set_title(f"{case}, {dtype}", loc="left", fontsize=10)
            axes.set_yticks(range(len(names)), names, fontsize=7)
    for axes in panels[-1]:
        axes.set_xlabel("time, s")
    figure.colorbar(image, ax=panels, label="share of the runs within 1 km", aspect=60, pad=0.01)
    return figure


def rounding(names: Sequence[str], distances: Mapping[str, Sequence[float]]) -> Figure:
    """How far rounding moves the position: a mark for each design and case, NaN left out.

    Args:
        distances: m, of each name, by case.
    """
    figure = Figure((8.0, 1.0 + 0.2 * len(names)), layout="constrained")
    axes = figure.subplots()
    rows = np.arange(len(names))
    for (case, values), colour, mark in zip(distances.items(), COLOURS[3:], "osD^v", strict=False):
        axes.plot(values, rows, mark, color=colour, ms=5, label=case)
    axes.set_yticks(rows, names, fontsize=8)
    axes.set(xscale="log", ylim=(len(names) - 0.5, -0.5))
    axes.set_xlabel("RMS distance of the position from the same estimator in float64, m")
    axes.legend(frameon=False, fontsize=9)
    clean(axes)
    return figure
