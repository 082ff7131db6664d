"""Scenarios whose episodes may be windows of a log of plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Sensor
from kfenv.scenarios.radar.plot_log import (
    FIRST,
    MAX_STEP,
    PlotLog,
    instants_of,
    make_log,
    measured_noise,
)
from kfenv.scenarios.radar.plot_truth import check_truth, true_states
from kfenv.scenarios.radar.plots import Plots, column, read_plots
from kfenv.scenarios.recording import Recording, Whole
from kfenv.scenarios.reports import Site
from kfenv.scenarios.scenario import TrackingScenario
from kfenv.scenarios.tracks import LONGEST_GAP
from kfenv.scenarios.windows import PARTS

Array = NDArray[np.float64]
PlotFiles = str | Sequence[str]

ALIKE = 0.01  # share by which a rate may miss the log's
ENOUGH = 30  # plots to measure their noise on, at least

# What goes with a log
BESIDE = (
    "duration", "rate", "plots", "radar_position", "cutoff", "longest_gap", "noise_deviation",
)  # fmt: skip


class Plotted(TrackingScenario):
    """A scenario with a field `plots`: the path of a file, or of it and of its truth."""

    plots: PlotFiles | None

    def _settle_plots(self) -> None:
        """Take the log's rate, and complain of what does not go with it."""
        if self.plots is None:
            return
        told = is_number(self.rate) and abs(self.rate / self.log.rate - 1.0) < ALIKE
        if not told and self.rate != type(self).rate:
            raise ValueError(
                f"rate is the log's, {self.log.rate:g} per second: leave it out with plots, got "
                f"{self.rate!r}."
            )
        object.__setattr__(self, "rate", self.log.rate)
        for item in fields(self):
            if item.name not in BESIDE and getattr(self, item.name) != item.default:
                raise ValueError(f"{item.name} is for simulated episodes: leave it out with plots.")

    def _check_plots(self) -> None:
        """Complain of a log without a window to train on."""
        if self.plots is not None:
            self.log.random_starts([], self.duration, "tuning")

    @property
    def log(self) -> PlotLog | None:
        """The real log, if there is one."""
        if self.plots is None:
            return None
        smoothing = getattr(self, "cutoff", None), getattr(self, "longest_gap", LONGEST_GAP)
        site = getattr(self, "radar_position", None)
        deviation = getattr(self, "noise_deviation", None)
        return log_of(
            self.plots, self.sensor, None if site is None else tuple(site), smoothing,
            None if deviation is None else tuple(deviation),
        )  # fmt: skip

    @property
    def longest_step(self) -> float:
        """The longest that the filter steps at once, s, with room for rounding."""
        return super().longest_step if self.plots is None else MAX_STEP * (1.0 + 1e-6)

    @property
    def steps_per_measurement(self) -> int:
        """Filter steps from one measurement to the next."""
        return 1 if self.plots is None else self.log.steps_per_plot

    def sample(self, rngs: Sequence[Generator]) -> Recording:
        """Draw one episode from each generator: of a log, a window of its first part."""
        if self.plots is None:
            return super().sample(rngs)
        starts = self.log.random_starts(rngs, self.duration, "tuning")
        return self.log.recording(starts, len(self.time))

    def recorded(self, split: str, episodes: int) -> Recording | None:
        """The windows of a log that are kept for validation or test, None for other episodes.

        Raises:
            ValueError: if the log is too short for two of them.
        """
        if self.plots is None or split == "tuning":
            return None
        starts = self.log.starts(self.duration, split)[:episodes]
        return self.log.recording(starts, len(self.time))

    def whole(self, after: float | None = None) -> Whole | None:
        """All plots of a log but for the first, which tell where the target begins."""
        if self.plots is None:
            return None
        log, begin = self.log, self.log.begin if after is None else after
        later = np.flatnonzero(log.begin + log.time[log.plots] >= begin)[FIRST - 1 :]
        start = log.plots[later[0]] if len(later) else len(log.time)
        if start > len(log.time) - 2:
            return None
        recording = log.recording(np.array([start]), len(log.time) - start, missing=False)
        recording = recording if log.told else replace(recording, truth=None, scored=None)
        return Whole(recording, log.begin + log.time[start])


def log_of(
    files: object, sensor: Sensor, site: Site | None = None,
    smoothing: tuple[float | None, float] = (None, LONGEST_GAP),
    deviation: tuple[float, ...] | None = None,
) -> PlotLog:  # fmt: skip
    """Read a log from the path of a file of plots, or from those of it and its truth.

    Args:
        files: one path or two.
        sensor: whose channels they tell.
        site: of the radar: latitude, longitude (deg) and height (m).
        smoothing: of a flight that is the truth, see `plot_truth`.
        deviation: of the channels, in the columns' units, where the file tells none. Without,
            it is measured on the log's part for tuning.

    Raises:
        FileNotFoundError, ValueError: as `read_plots` and `true_states`, or if they are no paths.
    """
    paths = (files,) if isinstance(files, str | PathLike) else files
    right = isinstance(paths, Sequence) and len(paths) in (1, 2)
    if not right or not all(isinstance(path, str | PathLike) for path in paths):
        raise ValueError(
            "plots must be the path of a CSV file, or of it and of one with the true track, got "
            f"{files!r}."
        )
    resolved = [Path(path).resolve() for path in paths]
    state = [file.stat() for file in resolved if file.is_file()]
    written = tuple((found.st_size, found.st_mtime_ns) for found in state)
    return _read_once(tuple(map(str, resolved)), sensor, site, smoothing, deviation, written)


@lru_cache(maxsize=8)
def _read_once(
    files: tuple[str, ...], sensor: Sensor, site: Site | None,
    smoothing: tuple[float | None, float], deviation: tuple[float, ...] | None,
    written: tuple,
) -> PlotLog:  # fmt: skip
    """The log, read anew when its files have changed."""
    plots = read_plots(files[0], sensor)
    instants = instants_of(plots.time, plots.path)
    noise = told_noise(plots, sensor, deviation)
    truth = None
    if len(files) == 2:
        truth = true_states(files[1], instants[0], site, smoothing)
        row = instants[1]
        check_truth(files[1], plots, sensor, truth[0][row], truth[1][row], noise)
    return make_log(plots, sensor, noise, truth, instants)


def told_noise(plots: Plots, sensor: Sensor, deviation: tuple[float, ...] | None) -> Array:
    """Standard deviations (N, m): those of the file, else the given or the measured ones."""
    angles = [i for i, channel in enumerate(sensor.channels) if channel.angle]
    usual = np.array(deviation or (), dtype=float)
    usual[angles if deviation else []] *= np.pi / 180.0
    if deviation is None:
        learnt = plots.time <= plots.time[0] + PARTS["tuning"][1] * np.ptp(plots.time)
        learnt[:ENOUGH] = True
        usual = measured_noise(plots.time[learnt], plots.value[learnt], angles)
        if not (usual > 0.0).all():
            raise ValueError(
                f"{plots.path}: its rounded numbers tell no noise: add the columns "
                f"{', '.join(column(channel, '_std') for channel in sensor.channels)}."
            )
    return np.where(np.isnan(plots.deviation), usual, plots.deviation)
