"""An episode as a film: the track from above, a close-up, the error and the knobs over time."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from kfenv.envs import curves, panels
from kfenv.envs.history import History
from kfenv.envs.knobs import Knob
from kfenv.envs.panels import Panel
from kfenv.scenarios.recording import Recording

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

    from kfenv.envs.core import Core

Array = NDArray[np.float64]

SIZE, DPI = (12.0, 9.0), 100  # inches; 1200 x 900 pixels


class Film:
    """Draws one episode as it unfolds.

    Positions are drawn in the scenario's `local_frame`. Measurements are
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
        position = core.yardstick.values(info["estimate"])
        covariance = core.scored_covariance()[0]
        factors = core.factors[0, core.knob_place]
        error = info.get(core.yardstick.error_name, np.nan)
        self.append(info["time"], position, covariance, error, factors)

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
            mapped = self._scenario.yardstick.name == "position"
            lay_out = panels.lay_out if mapped else curves.lay_out
            self._panels = lay_out(self._figure, self._scenario, self._knobs, self._history)
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
