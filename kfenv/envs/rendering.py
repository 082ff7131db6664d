"""An episode as a film: the track from above, a close-up, the error and the knobs over time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from os import PathLike
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import Knob
from kfenv.models.model import Sensor
from kfenv.scenarios.recording import FaultInterval, Recording

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    from kfenv.envs.core import Core

Array = NDArray[np.float64]

SIZE, DPI = (12.0, 9.0), 100  # inches; 1200 x 900 pixels
KM = 1e3  # m

# Okabe and Ito's palette, which colour-blind people can tell apart.
INK, FAINT, GRID = "#2B2B2B", "#7A7A7A", "#E9E9E9"
ESTIMATE, TRUTH, MEASUREMENT = "#0072B2", "#C4C4C4", "#8C8C8C"
KNOB_COLOURS = ("#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#2B2B2B")
FAULT_COLOURS = ("#F6CDB4", "#D5D9EE", "#F3E7A6", "#CDE8DD", "#EBD3E2")

ELLIPSE_SCALE = np.sqrt(5.991)  # 95 % of a normal distribution in two dimensions
CIRCLE = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 73)),
                   np.sin(np.linspace(0.0, 2.0 * np.pi, 73))])  # fmt: skip
RECENT = 30  # measurements that the close-up shows


class Film:
    """Draws one episode as it unfolds.

    Position components count as east, north and up of a local frame. Measurements are
    dots on the map where the sensor measures positions (see `measured_positions`).

    Args:
        scenario: gives motion, sensor, name and error scale.
        knobs: those the agent turns.
        render_mode: ``"rgb_array"`` for images, ``"human"`` for a live window.
    """

    def __init__(self, scenario: Any, knobs: Sequence[Knob], render_mode: str) -> None:
        self._scenario, self._knobs = scenario, tuple(knobs)
        human = render_mode == "human"
        self._window = human and _has_windows()
        self._mute = human and not self._window
        self._figure: Figure | None = None
        self._panels: list[Panel] = []
        self._background: Any = None
        self._history: History | None = None

    def start(self, recording: Recording) -> None:
        """Begin a new episode, given as a Recording of just that one."""
        self._history = History(self._scenario, recording, len(self._knobs))
        self._panels, self._background = [], None

    def add(self, core: Core, info: dict[str, Any]) -> None:
        """Take in a step of an environment: its core (of one filter) and its info."""
        position = info["estimate"][list(self._scenario.motion.position)]
        covariance = core.position_covariance()[0]
        factors = core.factors[0, core.knob_place]
        self.append(info["time"], position, covariance, info["position_error"], factors)

    def append(
        self, time: float, position: Array, covariance: Array, error: float, factors: Array
    ) -> None:
        """Take in an update of any filter.

        Args:
            time: s.
            position, covariance: posterior estimate (3,) and its covariance (3, 3).
            error: distance to the true position, m; NaN where the truth is unknown.
            factors: those of the knobs.
        """
        self._started().append(time, position, covariance, error, factors)

    def draw(self) -> NDArray[np.uint8] | None:
        """Draw the episode so far: an image (height, width, 3), or the window."""
        self._started()
        if self._mute or self._closed_by_user():
            return None
        self._paint(self._update())
        canvas = self._figure.canvas
        if not self._window:
            return np.asarray(canvas.buffer_rgba())[..., :3].copy()
        canvas.start_event_loop(0.001)  # unlike pyplot.pause it leaves the focus where it is
        return None

    def save(self, path: str | PathLike[str]) -> None:
        """Write the episode so far to a file, in the format that its name ends with."""
        self._started()
        self._update()
        self._figure.savefig(path, dpi=DPI)
        self._background = None  # saving has drawn over it

    def close(self) -> None:
        """Close the window and forget the drawing."""
        if self._figure is not None and self._window:
            import matplotlib.pyplot as plt

            plt.close(self._figure)
        self._figure, self._panels, self._background = None, [], None

    def _closed_by_user(self) -> bool:
        if self._figure is None or not self._window:
            return False
        import matplotlib.pyplot as plt

        return not plt.fignum_exists(self._figure.number)

    def _started(self) -> History:
        if self._history is None:
            raise RuntimeError("The film has no episode: call reset() first.")
        return self._history

    def _update(self) -> bool:
        """Bring all panels up to date; whether anything but their moving artists changed."""
        if self._figure is None:
            self._figure = _new_figure(self._window, self._scenario.name)
            self._figure.canvas.mpl_connect("draw_event", self._keep_background)
        if not self._panels:
            self._panels = _build(self._figure, self._scenario, self._knobs, self._history)
            for artist in self._moving():
                artist.set_animated(self._figure.canvas.supports_blit)
        return any([panel.update(self._history) for panel in self._panels])

    def _moving(self) -> list[Artist]:
        return [artist for panel in self._panels for artist in panel.moving]

    def _paint(self, changed: bool) -> None:
        """Draw what moves over a kept picture of what does not: far faster than all anew."""
        canvas = self._figure.canvas
        if not canvas.supports_blit:
            canvas.draw_idle()
        elif changed or self._background is None:
            canvas.draw()  # calls _keep_background
        else:
            canvas.restore_region(self._background)
            self._draw_moving()
            canvas.blit(self._figure.bbox)

    def _keep_background(self, _event: Any) -> None:
        """After all has been drawn anew, by us or because the window was resized."""
        canvas = self._figure.canvas
        if canvas.supports_blit and not canvas.is_saving():
            self._background = canvas.copy_from_bbox(self._figure.bbox)
            self._draw_moving()

    def _draw_moving(self) -> None:
        for artist in self._moving():
            artist.axes.draw_artist(artist)


class History:
    """What the film knows: the episode's recording and the filter's run so far.

    Attributes:
        time: (T,) the instants of the episode, s.
        truth, measured: true and measured positions (T, 3), or None.
        lasting, passing: faults that last the whole episode and those that do not.
        colours: of the passing faults' labels.
        steps: the times of the updates so far.
        position, covariance, error, factors: of the updates so far.
        centre, spread: the latest estimate (3,) and covariance (3, 3), first the initial one.
    """

    def __init__(self, scenario: Any, recording: Recording, knobs: int) -> None:
        place = list(scenario.motion.position)
        self.time = recording.time
        self.truth = None if recording.truth is None else recording.truth[0][:, place]
        self.measured = measured_positions(scenario.sensor, recording.measurement[0])
        first, last = self.time[0], self.time[-1]
        faults = merged(recording.faults[0])
        self.lasting = [fault for fault in faults if fault.start <= first and fault.stop >= last]
        self.passing = [fault for fault in faults if fault not in self.lasting]
        labels = sorted({fault.label for fault in self.passing})
        self.colours = dict(zip(labels, cycle(FAULT_COLOURS), strict=False))
        rows = recording.factor[0][place]
        self.centre, self.spread = recording.mean[0][place], rows @ rows.T
        size = len(recording.time)
        self._count = 0
        self._steps, self._error = np.empty((2, size))
        self._position, self._covariance = np.empty((size, 3)), np.empty((size, 3, 3))
        self._factors = np.empty((size, knobs))

    def append(
        self, time: float, position: Array, covariance: Array, error: float, factors: Array
    ) -> None:
        """Take in an update."""
        i = self._count
        self._steps[i], self._error[i], self._factors[i] = time, error, factors
        self._position[i], self._covariance[i] = position, covariance
        self._count += 1
        if np.all(np.isfinite(position)) and np.all(np.isfinite(covariance)):
            self.centre, self.spread = self._position[i], self._covariance[i]

    def __len__(self) -> int:
        return self._count

    steps = property(lambda self: self._steps[: self._count])
    position = property(lambda self: self._position[: self._count])
    covariance = property(lambda self: self._covariance[: self._count])
    error = property(lambda self: self._error[: self._count])
    factors = property(lambda self: self._factors[: self._count])

    @property
    def now(self) -> int:
        """Index of the latest update's instant."""
        return int(np.searchsorted(self.time, self.steps[-1])) if len(self) else 0

    @property
    def true_position(self) -> Array | None:
        """The truth (3,) at the latest update."""
        return None if self.truth is None else self.truth[self.now]

    @property
    def seen(self) -> Array:
        """Positions measured so far (k, 3), NaN where nothing arrived."""
        if self.measured is None or not len(self):
            return np.empty((0, 3))
        return self.measured[: self.now + 1]


