"""The decision process of DESIGN section 5 for a batch of filters in lock-step.

The single and the vector environment are thin shells over `Core`, so both give the
same bits. The agent sees the innovation of the pending measurement before it decides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.addresses import Addresses
from kfenv.envs import rewards, scoring
from kfenv.envs.foresight import Foresight
from kfenv.envs.loop import Loop
from kfenv.envs.options import Options
from kfenv.envs.statistics import IDLE
from kfenv.filters.protocol import Measurement, elapsed
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Core(Loop):
    """B filters that replay B episodes, each at its own place in its episode.

    Args:
        scenario: gives motion, sensor and scales.
        options: of the environment.
        batch: B.
        times: (T,) of every episode, or of some (N, T), s, until one is loaded.
        has_truth: whether the episodes carry the truth.
    """

    def __init__(
        self, scenario: Any, options: Options, batch: int, times: Array, has_truth: bool
    ) -> None:
        super().__init__(scenario, options, batch)
        self.has_truth, steps = has_truth, np.shape(times)[-1]
        n, m = len(scenario.motion.states), len(scenario.sensor.channels)
        inputs = scenario.dimensions
        self._episode = {
            "measurement": np.full((batch, steps, m), np.nan),
            "noise": np.ones((batch, steps, m)),
            "motion_inputs": np.zeros((batch, steps, inputs[0])),
            "sensor_inputs": np.zeros((batch, steps, inputs[1])),
            "truth": np.zeros((batch, steps, n if has_truth else 0)),
            "scored": np.ones((batch, steps)),
        }
        self._nominal_error = np.zeros((batch, steps))
        self.time = np.tile(np.atleast_2d(times)[0], (batch, 1))
        self._dt = np.zeros((batch, steps))
        self._steps = steps
        # What the episodes hold at each filter's index
        self._arrived = Measurement(np.zeros((batch, inputs[1])), *np.zeros((2, batch, m)))
        self._motion_inputs = np.zeros((batch, inputs[0]))
        self._truth = np.zeros((batch, n if has_truth else 0))
        self._passed, self._held = np.zeros((2, batch))
        self._due, self._known = np.zeros((2, batch), bool)
        self.index = np.zeros(batch, np.int64)
        self._scored = np.zeros(batch, np.int64)
        self.lost = np.zeros(batch, bool)
        self.error, self.nees = np.full((2, batch), np.nan)
        self.total_squared_error, self.total_nees, self.total_scored = np.zeros((3, batch))
        self._to_score, self._cost = np.zeros((2, batch))
        # Of a decision: squared errors, nominal ones, their count; the last error that is known
        self._sums = tuple(np.zeros((3, batch)))
        self._known_error = np.zeros(batch)
        self._pends = np.zeros(batch, bool)
        self._note_addresses_of_episodes()
        self.foresight = None
        if options.reward in rewards.LABEL_FREE:
            self.foresight = Foresight(options.reward, self.filter, scenario.sensor, batch, n)

    def _note_addresses_of_episodes(self) -> None:
        """Of what kernels are handed at every instant."""
        squared, nominal, count = self._sums
        known, status, pends, episode = self._known, self.status, self._pends, self._episode
        series = ("measurement", "noise", "sensor_inputs", "motion_inputs")
        self._arriving = Addresses(
            self.index, *(episode[name] for name in series), self._dt, episode["truth"],
            episode["scored"], self._arrived.value, self._arrived.noise, self._arrived.inputs,
            self._motion_inputs, self._passed, self._due, self._truth, known, self._held,
        )  # fmt: skip
        self._counting = Addresses(
            known, self._lines, self._weight, self._statistics, status, self._work, self.error,
            self.nees, self._nominal_error, self.index, self._scored, self.lost, squared, nominal,
            self.total_nees, count, self._known_error,
        )  # fmt: skip
        self._closing = Addresses(
            self._known_error, squared, count, self.lost, self.index, status, pends, self.error,
            self.total_squared_error, self.total_scored,
        )  # fmt: skip

    # ----- episodes -----------------------------------------------------------------

    def load(self, chosen: NDArray[np.int64], recording: Recording) -> None:
        """Start new episodes at the chosen places, one per episode of the recording."""
        self.place(chosen, recording)
        self.open(chosen)

    def place(self, chosen: NDArray[np.int64], recording: Recording) -> None:
        """Put new episodes at the chosen places, still to be opened."""
        for name, array in self._episode.items():
            given = getattr(recording, name)
            array[chosen] = 1.0 if given is None else given  # `scored`, or a truth of no width
        self.time[chosen], self._dt[chosen] = recording.times, elapsed(recording)
        if self.options.reward == rewards.IMPROVEMENT and self.has_truth:
            self._nominal_error[chosen] = self._errors_of_nominal(recording)
        for begins_at_zero in (
            self.index, self._scored, self.lost, self.total_squared_error, self.total_nees,
            self.total_scored, self._cost,
        ):  # fmt: skip
            begins_at_zero[chosen] = 0
        self.error[chosen] = self.nees[chosen] = np.nan
        self.begin(chosen, recording.mean, recording.factor)
        if self.foresight is not None:
            self.foresight.restart(chosen, recording)
        self._to_score[chosen] = np.maximum(recording.scored_instants, 1.0)

    def open(self, chosen: NDArray[np.int64]) -> None:
        """Look at the first measurements of the episodes placed there."""
        mask = np.zeros(self.batch, bool)
        mask[chosen] = True
        self._arrive()
        self._score(mask)
        self.look(self._arrived, self._passed, mask)
        scoring.waiting(self.index, self._steps, self.lost, self.status, self._pends)

    def _errors_of_nominal(self, recording: Recording) -> Array:
        run = self.filter.run(recording)
        off = self.yardstick.off(run.mean, recording.truth)
        error = np.sqrt(sum(part**2 for part in np.moveaxis(off, -1, 0)))
        return np.where(error < self.scenario.lost_distance, error, self.scenario.lost_distance)

    # ----- one decision -------------------------------------------------------------

    def step(self, action: Array, running: Mask) -> tuple[Array, Mask, Mask]:
        """Apply an action (B, K) for one decision interval to the running filters.

        A lost track pays at once for all that remained. Where measurements are rarer than
        filter steps, fading acts at the instants of theirs.

        Returns:
            Reward, terminated and truncated, each (B,); zero and False where not running.
        """
        self.turn(action, running)
        active, begin = running.copy(), self.index.copy()
        if self.foresight is not None:
            self.foresight.begin()
        for instant in range(self.interval):
            self._correct(active)
            goes_on = self._take_stock(instant == 0, active)
            self._arrive()
            self.advance(self._motion_inputs, self._arrived, self._passed, active)
            self._foresee(active)
            if not goes_on:
                break
        lost, ended = np.empty(self.batch, bool), np.empty(self.batch, bool)
        scoring.close(self._closing.table, running, self._steps, lost, ended)
        reward = self._reward(begin)
        rewards.withhold(running, reward)
        return reward, lost, ended

    def _reward(self, begin: NDArray[np.int64]) -> Array:
        """A fresh (B,) array for the decision begun at these indices."""
        if self.options.reward == rewards.IMPROVEMENT:
            squared, nominal, count = self._sums
            count = np.maximum(count, 1.0)
            return self._paid_for_loss(self._improvement(squared / count, nominal / count), begin)
        if self.foresight is not None:
            return self._paid_for_loss(self.foresight.reward(), begin)
        return self._added_cost() if self.has_truth else self._price_of_failure()

    def _improvement(self, squared: Array, nominal: Array) -> Array:
        """Of a decision, from mean squared errors."""
        reward = np.zeros(self.batch)
        if self.has_truth:
            least = rewards.least_square(self.scenario.error_scale)
            rewards.improvement(nominal, squared, least, reward)
        return reward

    def _paid_for_loss(self, reward: Array, begin: NDArray[np.int64]) -> Array:
        """A dense reward of decisions begun at these indices; a loss pays for all to come."""
        remaining = -(-(self._steps - begin) // self.interval)
        return np.where(self.lost, -rewards.CAP * remaining, reward)

    def _added_cost(self) -> Array:
        """Of an episode whose return is its score."""
        return rewards.book(
            self.options.reward, self.total_squared_error, self.total_scored, self._to_score,
            self.lost, self.scenario.lost_distance, self.scenario.error_scale, self._cost,
        )  # fmt: skip

    def _price_of_failure(self) -> Array:
        """Where no truth tells of errors: the worst return's share of what remained."""
        worst = rewards.worst(
            self.options.reward, self.scenario.error_scale, self.scenario.lost_distance
        )
        return np.where(self.lost, -worst * (1.0 - self.index / self._steps), 0.0)

    def _arrive(self) -> None:
        """Take what the episodes hold at each filter's index."""
        scoring.arrive(self._arriving.table, self.scenario.steps_per_measurement)

    def _correct(self, active: Mask) -> None:
        if self.foresight is not None:
            self.foresight.correct(self._arrived, np.where(active, self.status, IDLE))
        self.correct(self._arrived, self._due, active)

    def _foresee(self, active: Mask) -> None:
        """Book the pending innovation as the decision's knobs, still held, foresee it."""
        if self.foresight is None:
            return
        work = np.where(active, self.status, IDLE)
        self.foresight.predict(self._motion_inputs, self._passed, work)
        foreseen = self.foresee(self._arrived, self._due, work)
        self.foresight.look(foreseen, self._arrived, self._passed, work)

    def _score(self, active: Mask) -> None:
        mean, rows, truth = self._assessed()
        scoring.assess(
            mean, rows, truth, self._known, self._lines, self._weight, self._statistics,
            self.scenario.lost_distance, active, self.status, self._work, self.error, self.nees,
        )  # fmt: skip

    def _take_stock(self, begins: bool, active: Mask) -> bool:
        """Score an instant and move on; whether one goes on, see `scoring.account`."""
        distance = self.scenario.lost_distance
        return scoring.take_stock(self._counting.table, *self._assessed(), active, distance, begins)

    def _assessed(self) -> tuple[Array, Array, Array]:
        """Mean, rows of the factor and truth that `scoring.assess` is told of."""
        mean, truth = self._update.mean, self._truth
        rows = self.yardstick.matrix(mean, self._update.factor)
        if self.has_truth:
            mean, truth = self.yardstick.vector(mean), self.yardstick.vector(truth)
        return mean, rows, truth

    # ----- what the agent sees ------------------------------------------------------

    def observation(self) -> NDArray[np.float32]:
        """A fresh (B, D) array; see `feature_names`."""
        return self.observe(self._arrived.noise, self._held, self._pends)

    def information(self) -> dict[str, Any]:
        """Fresh arrays (B, ...) for the info dictionary; nothing of them is in the observation."""
        time, truth = np.empty(self.batch), np.empty(self._truth.shape)
        scoring.recall(self._scored, self.time, self._episode["truth"], time, truth)
        info: dict[str, Any] = {
            "time": time,
            self.yardstick.error_name: self.error.copy(),
            **self.tell(self._arrived.noise, self._pends),
        }
        return info | {"nees": self.nees.copy(), "truth": truth} if self.has_truth else info

    def scored_covariance(self) -> Array:
        """A fresh (B, d, d): the posterior covariance of what is scored, e.g. the position, m^2."""
        rows = self.yardstick.rows(self._update.mean, self._update.factor)
        return rows @ rows.transpose(0, 2, 1)
