"""The parts of a film's picture: map, close-up, error, knobs and header."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.history import History
from kfenv.envs.knobs import Knob

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

Array = NDArray[np.float64]

KM = 1e3  # m

# Okabe and Ito's palette, which colour-blind people can tell apart.
INK, FAINT, GRID = "#2B2B2B", "#7A7A7A", "#E9E9E9"
ESTIMATE, TRUTH, MEASUREMENT = "#0072B2", "#C4C4C4", "#8C8C8C"
KNOB_COLOURS = ("#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#2B2B2B")

ELLIPSE_SCALE = np.sqrt(5.991)  # 95 % of a normal distribution in two dimensions
CIRCLE = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 73)),
                   np.sin(np.linspace(0.0, 2.0 * np.pi, 73))])  # fmt: skip
RECENT = 30  # measurements that the close-up shows


def lay_out(figure: Figure, scenario: Any, knobs: Sequence[Knob], history: History) -> list[Panel]:
    """Fill the figure with panels; the close-up comes before the map, which frames it."""
    figure.clear()
    figure.set_facecolor("white")
    scale, widest = scenario.error_scale, scenario.lost_distance
    header = Header(figure.add_axes((0.065, 0.925, 0.915, 0.065)), history, scenario.name)
    close_up = CloseUp(figure.add_axes((0.6575, 0.45, 0.3225, 0.43)), history, widest)
    radar = scenario.sensor.name == "radar"
    track = Map(figure.add_axes((0.065, 0.45, 0.54, 0.43)), history, close_up, radar)
    error = ErrorPanel(figure.add_axes((0.065, 0.23, 0.745, 0.15)), history, scale, widest)
    knob = KnobPanel(figure.add_axes((0.065, 0.06, 0.745, 0.15)), history, knobs)
    return [header, close_up, track, error, knob]


class Panel(ABC):
    """A part of the picture: still artists drawn once, and the `moving` ones."""

    axes: Axes
    moving: list[Artist]

    @abstractmethod
    def update(self, history: History) -> bool:
        """Bring the moving artists up to date; whether the still ones changed as well."""


class Map(Panel):
    """The whole track from above, north up."""

    def __init__(self, axes: Axes, history: History, close_up: CloseUp, radar: bool) -> None:
        from matplotlib.ticker import MaxNLocator

        self.axes, self._close_up = axes, close_up
        _style(axes, "Track from above: kilometres east and north")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(7, steps=(1, 2, 5, 10)))
        self._known = history.truth is not None or history.measured is not None
        self._view(self._extent(history, radar))
        if history.truth is not None:
            _true_track(axes, history, KM)
        if radar:
            axes.plot(0.0, 0.0, "^", color=INK, ms=9, clip_on=False)
            axes.annotate("radar", (0.0, 0.0), (9, 0), textcoords="offset points",
                          va="center", color=INK, fontsize=9)  # fmt: skip
        (self._dots,) = axes.plot([], [], ".", color=MEASUREMENT, ms=3, alpha=0.8, zorder=3)
        (self._line,) = axes.plot([], [], color=ESTIMATE, lw=1.4, zorder=4)
        (self._ellipse,) = axes.fill([], [], fc=ESTIMATE, alpha=0.25, zorder=5)
        (self._head,) = axes.plot([], [], "o", color=ESTIMATE, mec="white", ms=8, zorder=6)
        (self._frame,) = axes.plot([], [], color=INK, lw=0.8, zorder=7)
        self.moving = [self._dots, self._line, self._ellipse, self._head, self._frame]

    def update(self, history: History) -> bool:
        """Follow the estimate; widen the view where that alone can tell how far to look."""
        east, north = history.centre[:2] / KM
        seen, position = history.seen / KM, history.position / KM
        self._dots.set_data(seen[:, 0], seen[:, 1])
        self._line.set_data(position[:, 0], position[:, 1])
        self._ellipse.set_xy((ellipse(history.spread).T + history.centre[:2]) / KM)
        self._head.set_data([east], [north])
        middle, half = self._close_up.middle / KM, self._close_up.half_width / KM
        corners = middle[:, None] + half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
        self._frame.set_data(*corners)
        (left, right), (bottom, top) = self.axes.get_xlim(), self.axes.get_ylim()
        if self._known or (left <= east <= right and bottom <= north <= top):
            return False
        self._view(np.array([[left, bottom], [right, top], [east, north]]))
        return True

    def _extent(self, history: History, radar: bool) -> Array:
        """Points (k, 2), km, that must be in view: the track as well as it is known."""
        known = history.centre[None] if history.truth is None else history.truth
        if history.truth is None and history.measured is not None:
            arrived = history.measured[np.isfinite(history.measured).all(axis=1)]
            if len(arrived):  # without the wildest, which a fault may have thrown far off
                known = np.percentile(arrived, (2.0, 98.0), axis=0)
        points = np.concatenate([known[:, :2], history.centre[None, :2]])
        return np.concatenate([points, np.zeros((int(radar), 2))]) / KM

    def _view(self, points: Array) -> None:
        """Show these points with a margin, a kilometre being as long north as east."""
        low, high = points.min(axis=0), points.max(axis=0)
        box = self.axes.get_window_extent()
        width, height = 1.2 * (high - low)
        width = max(width, height * box.width / box.height, 1.0)
        height = width * box.height / box.width
        east, north = (low + high) / 2.0
        self.axes.set_xlim(east - width / 2.0, east + width / 2.0)
        self.axes.set_ylim(north - height / 2.0, north + height / 2.0)


class CloseUp(Panel):
    """The surroundings of the target in metres, zoomed to the filter's uncertainty."""

    def __init__(self, axes: Axes, history: History, widest: float) -> None:
        self.axes, self.half_width, self._widest = axes, 0.0, widest
        of = "the track of all fixes" if history.guessed else "the true position"
        of = "the estimate" if history.truth is None else of
        _style(axes, f"Close-up: metres from {of}")
        self._bands = [] if history.truth is None else _true_track(axes, history, 1.0)
        self._tracks = [np.array(band.get_xydata()) for band in self._bands]
        (self._dots,) = axes.plot([], [], "o", color=MEASUREMENT, mec="none", ms=5, alpha=0.6)
        (self._latest,) = axes.plot([], [], "o", color="none", mec=INK, mew=1.2, ms=8)
        (self._ellipse,) = axes.fill([], [], fc=ESTIMATE, alpha=0.18)
        (self._outline,) = axes.plot([], [], color=ESTIMATE, lw=1.2)
        (self._line,) = axes.plot([], [], color=ESTIMATE, lw=1.8)
        (self._head,) = axes.plot([], [], "o", color=ESTIMATE, mec="white", ms=10)
        (self._true,) = axes.plot([], [], "+", color=INK, ms=14, mew=1.8)
        self.moving = [*self._bands, self._dots, self._latest, self._ellipse, self._outline,
                       self._line, self._head, self._true]  # fmt: skip
        for order, artist in enumerate(self.moving):
            artist.set_zorder(2.0 + order)

    def update(self, history: History) -> bool:
        """Move everything to where the target now is the middle."""
        true = history.true_position
        self.middle = (history.centre if true is None else true)[:2]
        for band, track in zip(self._bands, self._tracks, strict=True):
            band.set_data(*(track - self.middle).T)
        seen = history.seen[-RECENT * history.stride :, :2] - self.middle
        self._dots.set_data(*seen.T)
        self._latest.set_data(*seen[-history.stride :].T)
        self._line.set_data(*(history.position[:, :2] - self.middle).T)
        off = history.centre[:2] - self.middle
        outline = ellipse(history.spread) + off[:, None]
        self._ellipse.set_xy(outline.T)
        self._outline.set_data(*outline)
        self._head.set_data(*off[:, None])
        self._true.set_data(*([] if true is None else [0.0] for _ in range(2)))
        return self._zoom(float(np.abs(outline).max()))

    def _zoom(self, needed: float) -> bool:
        """Choose a round half width with room; keep the present one where it still serves."""
        needed = min(max(needed, 1e-3), 0.7 * self._widest)
        if 0.25 * self.half_width < needed < 0.9 * self.half_width:
            return False
        self.half_width = half = _round_up(1.4 * needed)
        self.axes.set(xlim=(-half, half), ylim=(-half, half),
                      xticks=(-half / 2, 0, half / 2), yticks=(-half / 2, 0, half / 2))  # fmt: skip
        return True


