"""Figures of noise that is a mixture of two Gaussians: nominal, and outlying."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm

from ..plotting import COLOURS, clean

Array = NDArray[np.float64]


def parts(x: Array, share: float, ratio: float, shift: float) -> tuple[Array, Array]:
    """Densities at x of the two parts, (1 - share) N(0, 1) and share N(shift u, u^2), u^2 = ratio.

    Args:
        x: noise in nominal deviations.
        share: of outliers.
        ratio: of their variance to the nominal one.
        shift: their mean in their own deviations.
    """
    wide = np.sqrt(ratio)
    return (1.0 - share) * norm.pdf(x), share * norm.pdf(x, shift * wide, wide)


def noise_density(drawn: Array, share: float, ratio: float, shift: float) -> Figure:
    """Density of a mixture and its parts over a histogram of what was drawn.

    Args:
        drawn: noise in nominal deviations, any number.
        share, ratio, shift: see `parts`.
    """
    figure = Figure((10.0, 4.2), layout="constrained")
    wide = np.sqrt(ratio)
    near, far = figure.subplots(1, 2)
    for axes, low, high in ((near, -5.0, 5.0), (far, -4.0 * wide, (4.0 + shift) * wide)):
        x = np.linspace(low, high, 1001)
        edges = np.linspace(low, high, 61)
        counts, _ = np.histogram(drawn, edges)
        axes.stairs(counts / (len(drawn) * np.diff(edges)), edges, fill=True, color="#cccccc",
                    label=f"{len(drawn)} draws")  # fmt: skip
        nominal, outlying = parts(x, share, ratio, shift)
        axes.plot(x, nominal + outlying, color="black", lw=2.4, label="mixture")
        axes.plot(x, nominal, color=COLOURS[2], lw=1.3, label="nominal part")
        axes.plot(x, outlying, color=COLOURS[5], lw=1.3, ls="--", label="outlying part")
        axes.set_xlabel("noise of a fix, nominal deviations")
        clean(axes)
    near.set_ylabel("density")
    far.set_yscale("log")
    far.set_ylim(1e-6, 1.0)
    figure.legend(*near.get_legend_handles_labels(), frameon=False, ncols=4, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure
