"""What the panels of a film are drawn with: palette, frames, axes, read-outs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.history import History

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

Array = NDArray[np.float64]

# Okabe and Ito's palette, which colour-blind people can tell apart.
INK, FAINT, GRID = "#2B2B2B", "#7A7A7A", "#E9E9E9"
ESTIMATE, TRUTH, MEASUREMENT = "#0072B2", "#C4C4C4", "#8C8C8C"
KNOB_COLOURS = ("#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#2B2B2B")

ELLIPSE_SCALE = np.sqrt(5.991)  # 95 % of a normal distribution in two dimensions
CIRCLE = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 73)),
                   np.sin(np.linspace(0.0, 2.0 * np.pi, 73))])  # fmt: skip


def ellipse(covariance: Array) -> Array:
    """Outline (2, k) of the 95 % region of a horizontal error with this covariance (3, 3)."""
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    return ELLIPSE_SCALE * (axes * np.sqrt(np.maximum(variances, 0.0))) @ CIRCLE


def style(axes: Axes, title: str, y: str = "") -> None:
    """A plain frame, independent of the user's matplotlib settings."""
    axes.set_facecolor("white")
    axes.set_title(title, loc="left", fontsize=11, color=INK, pad=7)
    axes.set_ylabel(y, fontsize=9.5, color=FAINT)
    axes.yaxis.set_label_coords(-0.06, 0.5)
    axes.tick_params(colors=FAINT, labelsize=9, length=0, pad=5)
    axes.grid(True, color=GRID, lw=0.8, ls="-")
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set(visible=True, color=TRUTH, lw=0.8)


def time_axis(axes: Axes, history: History) -> None:
    """The episode's duration with the passing faults shaded, short ones over long ones."""
    axes.set_xlim(history.time[0], history.time[-1])
    colours = history.colours
    for fault in sorted(history.passing, key=lambda fault: fault.start - fault.stop):
        axes.axvspan(fault.start, fault.stop, color=colours[fault.label], lw=0, zorder=0.5)


def fault_names(axes: Axes, history: History) -> None:
    """Name the passing faults above the axes, one line higher where names would collide."""
    per_second = axes.get_window_extent().width / (history.time[-1] - history.time[0])
    ends: list[float] = []  # of the last name in each line, pixels
    for fault in history.passing:
        left = (max(fault.start, history.time[0]) - history.time[0]) * per_second
        line = next((i for i, end in enumerate(ends) if left > end), len(ends))
        ends[line : line + 1] = [left + 8.0 * len(fault.label) + 10.0]
        axes.annotate(fault.label, (left / per_second + history.time[0], 1.0), (1, 4 + 12 * line),
                      xycoords=("data", "axes fraction"), textcoords="offset points",
                      fontsize=9, color=INK)  # fmt: skip


def plain_log_ticks(axes: Axes, decades: int) -> None:
    """Ticks such as 0.01, 1, 100 every so many decades, and no minor ones."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.yaxis.set_major_locator(LogLocator(10.0**decades))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def readout(axes: Axes, height: float, colour: str, name: str) -> Text:
    """Write a name to the right of an axes; returns the text that is to hold its value."""
    look = {"transform": axes.transAxes, "color": colour, "fontsize": 10, "va": "center"}
    axes.text(1.015, height, name, **look)
    return axes.text(1.228, height, "", ha="right", **look)


def true_track(axes: Axes, history: History, unit: float) -> list[Line2D]:
    """The true track as a broad band, in a fault's colour where there was one."""
    east, north = history.truth[:, :2].T / unit
    bands = axes.plot(east, north, color=TRUTH, lw=8, solid_capstyle="round", zorder=2)
    for fault in sorted(history.passing, key=lambda fault: fault.start - fault.stop):
        during = slice(*np.searchsorted(history.time, (fault.start, fault.stop)))
        bands += axes.plot(east[during], north[during], color=history.colours[fault.label],
                           lw=8, solid_capstyle="butt", zorder=2.1)  # fmt: skip
    return bands


def told(value: float, unit: str) -> str:
    """Whole metres, with a decimal below ten; digits of what is less or else; a dash for NaN."""
    if np.isnan(value):
        return "-"
    if unit != "m" or value < 0.95:
        return f"{value:.2g} {unit}"
    return f"{value:.1f} m" if value < 9.95 else f"{value:.0f} m"


def short(value: float) -> str:
    """Three digits without an exponent: 0.00123, 1.23, 123, 1234."""
    return f"{value:#.3g}".rstrip(".") if value < 999.5 else f"{value:.0f}"


def round_up(value: float) -> float:
    """The next of ..., 1, 2, 5, 10, 20, 50, ..."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * next(step for step in (1, 2, 5, 10) if step * decade >= value))