class ErrorPanel(Panel):
    """Position error over time on a log axis, with what the filter predicts of it."""

    def __init__(self, axes: Axes, history: History, scale: float, widest: float) -> None:
        self.axes, self._widest = axes, widest
        _style(axes, "", "position error (m)")
        _time_axis(axes, history)
        _fault_names(axes, history)
        axes.tick_params(labelbottom=False)
        axes.set_yscale("log")
        axes.set_ylim(scale / 100.0, scale * 4.0)
        _plain_log_ticks(axes, decades=1)
        (self._bound,) = axes.plot([], [], color=ESTIMATE, lw=1.4, zorder=3)
        (self._error,) = axes.plot([], [], color=INK, lw=1.2, zorder=4)
        self._bound_text = _readout(axes, 0.25, ESTIMATE, "predicted 2 sigma")
        self.moving = [self._bound, self._error, self._bound_text]
        if history.truth is not None:
            self._error_text = _readout(axes, 0.75, INK, "error")
            self._rms_text = _readout(axes, 0.5, FAINT, "RMS so far")
            self.moving += [self._error_text, self._rms_text]

    def update(self, history: History) -> bool:
        """Extend the curves, and the axis where they leave it."""
        predicted = 2.0 * np.sqrt(np.trace(history.covariance, axis1=1, axis2=2))
        self._bound.set_data(history.steps, predicted)
        self._error.set_data(history.steps, history.error)
        if not len(history):
            return False
        self._bound_text.set_text(_metres(predicted[-1]))
        if history.truth is not None:
            self._error_text.set_text(_metres(history.error[-1]))
            known = history.error[np.isfinite(history.error)]
            self._rms_text.set_text(_metres(np.sqrt(np.mean(known**2)) if len(known) else np.nan))
        low, high = self.axes.get_ylim()
        top = min(np.nanmax([*history.error, *predicted, 0.0]), self._widest)
        if top <= high:
            return False
        self.axes.set_ylim(low, 2.0 * top)
        return True


class KnobPanel(Panel):
    """The factors of the exposed knobs over time on a log axis; 1 is the nominal filter."""

    def __init__(self, axes: Axes, history: History, knobs: Sequence[Knob]) -> None:
        self.axes = axes
        _style(axes, "", "knob factors")
        axes.set_xlabel("time (s)", fontsize=9.5, color=FAINT)
        _time_axis(axes, history)
        axes.set_yscale("log")
        axes.set_ylim(min(knob.low for knob in knobs) / 2, max(knob.high for knob in knobs) * 2)
        _plain_log_ticks(axes, decades=2)
        axes.axhline(1.0, color=FAINT, lw=0.8, zorder=1)
        spacing = min(0.2, 1.0 / len(knobs))
        self._lines, self._texts = [], []
        for i, knob in enumerate(knobs):
            colour = KNOB_COLOURS[i % len(KNOB_COLOURS)]
            self._lines += axes.plot([], [], color=colour, lw=1.6, drawstyle="steps-pre")
            name = knob.name.replace("_", " ")
            self._texts.append(_readout(axes, 0.9 - i * spacing, colour, name))
        self.moving = [*self._lines, *self._texts]

    def update(self, history: History) -> bool:
        """Extend the curves."""
        for i, (line, text) in enumerate(zip(self._lines, self._texts, strict=True)):
            line.set_data(history.steps, history.factors[:, i])
            text.set_text(_short(history.factors[-1, i] if len(history) else 1.0))
        return False


