"""Figures of a position tracker: velocities against time, and ellipses of the covariance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..plotting import COLOURS, clean
from .figures import PLAIN

Array = NDArray[np.float64]

CORNERS = 100  # of an ellipse that is drawn as a polygon
AROUND = 14.0  # m about an estimate


def velocities(time: Array, truth: Array, estimated: Array, label: str) -> Figure:
    """True and estimated velocities of one run, (T, 3), m/s."""
    figure = Figure((9.0, 6.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for axis, axes in enumerate(panels):
        axes.plot(time, truth[:, axis], color="black", lw=2.2, label="truth")
        axes.plot(time, estimated[:, axis], color=COLOURS[1], lw=1.4, label=label)
        axes.set_ylabel(f"velocity {PLAIN[axis]}, m/s")
        clean(axes)
    panels[0].legend(frameon=False, ncols=2, fontsize=9)
    panels[-1].set_xlabel("time, s")
    return figure


def ellipses(
    truth: Array, measured: Array, estimated: Array, covariance: Array, size: float,
    titles: Mapping[int, str],
) -> Figure:  # fmt: skip
    """One run in the plane of x and y about some steps, each with the estimate's ellipse there.

    Args:
        truth, measured, estimated: (T, 2) positions, m.
        covariance: (T, 2, 2) of the estimated ones, m^2.
        size: half an axis of the ellipse, in standard deviations.
        titles: of the panels, by the index of the step that they show.
    """
    figure = Figure((11.0, 7.8), layout="constrained")
    panels = figure.subplots(2, -(-len(titles) // 2))
    for axes, (step, title) in zip(panels.flat, titles.items(), strict=True):
        past = slice(0, step + 1)
        axes.plot(*measured[past].T, ".", color="#aaaaaa", ms=5, label="measured")
        axes.plot(*truth[past].T, color="black", lw=2.2, label="truth")
        axes.plot(*estimated[past].T, color=COLOURS[1], lw=1.4, label="LKF")
        outline = estimated[step] + size * ellipse(covariance[step])
        axes.plot(*outline.T, color=COLOURS[4], lw=1.4, label=f"its {size:g}-sigma ellipse")
        axes.plot(*truth[step], "o", color="black", ms=5)
        axes.set_title(title, loc="left", fontsize=10)
        x, y = ((middle - AROUND, middle + AROUND) for middle in estimated[step])
        axes.set(xlabel="x, m", ylabel="y, m", xlim=x, ylim=y, aspect="equal")
        clean(axes)
    figure.legend(*panels.flat[0].get_legend_handles_labels(), frameon=False, ncols=4, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure


def ellipse(covariance: Array) -> Array:
    """Points (N, 2) one standard deviation from the origin in every direction."""
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.linalg.cholesky(covariance).T
