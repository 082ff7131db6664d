"""A filter under observation: how consistent it is in its updates, and what it costs."""

from __future__ import annotations

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.protocol import Episodes, Filter, Knobs, Measurement, Status
from kfenv.filters.results import OK, Prediction, Run, Update
from kfenv.models.model import Sensor

Array = NDArray[np.float64]


class Stopwatch:
    """Adds up the CPU time that calls take in this process."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self, function: Callable, *arguments: Any) -> Any:
        """What the function returns for the arguments."""
        begin = process_time()
        result = function(*arguments)
        self.seconds += process_time() - begin
        return result


class WatchedFilter:
    """A filter with a stopwatch, which also books the NIS of every update.

    Args:
        filter: the one that works.
        sensor: tells which channels belong together.
        batch: number of filters.
        looks: whether looking at a pending innovation counts as work.
    """

    def __init__(self, filter: Filter, sensor: Sensor, batch: int, looks: bool = True) -> None:
        self.filter, self.watch, self._looks = filter, Stopwatch(), looks
        groups = np.array(sensor.group_of_channel)
        self._membership = np.eye(len(sensor.groups))[groups]  # (m, G)
        self._squared = np.zeros((batch, 1 + len(sensor.groups)))
        self._arrived = np.zeros_like(self._squared)

    @property
    def nis(self) -> Array:
        """(B, 1 + G), see `kfenv.agents.contest.scores.Scores`."""
        return np.where(self._arrived > 0.0, self._squared / np.maximum(self._arrived, 1.0), np.nan)

    def predict(self, *arguments: Any) -> Prediction:
        """As the filter's."""
        return self.watch(self.filter.predict, *arguments)

    def innovate(self, *arguments: Any) -> Update:
        """As the filter's."""
        if self._looks:
            return self.watch(self.filter.innovate, *arguments)
        return self.filter.innovate(*arguments)

    def update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status,
        *more: Any,
    ) -> Update:  # fmt: skip
        """As the filter's, and booked."""
        work = self.filter.update
        result = self.watch(work, prediction, knobs, measurement, status, *more)
        self._book(result, status)
        return result

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """As the filter's, unwatched."""
        return self.filter.run(episodes, knobs)

    def _book(self, update: Update, status: Status) -> None:
        """Take in what the filters that worked say of the channels that arrived."""
        present = ~np.isnan(update.innovation) & (status == OK)[:, None]
        with np.errstate(all="ignore"):  # idle filters hold anything
            square = np.where(present, update.innovation**2 / update.variance, 0.0)
        nis = np.where(present.any(axis=1), update.nis, 0.0)
        self._squared += np.column_stack([nis, square @ self._membership])
        self._arrived += np.column_stack([present.sum(axis=1), present @ self._membership])
