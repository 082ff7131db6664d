"""Figures of a satellite receiver: satellites in view, errors of its clock and pseudoranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import BIAS, DRIFT
from kfenv.scenarios.recording import FaultInterval

from ..plotting import COLOURS, clean, shade
from .figures import DASHES
from .gnss_pseudoranges import PseudorangeErrors
from .monte_carlo import Outcome

Array = NDArray[np.float64]

LINEAR = 10.0  # m: greater errors are drawn logarithmically


def receiver(
    time: Array,
    satellites: NDArray[np.int64],
    outcomes: Mapping[str, Outcome],
    faults: Sequence[FaultInterval],
) -> Figure:
    """Number of satellites above, RMSE of the clock's bias and drift below, faults shaded.

    A degraded clock's jitter is an error of the measurements here, not part of the truth.

    Args:
        time: (K,), s.
        satellites: (K,) received.
    """
    figure = Figure((9.0, 7.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    panels[0].step(time, satellites, where="post", color="black", lw=1.4)
    panels[0].set(ylabel="satellites", ylim=(-0.3, satellites.max() + 1.0))
    for axes, column, label in ((panels[1], BIAS, "bias, m"), (panels[2], DRIFT, "drift, m/s")):
        for style, (name, outcome) in enumerate(outcomes.items()):
            kept = outcome.error[~outcome.lost, :, column]
            if len(kept):
                rms = np.sqrt(np.mean(kept**2, axis=0))
                axes.plot(time, rms, color=COLOURS[style], ls=DASHES[style], lw=1.4, label=name)
        axes.set_yscale("log")
        axes.set_ylabel(f"RMSE of the clock's {label}")
    for axes in panels:
        shade(axes, faults, labelled=axes is panels[1])
        clean(axes)
    panels[-1].set_xlabel("time, s")
    figure.legend(*panels[1].get_legend_handles_labels(), frameon=False, ncols=3, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure


def pseudorange_errors(errors: PseudorangeErrors, faults: Sequence[FaultInterval]) -> Figure:
    """Of one run: tropospheric delays, what is left of them, and the errors that filters meet."""
    figure = Figure((9.0, 8.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    heard = np.flatnonzero(np.isfinite(errors.troposphere).any(axis=0))
    drawn = (errors.troposphere, 1e3 * errors.left, errors.error)
    for line, channel in enumerate(heard):
        up = np.degrees(errors.elevation[np.isfinite(errors.troposphere[:, channel]), channel])
        label = f"channel {channel + 1}, {up[0]:.0f}° to {up[-1]:.0f}°"
        for axes, values in zip(panels, drawn, strict=True):
            axes.plot(errors.time, values[:, channel], color=COLOURS[line], lw=1.2, label=label)
    panels[0].set(ylabel="tropospheric delay, m", ylim=(0.0, None))
    panels[1].set(ylabel="left once corrected, mm")
    panels[2].set(ylabel="pseudorange error, m", xlabel="time, s")
    panels[2].set_yscale("symlog", linthresh=LINEAR)
    for axes in panels:
        shade(axes, faults, labelled=False)
        clean(axes)
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=4, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure
