"""A run as a picture: its track from above with measurements and uncertainty, and its height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from ..plotting import COLOURS, clean, save
from .estimates import Estimates

Array = NDArray[np.float64]

ELLIPSES = 25  # along the track
SIGMA = 2.4477  # radius of 95 % of a normal distribution in two dimensions
BAND = 1.96  # the same in one
KM, FAR = 1e3, 10_000.0  # m, from which extent on axes are in kilometres
DOTS = 5000  # measurements at most
WILD = (1.0, 99.0)  # percentiles of the measurements that are in view, with a margin


def draw_map(run: Estimates, rows: NDArray[np.int64], title: str, path: Path) -> None:
    """Write the figure.

    Args:
        rows: indices of the instants to draw.
        title: above it.
    """
    estimate, spread = run.local(run.position[rows]), run.spread[rows]
    time = run.time[rows] - run.time[0]
    truth = run.local(run.true_position[rows])
    seen = np.flatnonzero(np.isfinite(run.measured).all(axis=1))
    seen = seen[:: max(1, len(seen) // DOTS)]
    measured = run.measured[seen]
    scale = KM if np.ptp(estimate[:, :2], axis=0).max() > FAR else 1.0
    figure = Figure((9.0, 9.6), layout="constrained")
    above, height = figure.subplots(2, height_ratios=(3, 1))
    if len(seen):
        above.plot(*measured[:, :2].T / scale, ".", color=COLOURS[7], ms=2.5, zorder=1,
                   label="measured")  # fmt: skip
        height.plot(
            run.time[seen] - run.time[0], measured[:, 2], ".", color=COLOURS[7], ms=2, zorder=1
        )
    if np.isfinite(truth).any():
        above.plot(*truth[:, :2].T / scale, "x-", markevery=[-1], color=COLOURS[0], lw=1.6,
                   zorder=2, label="truth")  # fmt: skip
        height.plot(time, truth[:, 2], color=COLOURS[0], lw=1.4, zorder=2)
    arrived = np.flatnonzero((run.channels[rows] > 0) | (run.channels.max() == 0))
    _ellipses(above, estimate[arrived], spread[arrived], scale)
    labels = "estimate", "begin"
    for part in run.stretches(rows):
        above.plot(*estimate[part, :2].T / scale, color=COLOURS[4], lw=1.3, zorder=3,
                   label=labels[0])  # fmt: skip
        above.plot(*estimate[part[0], :2] / scale, "o", color=COLOURS[3], ms=6, zorder=5,
                   label=labels[1])  # fmt: skip
        labels = None, None  # once in the legend
        _band(height, time[part], estimate[part, 2], np.sqrt(spread[part, 2, 2]))
    _view_of_height(height, estimate[:, 2], np.sqrt(spread[:, 2, 2]))
    _view(above, estimate[arrived], spread[arrived], truth, measured, scale)
    unit = "km" if scale == KM else "m"
    above.set_xlabel(f"east, {unit}")
    above.set_ylabel(f"north, {unit}")
    above.set_title(title, loc="left", fontsize=10)
    above.legend(frameon=False, fontsize=9)
    height.set_xlabel(f"time since t = {run.time[0]:.10g}, s")
    height.set_ylabel("up, m")
    clean(above)
    clean(height)
    save(figure, path)


def draw_series(run: Estimates, rows: NDArray[np.int64], title: str, path: Path) -> None:
    """Write a figure of what is scored over time, where that is no position; as `draw_map`."""
    yardstick, time = run.scenario.yardstick, run.time[rows]
    roots = np.linalg.cholesky(run.covariance[rows])
    along = yardstick.rows(run.mean[rows], roots)
    deviation = np.sqrt(np.sum(along**2, axis=2))
    values, truth = (yardstick.values(states[rows]) for states in (run.mean, run.truth))
    figure = Figure((9.0, 2.4 * len(yardstick) + 0.8), layout="constrained")
    panels = figure.subplots(len(yardstick), sharex=True, squeeze=False)[:, 0]
    for i, (axes, component) in enumerate(zip(panels, yardstick.components, strict=True)):
        _band(axes, time, values[:, i], deviation[:, i])
        axes.plot(time, truth[:, i], color=COLOURS[0], lw=1.2, zorder=2)
        axes.set_ylabel(f"{component.name}, {component.unit}")
        _view_of_height(axes, values[:, i], deviation[:, i])
        clean(axes)
    panels[0].set_title(title, loc="left", fontsize=10)
    panels[-1].set_xlabel("time, s")
    save(figure, path)


def _ellipses(axes: Axes, estimate: Array, spread: Array, scale: float) -> None:
    """Where the target is with 95 %, at some instants that lie apart."""
    label, drawn = "95 %", np.full(2, np.inf)
    for row in np.unique(np.linspace(0, len(estimate) - 1, ELLIPSES).astype(int)):
        lengths, axes_of = np.linalg.eigh(spread[row, :2, :2])
        width, depth = 2.0 * SIGMA * np.sqrt(np.maximum(lengths, 0.0))
        if np.linalg.norm(estimate[row, :2] - drawn) < 0.5 * depth:
            continue  # it would cover the one before
        drawn, angle = estimate[row, :2], np.degrees(np.arctan2(axes_of[1, 0], axes_of[0, 0]))
        axes.add_patch(Ellipse(drawn / scale, width / scale, depth / scale, angle=angle, zorder=2.2,
                               fc=COLOURS[2], ec=COLOURS[4], lw=0.6, alpha=0.25,
                               label=label))  # fmt: skip
        label = None


def _band(axes: Axes, time: Array, up: Array, deviation: Array) -> None:
    """The height with its 95 %."""
    axes.fill_between(time, up - BAND * deviation, up + BAND * deviation, color=COLOURS[2],
                      alpha=0.4, lw=0, zorder=2.5)  # fmt: skip
    axes.plot(time, up, color=COLOURS[4], lw=1.2, zorder=3)


def _view_of_height(axes: Axes, up: Array, deviation: Array) -> None:
    """Show all but what a vague begin or a gap would add."""
    low, high = np.percentile(up, WILD)
    beyond = 3.0 * BAND * float(np.median(deviation)) + 0.1 * (high - low) + 1e-9
    axes.set_ylim(low - beyond, high + beyond)


def _view(
    axes: Axes, estimate: Array, spread: Array, truth: Array, measured: Array, scale: float
) -> None:  # fmt: skip
    """Show the track with a usual ellipse, and measurements but for the wildest."""
    usual = SIGMA * np.median(np.sqrt(np.diagonal(spread, axis1=1, axis2=2)[:, :2]), axis=0)
    parts = [estimate[:, :2] - usual, estimate[:, :2] + usual]
    parts.append(truth[np.isfinite(truth).all(axis=1)][:, :2])
    if len(measured):
        parts.append(np.percentile(measured[:, :2], WILD, axis=0))
    points = np.concatenate(parts) / scale
    low, high = points.min(axis=0), points.max(axis=0)
    half, middle = 0.54 * float((high - low).max()) + 1e-3, 0.5 * (low + high)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
