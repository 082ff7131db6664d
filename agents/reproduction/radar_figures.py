"""Figures of a radar under jamming and signal loss: S/N, and errors against its noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.scenarios.recording import FaultInterval

from ..plotting import COLOURS, clean, shade
from .monte_carlo import Outcome

Array = NDArray[np.float64]

DASHES = ("-", "--", ":", "-.")  # filters often agree to the width of a line


def signal(
    time: Array,
    level: Array,
    kept: Array,
    outcomes: Mapping[str, Outcome],
    faults: Sequence[FaultInterval],
) -> Figure:
    """Signal to noise and jamming above, median condition numbers of P below, faults shaded.

    Args:
        time: (T,), s.
        level: (T,) dB, NaN where nothing arrives.
        kept: (K,) the instants of the outcomes, s.
    """
    figure = Figure((9.0, 6.5), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    above.plot(time, level, color="black", lw=1.4)
    above.set_ylabel("single-pulse S/(N + J), dB")
    for style, (label, outcome) in enumerate(outcomes.items()):
        seen = np.isfinite(outcome.condition).any(axis=0)
        median = np.nanmedian(outcome.condition[:, seen], axis=0)
        below.plot(kept[seen], median, lw=1.4, label=label, **_style(style))
    below.set(yscale="log", xlabel="time, s")
    below.set_ylabel("κ(P), median over the runs")
    for axes in (above, below):
        shade(axes, faults, labelled=axes is above)
        axes.legend(frameon=False, fontsize=8, ncols=2)
        clean(axes)
    return figure


def channel_rmse(
    time: Array,
    deviation: Array,
    channels: Sequence[str],
    outcomes: Mapping[str, Outcome],
    faults: Sequence[FaultInterval],
) -> Figure:
    """RMSE in what the radar measures, over the runs that kept the track, against its noise.

    Args:
        time: (K,), s.
        deviation: (K, 3) of the measurement noise: m, rad, rad.
        channels: their names.
    """
    figure = Figure((9.0, 7.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for c, axes in enumerate(panels):
        scale, unit = (1.0, "m") if c == 0 else (180.0 / np.pi, "°")
        axes.plot(time, scale * deviation[:, c], color="#999999", lw=3, label="radar noise")
        for style, (label, outcome) in enumerate(outcomes.items()):
            kept = outcome.channel_error[~outcome.lost, :, c]
            if len(kept):
                rms = np.sqrt(np.mean(kept**2, axis=0))
                axes.plot(time, scale * rms, lw=1.3, label=label, **_style(style))
        shade(axes, faults, labelled=c == 0)
        axes.set_yscale("log")
        axes.set_ylabel(f"{channels[c]}, {unit}")
        clean(axes)
    panels[-1].set_xlabel("time, s")
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=4, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure


def _style(number: int) -> dict[str, str]:
    return {"color": COLOURS[number], "ls": DASHES[number % len(DASHES)]}


def positions(measurement: Array) -> Array:
    """Measured range, azimuth and elevation (T, 3) as east, north and up."""
    distance, azimuth, elevation = measurement.T
    along = distance * np.cos(elevation)
    return np.stack(
        [along * np.sin(azimuth), along * np.cos(azimuth), distance * np.sin(elevation)], axis=1
    )
