"""The papers' kinds of figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.scenarios.recording import FaultInterval

from ..plotting import COLOURS, SHADES, clean, shade
from .monte_carlo import Outcome

Array = NDArray[np.float64]

AxisNames = tuple[str, str, str]
LOCAL: AxisNames = ("x (east)", "y (north)", "z (up)")
PLAIN: AxisNames = ("x", "y", "z")  # where the directions are not told
# Filters often agree to the width of a line: dashes let the one below be seen.
DASHES = ("-", (0, (6, 4)), (3, (4, 4)), (0, (2, 3)), (2, (1, 3)))


def track(
    time: Array,
    truth: Array,
    measured: Array | None,
    estimates: Mapping[str, Array],
    names: AxisNames = LOCAL,
    faults: Sequence[FaultInterval] = (),
) -> Figure:
    """One run, y over x and z against time: truth, measurements and estimates.

    Args:
        time: (T,), s.
        truth: (T, 3) positions, m.
        measured: (T, 3), NaN where nothing arrived; None where the sensor measures no position.
        estimates: (T, 3) by label.
        faults: marked where they befell the target.
    """
    figure = Figure((10.0, 4.8), layout="constrained")
    above, height = figure.subplots(1, 2)
    unit_name, unit = ("km", 1e3) if np.ptp(truth, axis=0).max() > 2e3 else ("m", 1.0)
    for axes, x_of, y in ((above, lambda p: p[:, 0] / unit, 1), (height, lambda p: time, 2)):
        if measured is not None:
            axes.plot(x_of(measured), measured[:, y] / unit, ".", color="#bbbbbb", ms=3,
                      label="measured")  # fmt: skip
        axes.plot(x_of(truth), truth[:, y] / unit, color="black", lw=2.5, label="truth")
        for style, (label, path) in enumerate(estimates.items()):
            axes.plot(x_of(path), path[:, y] / unit, lw=1.3, label=label, **_style(style, 1))
        clean(axes)
    low, high = truth.min(axis=0) / unit, truth.max(axis=0) / unit
    scatter = 0.0 if measured is None else np.nanstd(measured - truth, axis=0) / unit
    margin = 0.25 * (high - low) + 2.0 * scatter
    above.set_xlim(low[0] - margin[0], high[0] + margin[0])
    above.set_ylim(low[1] - margin[1], high[1] + margin[1])
    height.set_ylim(low[2] - 2.0 * margin[2], high[2] + 2.0 * margin[2])
    above.set(xlabel=f"{names[0]}, {unit_name}", ylabel=f"{names[1]}, {unit_name}")
    height.set(xlabel="time, s", ylabel=f"{names[2]}, {unit_name}")
    for fault in faults:
        during = (time >= fault.start) & (time <= fault.stop)
        if fault.label in SHADES and during.any():
            above.plot(*truth[during, :2].T / unit, color=SHADES[fault.label], lw=12, alpha=0.35,
                       solid_capstyle="butt", zorder=1, label=fault.label)  # fmt: skip
    shade(height, faults, labelled=False)
    height.set_xlim(time[0], time[-1])
    above.legend(frameon=False, fontsize=9)
    return figure


def rmse(
    time: Array,
    outcomes: Mapping[str, Outcome],
    bound: Array | None = None,
    names: AxisNames = LOCAL,
) -> Figure:
    """Position RMSE over the runs that kept the track, per axis against time.

    Args:
        time: (K,), s.
        bound: (K, 3) posterior Cramer-Rao bound, m.
    """
    figure = Figure((9.0, 7.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for axis, axes in enumerate(panels):
        for style, (label, outcome) in enumerate(outcomes.items()):
            kept = outcome.position_error[~outcome.lost, :, axis]
            if len(kept):
                rms = np.sqrt(np.mean(kept**2, axis=0))
                axes.plot(time, rms, lw=1.5, label=label, **_style(style))
        if bound is not None:
            axes.plot(time, bound[:, axis], color="#777777", lw=3, alpha=0.5,
                      label="posterior Cramér-Rao bound")  # fmt: skip
        axes.set_yscale("log")
        axes.set_ylabel(f"RMSE of {names[axis]}, m")
        clean(axes)
    panels[-1].set_xlabel("time, s")
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=4, fontsize=9,
                  loc="outside upper center")  # fmt: skip
    return figure


def rmse_difference(time: Array, first: Outcome, second: Outcome, title: str) -> Figure:
    """RMSE of one filter less another's on the same noise, with a 95 % interval.

    The interval is the delta method's on paired squared errors.
    """
    figure = Figure((9.0, 6.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    both = ~(first.lost | second.lost)
    for axis, axes in enumerate(panels):
        squares = [o.position_error[both, :, axis] ** 2 for o in (first, second)]
        roots = [np.sqrt(np.mean(square, axis=0)) for square in squares]
        influence = squares[0] / (2.0 * roots[0]) - squares[1] / (2.0 * roots[1])
        half = 1.96 * influence.std(axis=0, ddof=1) / np.sqrt(len(influence))
        difference = roots[0] - roots[1]
        axes.fill_between(time, difference - half, difference + half, color=COLOURS[2], alpha=0.4,
                          lw=0, label="95 % interval")  # fmt: skip
        axes.plot(time, difference, color=COLOURS[4], lw=1.2, label="difference")
        axes.axhline(0.0, color="black", lw=0.8)
        axes.set_ylabel(f"{LOCAL[axis]}, m")
        clean(axes)
    panels[0].set_title(title, loc="left")
    panels[0].legend(frameon=False, ncols=2, fontsize=9)
    panels[-1].set_xlabel("time, s")
    return figure


def condition(time: Array, outcomes: Mapping[str, Outcome]) -> Figure:
    """Condition numbers: of P where no factor S is carried, else of S with its square beside it.

    Lines are medians over the runs, thin ones the worst run.
    """
    figure = Figure((10.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    rooted = {k: o for k, o in outcomes.items() if np.isfinite(o.root_condition).any()}
    others = {label: outcome for label, outcome in outcomes.items() if label not in rooted}
    for style, (label, outcome) in enumerate(others.items()):
        _spread(left, time, outcome.condition, label, _style(style))
    for style, (label, outcome) in enumerate(rooted.items()):
        line = _style(style, len(others))
        squared = np.nanmedian(outcome.root_condition**2, axis=0)
        right.plot(time, squared, color=line["color"], lw=3.5, alpha=0.4, label=f"{label}: κ(S)²")
        _spread(right, time, outcome.root_condition, f"{label}: κ(S)", line)
    left.set_title("κ(P) of the covariance: median, thin the worst run", loc="left", fontsize=10)
    right.set_title("κ(S) of the square root, and its square", loc="left", fontsize=10)
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xlabel("time, s")
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        clean(axes)
    return figure


def _spread(axes: Axes, time: Array, values: Array, label: str, line: dict[str, Any]) -> None:
    seen = np.isfinite(values).any(axis=0)
    median, worst = (f(values[:, seen], axis=0) for f in (np.nanmedian, np.nanmax))
    axes.plot(time[seen], median, lw=1.5, label=label, **line)
    axes.plot(time[seen], worst, lw=0.5, color=line["color"])


def _style(number: int, first: int = 0) -> dict[str, Any]:
    """Colour and dashes of a figure's line."""
    return {
        "color": COLOURS[(first + number) % len(COLOURS)],
        "ls": DASHES[number % len(DASHES)],
    }


def accelerations(
    time: Array, truth: Array, estimates: Mapping[str, Array], names: AxisNames = LOCAL
) -> Figure:
    """True and estimated accelerations of one run, (T, 3), m/s^2."""
    figure = Figure((9.0, 6.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    for axis, axes in enumerate(panels):
        axes.plot(time, truth[:, axis], color="black", lw=2.2, label="truth")
        for style, (label, path) in enumerate(estimates.items()):
            axes.plot(time, path[:, axis], lw=1.2, label=label, **_style(style, 1))
        axes.set_ylabel(f"{names[axis]}, m/s²")
        clean(axes)
    panels[0].legend(frameon=False, ncols=4, fontsize=9)
    panels[-1].set_xlabel("time, s")
    return figure