class Header(Panel):
    """The scenario's name, the lasting faults, the legend and the time."""

    def __init__(self, axes: Axes, history: History, name: str) -> None:
        self.axes = axes
        axes.set_axis_off()
        axes.set(xlim=(0, 1), ylim=(0, 1))
        lasting = ", ".join(fault.label for fault in history.lasting)
        axes.text(0.0, 0.78, name, fontsize=16, fontweight="bold", color=INK, va="center")
        if lasting:
            axes.text(0.0, 0.12, f"throughout: {lasting}", fontsize=10, color=FAINT,
                      va="center")  # fmt: skip
        self._legend(history)
        self._time = axes.text(1.0, 0.78, "", fontsize=13, color=INK, ha="right", va="center")
        self.moving = [self._time]

    def _legend(self, history: History) -> None:
        from matplotlib.lines import Line2D

        entries = [Line2D([], [], color=ESTIMATE, marker="o", mec="white", ms=8, label="estimate"),
                   Line2D([], [], color=ESTIMATE, marker="o", ls="", ms=11, alpha=0.3,
                          label="95 % ellipse")]  # fmt: skip
        if history.measured is not None:
            entries.append(Line2D([], [], color=MEASUREMENT, marker="o", ls="", mec="none", ms=5,
                                  label="measurements"))  # fmt: skip
        if history.truth is not None:
            entries.append(
                Line2D(
                    [],
                    [],
                    color=TRUTH,
                    lw=6,
                    marker="+",
                    mec=INK,
                    ms=9,
                    mew=1.5,
                    label="track of all fixes" if history.guessed else "true track",
                )
            )
        self.axes.legend(
            handles=entries, loc="center right", bbox_to_anchor=(1.0, 0.12), ncols=len(entries),
            frameon=False, fontsize=10, labelcolor=INK, borderaxespad=0.0, borderpad=0.0,
            columnspacing=1.8, handlelength=1.6, handletextpad=0.5,
        )  # fmt: skip

    def update(self, history: History) -> bool:
        """Tell the time."""
        now = history.steps[-1] if len(history) else history.time[0]
        self._time.set_text(f"{now:.1f} of {history.time[-1]:.4g} s")
        return False


# ----- drawing ------------------------------------------------------------------------


def ellipse(covariance: Array) -> Array:
    """Outline (2, k) of the 95 % region of a horizontal error with this covariance (3, 3)."""
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    return ELLIPSE_SCALE * (axes * np.sqrt(np.maximum(variances, 0.0))) @ CIRCLE


def _style(axes: Axes, title: str, y: str = "") -> None:
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


def _time_axis(axes: Axes, history: History) -> None:
    """The episode's duration with the passing faults shaded, short ones over long ones."""
    axes.set_xlim(history.time[0], history.time[-1])
    colours = history.colours
    for fault in sorted(history.passing, key=lambda fault: fault.start - fault.stop):
        axes.axvspan(fault.start, fault.stop, color=colours[fault.label], lw=0, zorder=0.5)


def _fault_names(axes: Axes, history: History) -> None:
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


def _plain_log_ticks(axes: Axes, decades: int) -> None:
    """Ticks such as 0.01, 1, 100 every so many decades, and no minor ones."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.yaxis.set_major_locator(LogLocator(10.0**decades))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _readout(axes: Axes, height: float, colour: str, name: str) -> Text:
    """Write a name to the right of an axes; returns the text that is to hold its value."""
    look = {"transform": axes.transAxes, "color": colour, "fontsize": 10, "va": "center"}
    axes.text(1.015, height, name, **look)
    return axes.text(1.228, height, "", ha="right", **look)


def _true_track(axes: Axes, history: History, unit: float) -> list[Line2D]:
    """The true track as a broad band, in a fault's colour where there was one."""
    east, north = history.truth[:, :2].T / unit
    bands = axes.plot(east, north, color=TRUTH, lw=8, solid_capstyle="round", zorder=2)
    for fault in sorted(history.passing, key=lambda fault: fault.start - fault.stop):
        during = slice(*np.searchsorted(history.time, (fault.start, fault.stop)))
        bands += axes.plot(east[during], north[during], color=history.colours[fault.label],
                           lw=8, solid_capstyle="butt", zorder=2.1)  # fmt: skip
    return bands


def _metres(value: float) -> str:
    """Whole metres, with a decimal below ten; a dash for what is not known."""
    if np.isnan(value):
        return "-"
    return f"{value:.1f} m" if value < 9.95 else f"{value:.0f} m"


def _short(value: float) -> str:
    """Three digits without an exponent: 0.00123, 1.23, 123, 1234."""
    return f"{value:#.3g}".rstrip(".") if value < 999.5 else f"{value:.0f}"


def _round_up(value: float) -> float:
    """The next of ..., 1, 2, 5, 10, 20, 50, ..."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * next(step for step in (1, 2, 5, 10) if step * decade >= value))
