"""The parts of a film's picture: map, close-up, error, knobs and header."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.drawing import (
    ESTIMATE,
    FAINT,
    INK,
    KNOB_COLOURS,
    MEASUREMENT,
    TRUTH,
    ellipse,
    fault_names,
    plain_log_ticks,
    readout,
    round_up,
    short,
    style,
    time_axis,
    told,
    true_track,
)
from kfenv.envs.history import History
from kfenv.envs.knobs import Knob
from kfenv.models.yardstick import Yardstick

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

KM = 1e3  # m

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
    error = ErrorPanel(
        figure.add_axes((0.065, 0.23, 0.745, 0.15)), history, scale, widest, scenario.yardstick
    )
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
        style(axes, "Track from above: kilometres east and north")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(7, steps=(1, 2, 5, 10)))
        self._known = history.truth is not None or history.measured is not None
        self._view(self._extent(history, radar))
        if history.truth is not None:
            true_track(axes, history, KM)
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
        style(axes, f"Close-up: metres from {of}")
        self._bands = [] if history.truth is None else true_track(axes, history, 1.0)
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
        self.half_width = half = round_up(1.4 * needed)
        self.axes.set(xlim=(-half, half), ylim=(-half, half),
                      xticks=(-half / 2, 0, half / 2), yticks=(-half / 2, 0, half / 2))  # fmt: skip
        return True


class ErrorPanel(Panel):
    """Position error over time on a log axis, with what the filter predicts of it."""

    def __init__(
        self, axes: Axes, history: History, scale: float, widest: float, yardstick: Yardstick
    ) -> None:
        self.axes, self._widest, self._unit = axes, widest, yardstick.unit
        self._weight = yardstick.weight
        style(axes, "", f"{yardstick.name} error ({self._unit})")
        time_axis(axes, history)
        fault_names(axes, history)
        axes.tick_params(labelbottom=False)
        axes.set_yscale("log")
        axes.set_ylim(scale / 100.0, scale * 4.0)
        plain_log_ticks(axes, decades=1)
        (self._bound,) = axes.plot([], [], color=ESTIMATE, lw=1.4, zorder=3)
        (self._error,) = axes.plot([], [], color=INK, lw=1.2, zorder=4)
        self._bound_text = readout(axes, 0.25, ESTIMATE, "predicted 2 sigma")
        self.moving = [self._bound, self._error, self._bound_text]
        if history.truth is not None:
            self._error_text = readout(axes, 0.75, INK, "error")
            self._rms_text = readout(axes, 0.5, FAINT, "RMS so far")
            self.moving += [self._error_text, self._rms_text]

    def update(self, history: History) -> bool:
        """Extend the curves, and the axis where they leave it."""
        variance = np.diagonal(history.covariance, axis1=1, axis2=2)
        predicted = 2.0 * np.sqrt(variance @ self._weight**2)
        self._bound.set_data(history.steps, predicted)
        self._error.set_data(history.steps, history.error)
        if not len(history):
            return False
        self._bound_text.set_text(told(predicted[-1], self._unit))
        if history.truth is not None:
            self._error_text.set_text(told(history.error[-1], self._unit))
            known = history.error[np.isfinite(history.error)]
            rms = np.sqrt(np.mean(known**2)) if len(known) else np.nan
            self._rms_text.set_text(told(rms, self._unit))
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
        style(axes, "", "knob factors")
        axes.set_xlabel("time (s)", fontsize=9.5, color=FAINT)
        time_axis(axes, history)
        axes.set_yscale("log")
        axes.set_ylim(min(knob.low for knob in knobs) / 2, max(knob.high for knob in knobs) * 2)
        plain_log_ticks(axes, decades=2)
        axes.axhline(1.0, color=FAINT, lw=0.8, zorder=1)
        spacing = min(0.2, 1.0 / len(knobs))
        self._lines, self._texts = [], []
        for i, knob in enumerate(knobs):
            colour = KNOB_COLOURS[i % len(KNOB_COLOURS)]
            self._lines += axes.plot([], [], color=colour, lw=1.6, drawstyle="steps-pre")
            name = knob.name.replace("_", " ")
            self._texts.append(readout(axes, 0.9 - i * spacing, colour, name))
        self.moving = [*self._lines, *self._texts]

    def update(self, history: History) -> bool:
        """Extend the curves."""
        for i, (line, text) in enumerate(zip(self._lines, self._texts, strict=True)):
            line.set_data(history.steps, history.factors[:, i])
            text.set_text(short(history.factors[-1, i] if len(history) else 1.0))
        return False


class Header(Panel):
    """The scenario's name, the lasting faults, the legend and the time."""

    def __init__(self, axes: Axes, history: History, name: str, mapped: bool = True) -> None:
        self.axes, self._mapped = axes, mapped
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

        estimate = {"color": ESTIMATE, "marker": "o" if self._mapped else "", "mec": "white"}
        entries = [Line2D([], [], **estimate, ms=8, label="estimate")]
        if self._mapped:
            entries.append(Line2D([], [], color=ESTIMATE, marker="o", ls="", ms=11, alpha=0.3,
                                  label="95 % ellipse"))  # fmt: skip
        else:
            entries.append(Line2D([], [], color=ESTIMATE, lw=0.8, label="two deviations"))
        if self._mapped and history.measured is not None:
            entries.append(Line2D([], [], color=MEASUREMENT, marker="o", ls="", mec="none", ms=5,
                                  label="measurements"))  # fmt: skip
        if history.truth is not None:
            cross = {"marker": "+", "mec": INK, "ms": 9, "mew": 1.5} if self._mapped else {}
            name = "track of all fixes" if history.guessed else "true track"
            entries.append(Line2D([], [], color=TRUTH, lw=6 if self._mapped else 4, **cross,
                                  label=name if self._mapped else "truth"))  # fmt: skip
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
