"""Computing time of the filters, one process, best of repeats, nothing else measured meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple, TypeVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.filters.engine import Engine
from kfenv.scenarios.recording import Recording

from ..plotting import COLOURS, clean
from .monte_carlo import Method, filter_recording

Array = NDArray[np.float64]
Work = dict[str, Callable[[Recording], Any]]
Key = TypeVar("Key")

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
    work = _work(scenario, methods)
    return Timing(*(_per_step(work, recording) for recording in (many[[0]], many)))


def _per_step(work: Work, recording: Recording) -> dict[str, float]:
    """Per filter and step."""
    seconds = _least_times({label: partial(run, recording) for label, run in work.items()})
    return {label: time / recording.measurement[..., 0].size for label, time in seconds.items()}


def time_trajectories(
    scenario: Any, methods: Sequence[Method], recordings: Sequence[Recording]
) -> dict[str, Array]:
    """Seconds that every method, and the engine, takes for each whole recording of one run."""
    work = _work(scenario, methods)
    seconds = _least_times(
        {
            (label, k): partial(run, recording)
            for k, recording in enumerate(recordings)
            for label, run in work.items()
        }
    )
    return {label: np.array([seconds[label, k] for k in range(len(recordings))]) for label in work}


def _work(scenario: Any, methods: Sequence[Method]) -> Work:
    work = {m.label: partial(filter_recording, scenario, m) for m in methods}
    return work | {ENGINE: Engine(scenario.motion, scenario.sensor).run}


def _least_times(work: dict[Key, Callable[[], Any]]) -> dict[Key, float]:
    """Least time of each piece of work over some rounds, s.

    All take part in every round, so that a busy machine slows them alike; the first
    round warms up.
    """
    least = dict.fromkeys(work, np.inf)
    for repeat in range(REPEATS + 1):
        for key, run in work.items():
            start = perf_counter()
            run()
            if repeat > 0:
                least[key] = min(least[key], perf_counter() - start)
    return least


def _beginning(recording: Recording) -> Recording:
    """The first steps alone, so that each repeat is short."""
    series = ("measurement", "noise", "motion_inputs", "sensor_inputs")
    return Recording(
        recording.time[:STEPS],
        **{name: getattr(recording, name)[:, :STEPS] for name in series},
        mean=recording.mean,
        factor=recording.factor,
    )


def figure(timing: Timing) -> Figure:
    """Time per step of each filter, alone and in a batch."""
    drawn = Figure((7.0, 4.5), layout="constrained")
    axes = drawn.subplots()
    labels = list(timing.alone)
    rows = np.arange(len(labels))[::-1]
    for times, shift, colour, name in (
        (timing.alone, 0.2, COLOURS[4], "alone"),
        (timing.together, -0.2, COLOURS[1], f"one of a batch of {MANY}"),
    ):
        microseconds = [1e6 * times[label] for label in labels]
        axes.barh(rows + shift, microseconds, 0.4, color=colour, label=name)
    axes.set_yticks(rows, labels)
    axes.set(xscale="log", xlabel="time per step, µs")
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    clean(axes)
    return drawn


def growth_figure(intervals: Sequence[float], times: Mapping[str, Array]) -> Figure:
    """Measured time per trajectory (K,) of each filter over the intervals (K,) between steps."""
    drawn = Figure((7.0, 5.0), layout="constrained")
    axes = drawn.subplots()
    for style, (label, seconds) in enumerate(times.items()):
        axes.plot(intervals, seconds, "o-", ms=4, color=COLOURS[style], label=label)
    slope = np.array(next(iter(times.values()))[0] * intervals[0]) / np.array(intervals)
    axes.plot(intervals, slope, color="#999999", lw=4, alpha=0.4, label="slope of 1/dt")
    axes.set(xscale="log", yscale="log", xlabel="interval dt between steps, s")
    axes.set_xticks(intervals, [f"{interval:g}" for interval in intervals], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_ylabel("time per trajectory, alone, s")
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    clean(axes)
    return drawn
