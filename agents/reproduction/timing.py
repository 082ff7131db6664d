"""Computing time of the filters, one process, best of repeats, nothing else measured meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.filters.engine import Engine
from kfenv.scenarios.recording import Recording

from ..plotting import COLOURS, clean
from .monte_carlo import Method, filter_recording

Array = NDArray[np.float64]

INTERVALS = (0.1, 0.2, 0.25, 0.5, 1.0)  # s, the range of S1 Fig. 8
STEPS = 150
REPEATS = 7
MANY = 256
ENGINE = "engine"


class Timing(NamedTuple):
    """Seconds per step of one filter, by label: alone, and each in a batch of `MANY`."""

    alone: dict[str, float]
    together: dict[str, float]


def time_filters(scenario: Any, methods: Sequence[Method], seed: int) -> Timing:
    """Time every method, and the engine, on the first steps of a scenario."""
    rng = np.random.default_rng(seed)
    many = _beginning(scenario.sample([rng] * MANY))
    one = many[[0]]
    engine = Engine(scenario.motion, scenario.sensor)
    work = {m.label: partial(filter_recording, scenario, m) for m in methods}
    work[ENGINE] = engine.run
    return Timing(_least_times(work, one), _least_times(work, many))


def _least_times(
    work: dict[str, Callable[[Recording], Any]], recording: Recording
) -> dict[str, float]:
    """Least time of each piece of work over some rounds, per filter and step.

    All take part in every round, so that a busy machine slows them alike; the first
    round warms up.
    """
    least = dict.fromkeys(work, np.inf)
    for repeat in range(REPEATS + 1):
        for label, run in work.items():
            start = perf_counter()
            run(recording)
            if repeat > 0:
                least[label] = min(least[label], perf_counter() - start)
    return {label: time / recording.measurement[..., 0].size for label, time in least.items()}


def _beginning(recording: Recording) -> Recording:
    """The first steps alone, so that each repeat is short."""
    series = ("measurement", "noise", "motion_inputs", "sensor_inputs")
    return Recording(
        recording.time[:STEPS],
        **{name: getattr(recording, name)[:, :STEPS] for name in series},
        mean=recording.mean,
        factor=recording.factor,
    )


def figure(timing: Timing, duration: float) -> Figure:
    """Time per step, and per trajectory of `duration` against the interval between steps."""
    drawn = Figure((11.0, 5.0), layout="constrained")
    left, right = drawn.subplots(1, 2)
    labels = list(timing.alone)
    rows = np.arange(len(labels))[::-1]
    for times, shift, colour, name in (
        (timing.alone, 0.2, COLOURS[4], "alone"),
        (timing.together, -0.2, COLOURS[1], f"one of a batch of {MANY}"),
    ):
        microseconds = [1e6 * times[label] for label in labels]
        left.barh(rows + shift, microseconds, 0.4, color=colour, label=name)
    left.set_yticks(rows, labels)
    left.set_xscale("log")
    left.set_xlabel("time per step, µs")
    left.legend(frameon=False, fontsize=9, loc="lower right")
    intervals = np.array(INTERVALS)
    for style, label in enumerate(labels):
        right.plot(intervals, timing.alone[label] * (duration / intervals + 1.0), "o-", ms=3,
                   color=COLOURS[style % len(COLOURS)], label=label)  # fmt: skip
    right.set(xscale="log", yscale="log", xlabel="interval between steps, s")
    right.set_ylabel(f"time per trajectory of {duration:g} s, alone, s")
    right.set_title("the time per step times the number of steps", loc="left", fontsize=10)
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        clean(axes)
    return drawn
