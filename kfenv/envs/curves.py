"""The film of a filter whose errors are not those of a position: each component over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kfenv.envs.drawing import ESTIMATE, TRUTH, style, time_axis
from kfenv.envs.history import History
from kfenv.envs.knobs import Knob
from kfenv.envs.panels import ErrorPanel, Header, KnobPanel, Panel
from kfenv.models.model import Component

if TYPE_CHECKING:  # matplotlib is slow to import, and few runs draw
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 4  # components that are drawn
LEFT, WIDTH, BOTTOM, TOP = 0.065, 0.745, 0.45, 0.88  # of the figure


def lay_out(figure: Figure, scenario: Any, knobs: Sequence[Knob], history: History) -> list[Panel]:
    """Fill the figure with a panel for each component, then error and knobs."""
    figure.clear()
    figure.set_facecolor("white")
    yardstick = scenario.yardstick
    shown = yardstick.components[:MOST]
    height = (TOP - BOTTOM) / len(shown)
    place = (0.065, 0.925, 0.915, 0.065)
    header = Header(figure.add_axes(place), history, scenario.name, mapped=False)
    components = [
        ComponentPanel(
            figure.add_axes((LEFT, TOP - (i + 1) * height, WIDTH, 0.85 * height)), history, i, told
        )
        for i, told in enumerate(shown)
    ]
    error = ErrorPanel(
        figure.add_axes((LEFT, 0.23, WIDTH, 0.15)), history, scenario.error_scale,
        scenario.lost_distance, yardstick,
    )  # fmt: skip
    return [header, *components, error, KnobPanel(figure.add_axes((LEFT, 0.06, WIDTH, 0.15)),
                                                  history, knobs)]  # fmt: skip


class ComponentPanel(Panel):
    """The estimate of one component over time, with two deviations either way, and the truth."""

    def __init__(self, axes: Axes, history: History, place: int, component: Component) -> None:
        self.axes, self._place = axes, place
        style(axes, "", f"{component.name} ({component.unit})")
        time_axis(axes, history)
        axes.tick_params(labelbottom=False)
        if history.truth is not None:
            axes.plot(history.time, history.truth[:, place], color=TRUTH, lw=4, zorder=2)
        (self._bounds,) = axes.plot([], [], color=ESTIMATE, lw=0.8, alpha=0.6, zorder=3)
        (self._estimate,) = axes.plot([], [], color=ESTIMATE, lw=1.4, zorder=4)
        self.moving = [self._bounds, self._estimate]

    def update(self, history: History) -> bool:
        """Extend the curves, and the axis where they leave it."""
        middle = history.position[:, self._place]
        deviation = 2.0 * np.sqrt(history.covariance[:, self._place, self._place])
        gap = [np.nan]
        times = np.concatenate([history.steps, gap, history.steps])
        self._bounds.set_data(times, np.concatenate([middle - deviation, gap, middle + deviation]))
        self._estimate.set_data(history.steps, middle)
        known = middle[np.isfinite(middle)]
        low, high = self.axes.get_ylim()
        if not len(known) or (known.min() >= low and known.max() <= high):
            return False
        margin = 0.1 * (max(high, known.max()) - min(low, known.min()))
        self.axes.set_ylim(min(low, known.min() - margin), max(high, known.max() + margin))
        return True