def measured_positions(sensor: Sensor, measurement: Array) -> Array | None:
    """Measurements (T, m) as positions (T, 3), NaN where a part of one is missing.

    None for a sensor that measures no position, such as a satellite receiver's
    pseudoranges: its film has no dots.
    """
    names = [channel.name for channel in sensor.channels]
    if not {"range", "azimuth", "elevation"} <= set(names):
        return None
    distance, azimuth, elevation = (
        measurement[:, names.index(name)] for name in ("range", "azimuth", "elevation")
    )
    horizontal = distance * np.cos(elevation)
    return np.stack(
        [
            horizontal * np.sin(azimuth),
            horizontal * np.cos(azimuth),
            distance * np.sin(elevation),
        ],
        axis=1,
    )


def merged(faults: Sequence[FaultInterval]) -> tuple[FaultInterval, ...]:
    """The intervals in time order, overlapping ones of one label joined."""
    joined: list[FaultInterval] = []
    for fault in sorted(faults, key=lambda fault: (fault.label, fault.start)):
        last = joined[-1] if joined else None
        if last is not None and last.label == fault.label and fault.start <= last.stop:
            joined[-1] = FaultInterval(last.label, last.start, max(last.stop, fault.stop))
        else:
            joined.append(fault)
    return tuple(sorted(joined, key=lambda fault: fault.start))


