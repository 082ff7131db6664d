"""Rewards that need no truth: how well a decision foresees the innovation after it.

An agent has seen the innovation that it decides on, so that a likelihood of that one could be
bought by any noise that suits it. The *next* one it has not: it is formed with the decision's
knobs still held, and booked. For knobs that never change its log-likelihoods add up to the
filter's own (Bar-Shalom, Li and Kirubarajan 2001, sec 5.4.2), by which static noise is tuned.
"""

from __future__ import annotations

from math import log

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.envs import statistics
from kfenv.envs.rewards import CAP, LIKELIHOOD
from kfenv.filters.protocol import Filter, Knobs, Measurement
from kfenv.filters.results import Prediction, Update
from kfenv.kernel_cache import KERNEL
from kfenv.models.model import Sensor
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Status = NDArray[np.int64]


class Foresight:
    """Books the innovations that B filters foresee, beside those of the nominal filter.

    Args:
        reward: ``"likelihood"`` or ``"consistency"``.
        filter: the one inside the environment, which the nominal one is as well.
        sensor: tells which channels belong together.
        batch: B.
        states: n.

    Attributes:
        gained, arrived: (B,) log-likelihood over the nominal filter's, and channels that arrived,
            of the last decision.
    """

    def __init__(
        self, reward: str, filter: Filter, sensor: Sensor, batch: int, states: int
    ) -> None:
        self._likelihood, self._filter = reward == LIKELIHOOD, filter
        self._group = np.array(sensor.group_of_channel)
        self._knobs = Knobs.nominal(batch)
        self._mean, self._factor = np.zeros((batch, states)), np.zeros((batch, states, states))
        self._prediction = Prediction(
            np.zeros((batch, states)), *np.zeros((2, *self._factor.shape))
        )
        self._status = np.zeros(batch, np.int64)
        self._statistics = np.zeros((batch, len(sensor.groups), statistics.COLUMNS))
        self._since, self.gained, self.arrived = np.zeros((3, batch))

    def restart(self, chosen: NDArray[np.int64], recording: Recording) -> None:
        """Begin episodes at the chosen places."""
        self._prediction.mean[chosen] = recording.mean
        self._prediction.root[chosen] = recording.factor
        self._prediction.noise[chosen] = 0.0
        self._status[chosen] = 0
        self._statistics[chosen] = 0.0
        self._statistics[chosen, :, : len(statistics.WINDOWS)] = 1.0

    def begin(self) -> None:
        """Of a decision."""
        self.gained[:] = self.arrived[:] = 0.0

    def correct(self, arrived: Measurement, status: Status) -> None:
        """The nominal filter takes in what the agents' filters do; idle where the status says."""
        if self._likelihood:
            work = self._work(status)
            result = self._filter.update(self._prediction, self._knobs, arrived, work)
            _take(work, (self._mean, self._factor, self._status), (*result[:2], work))

    def predict(self, inputs: Array, dt: Array, status: Status) -> None:
        """The nominal filter's time update."""
        if self._likelihood:
            work = self._work(status)
            result = self._filter.predict(self._mean, self._factor, inputs, dt, work)
            _take(work, (*self._prediction, self._status), (*result, work))

    def look(self, foreseen: Update, arrived: Measurement, dt: Array, status: Status) -> None:
        """Book innovations that were formed with the knobs held, against the nominal filter's."""
        if self._likelihood:
            work = self._work(status)
            rival = self._filter.innovate(self._prediction, self._knobs, arrived, work)
            _book(
                foreseen.log_likelihood, rival.log_likelihood, arrived.value, status, work,
                self.gained, self.arrived,
            )  # fmt: skip
        else:
            statistics.collect(
                foreseen.whitened, self._group, self._statistics, self._since, dt, status
            )

    def reward(self) -> Array:
        """What the decision earns (B,)."""
        earned = np.zeros(len(self._since))
        if self._likelihood:
            _mean_gain(self.gained, self.arrived, earned)
        else:
            _inconsistency(self._statistics, earned)
        return earned

    def _work(self, status: Status) -> Status:
        """The nominal filters' own failures, idle where the agents' are."""
        return np.where(status == 0, self._status, -1)


def _take(work: Status, kept: tuple[Array, ...], new: tuple[Array, ...]) -> None:
    """Keep what is new of the filters that were not idle."""
    for before, after in zip(kept, new, strict=True):
        before[work >= 0] = after[work >= 0]


@njit(**KERNEL)
def _book(foreseen, rival, value, status, rival_status, gained, arrived):
    """Add up log-likelihoods over the nominal filter's, of which a failed one has the least."""
    for b in range(value.shape[0]):
        if status[b] != 0:
            continue
        count = 0
        for c in range(value.shape[1]):
            count += not np.isnan(value[b, c])
        if count > 0:
            gained[b] += foreseen[b] - rival[b] if rival_status[b] == 0 else CAP * count
            arrived[b] += count


@njit(**KERNEL)
def _mean_gain(gained, arrived, reward):
    """Per channel that arrived, capped."""
    for b in range(reward.shape[0]):
        if arrived[b] > 0.0:
            reward[b] = max(-CAP, min(CAP, gained[b] / arrived[b]))


@njit(**KERNEL)
def _inconsistency(rows, reward):
    """Minus the mean over groups of log RMS and lag-1 correlation, in size, each capped."""
    longest = len(statistics.WINDOWS) - 1
    for b in range(reward.shape[0]):
        for g in range(rows.shape[1]):
            square = rows[b, g, longest] + 1e-4
            off = abs(0.5 * log(square)) + abs(rows[b, g, statistics.LAG]) / square
            reward[b] -= min(CAP, off) / rows.shape[1]
