"""What all figures share: colours, the shading of faults, and how they are saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kfenv.scenarios.recording import FaultInterval

from .files import written_whole

# Okabe and Ito's palette, told apart with any colour vision, and some more.
COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7", "#999999",
           "#7F3B08", "#B2ABD2", "#35978F", "#C51B7D", "#F0E442", "#4D4D4D", "#8073AC")  # fmt: skip
SHADES = {"jamming": "#D55E00", "clock degradation": "#CC79A7", "signal loss": "#777777",
          "PLL failure": "#777777", "range step": "#0072B2", "range ramp": "#009E73",
          "multipath": "#E69F00"}  # fmt: skip


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with written_whole(path) as file:
        figure.savefig(file, format="png", dpi=130)


def shade(axes: Axes, faults: Sequence[FaultInterval], labelled: bool = True) -> None:
    """Shade the intervals of jamming, a degraded clock, and loss of all signals."""
    seen: set[str] = set()
    for fault in faults:
        if fault.label not in SHADES:
            continue
        label = fault.label if labelled and fault.label not in seen else None
        seen.add(fault.label)
        axes.axvspan(fault.start, fault.stop, color=SHADES[fault.label], alpha=0.15, lw=0,
                     label=label)  # fmt: skip


def clean(axes: Axes) -> None:
    """No frame to the right and above, a faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