def ellipse(covariance: Array) -> Array:
    """Outline (2, k) of the 95 % region of a horizontal error with this covariance (3, 3)."""
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    return ELLIPSE_SCALE * (axes * np.sqrt(np.maximum(variances, 0.0))) @ CIRCLE


# ----- panels -------------------------------------------------------------------------


class Panel:
    """A part of the picture: still artists drawn once, and the `moving` ones."""

    axes: Axes
    moving: list[Artist]

    def update(self, history: History) -> bool:
        """Bring the moving artists up to date; whether the still ones changed as well."""
        raise NotImplementedError


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
        of = "the estimate" if history.truth is None else "the true position"
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
        seen = history.seen[-RECENT:, :2] - self.middle
        self._dots.set_data(*seen.T)
        self._latest.set_data(*seen[-1:].T)
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
        self._bound_text.set_text(f"{predicted[-1]:.0f} m")
        if history.truth is not None:
            self._error_text.set_text(f"{history.error[-1]:.0f} m")
            self._rms_text.set_text(f"{np.sqrt(np.mean(history.error**2)):.0f} m")
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
                    label="true track",
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
        self._time.set_text(f"{now:.1f} of {history.time[-1]:.0f} s")
        return False


# ----- drawing ------------------------------------------------------------------------


def _has_windows() -> bool:
    """Whether pyplot can open windows here; warns if not."""
    import matplotlib.pyplot as plt
    from matplotlib.backends import BackendFilter, backend_registry

    backend = plt.get_backend()
    if backend.lower() not in backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE):
        return True
    gym.logger.warn(
        f"render_mode='human' draws nothing, because matplotlib's backend {backend!r} opens no "
        "window: set MPLBACKEND, e.g. to QtAgg or TkAgg, or use render_mode='rgb_array'."
    )
    return False


def _new_figure(window: bool, title: str) -> Figure:
    """A window's figure, or one that pyplot knows nothing of."""
    if window:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=SIZE, dpi=DPI)
        figure.canvas.manager.set_window_title(title)
        plt.show(block=False)
        return figure
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def _build(figure: Figure, scenario: Any, knobs: Sequence[Knob], history: History) -> list[Panel]:
    """Lay the panels out; the close-up comes before the map, which frames it."""
    figure.clear()
    figure.set_facecolor("white")
    scale, widest = scenario.error_scale, scenario.lost_distance
    header = Header(figure.add_axes((0.065, 0.925, 0.915, 0.065)), history, scenario.name)
    close_up = CloseUp(figure.add_axes((0.6575, 0.45, 0.3225, 0.43)), history, widest)
    radar = history.measured is not None
    track = Map(figure.add_axes((0.065, 0.45, 0.54, 0.43)), history, close_up, radar)
    error = ErrorPanel(figure.add_axes((0.065, 0.23, 0.745, 0.15)), history, scale, widest)
    knob = KnobPanel(figure.add_axes((0.065, 0.06, 0.745, 0.15)), history, knobs)
    return [header, close_up, track, error, knob]


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


def _short(value: float) -> str:
    """Three digits without an exponent: 0.00123, 1.23, 123, 1234."""
    return f"{value:#.3g}".rstrip(".") if value < 999.5 else f"{value:.0f}"


def _round_up(value: float) -> float:
    """The next of ..., 1, 2, 5, 10, 20, 50, ..."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * next(step for step in (1, 2, 5, 10) if step * decade >= value))
