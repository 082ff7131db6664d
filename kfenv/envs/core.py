"""The decision process of DESIGN section 5 for a batch of filters in lock-step.

The single and the vector environment are thin shells over `Core`, so both give the
same bits. The agent sees the innovation of the pending measurement before it decides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs import rewards, statistics
from kfenv.envs.channels import Channels
from kfenv.envs.knobs import choose_knobs, knobs_of, knobs_of_channels
from kfenv.envs.memory import Memory
from kfenv.envs.options import ENGINE, FULL, GAUSSIAN_SUMS, Options
from kfenv.envs.state_knobs import places_of_states, turn_states
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Filter, Knobs, Measurement
from kfenv.filters.results import Prediction, Update
from kfenv.models.model import Sensor
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

IDLE = -1


class Core:
    """B filters that replay B episodes, each at its own place in its episode.

    Args:
        scenario: gives motion, sensor and scales.
        options: of the environment.
        batch: B.
        times: (T,) the instants of every episode, s.
        has_truth: whether the episodes carry the truth.
    """

    def __init__(
        self, scenario: Any, options: Options, batch: int, times: Array, has_truth: bool
    ) -> None:
        self.scenario, self.options, self.batch = scenario, options, batch
        self.time, self.has_truth = times, has_truth
        motion, sensor = scenario.motion, scenario.sensor
        self.filter = make_filter(scenario, options)
        self._position = np.array(motion.position)
        self._velocity = np.array(motion.velocity)
        self._group = np.array(sensor.group_of_channel)
        self.interval = options.decision_interval or scenario.steps_per_measurement
        self._prepare_knobs(sensor)
        n, m, steps = len(motion.states), len(sensor.channels), len(times)
        inputs = scenario.dimensions
        self._episode = {
            "measurement": np.full((batch, steps, m), np.nan),
            "noise": np.ones((batch, steps, m)),
            "motion_inputs": np.zeros((batch, steps, inputs[0])),
            "sensor_inputs": np.zeros((batch, steps, inputs[1])),
        }
        if has_truth:
            self._episode["truth"] = np.zeros((batch, steps, n))
            self._episode["scored"] = np.ones((batch, steps))
        self._nominal_error = np.zeros((batch, steps))
        self._dt = np.diff(times, prepend=times[0])
        self._prediction = Prediction(np.zeros((batch, n)), *np.zeros((2, batch, n, n)))
        self._pending = _empty_update(batch, n, m)
        self._update = _empty_update(batch, n, m)
        self._nominal = Knobs.nominal(batch)
        self._rows, self._last = np.arange(batch), steps - 1
        self.index = np.zeros(batch, np.int64)
        self._scored = np.zeros(batch, np.int64)
        self.lost = np.zeros(batch, bool)
        self.status = np.zeros(batch, np.int64)
        self.error, self.nees = np.full((2, batch), np.nan)
        self.total_squared_error, self.total_nees, self.total_scored = np.zeros((3, batch))
        self._to_score, self._cost = np.zeros((2, batch))
        self._statistics = np.zeros((batch, len(sensor.groups), statistics.COLUMNS))
        self._since = np.zeros(batch)
        self._action = np.zeros((batch, len(self.knobs)))
        self.factors = np.ones((batch, len(self._all_knobs)))
        self.observation_size = len(self.feature_names())

    def _prepare_knobs(self, sensor: Sensor) -> None:
        options, names = self.options, [channel.name for channel in sensor.channels]
        motion = self.scenario.motion
        shared = knobs_of(sensor.groups, options.mixture, options.most_fading, motion.groups)
        self._state_knobs = places_of_states(motion, sensor.groups)
        self._outlier_knob, self._channel_knobs = len(shared) - 1, slice(len(shared), None)
        self._all_knobs = (*shared, *knobs_of_channels(names))
        self.knobs = choose_knobs(
            options.actions, sensor.groups, options.mixture, names, options.most_fading,
            motion.groups,
        )  # fmt: skip
        self.knob_place = np.array([self._all_knobs.index(knob) for knob in self.knobs])
        self._log_low = np.log([knob.low for knob in self.knobs])
        self._log_high = np.log([knob.high for knob in self.knobs])
        single = self.knob_place[self.knob_place >= len(shared)] - len(shared)
        self._channels = self._memory = None
        if len(single):
            self._channels = Channels(self.scenario, single, self.batch, options.kappa)
        if options.observation == FULL:
            held = self.interval * np.diff(self.time, prepend=2.0 * self.time[0] - self.time[1])
            self._memory = Memory(self.scenario, single, held, self.batch)

    # ----- episodes -----------------------------------------------------------------

    def load(self, chosen: NDArray[np.int64], recording: Recording) -> None:
        """Start new episodes at the chosen places, one per episode of the recording."""
        for name, array in self._episode.items():
            given = getattr(recording, name)
            array[chosen] = 1.0 if given is None else given  # only `scored` may be left out
        if self.options.reward == rewards.IMPROVEMENT and self.has_truth:
            self._nominal_error[chosen] = self._errors_of_nominal(recording)
        for begins_at_zero in (
            self.index, self._scored, self.lost, self.status, self._statistics, self._since,
            self._action, self.total_squared_error, self.total_nees, self.total_scored, self._cost,
        ):  # fmt: skip
            begins_at_zero[chosen] = 0
        self.error[chosen] = self.nees[chosen] = np.nan
        self._prediction.mean[chosen] = recording.mean
        self._prediction.root[chosen] = recording.factor
        self._prediction.noise[chosen] = 0.0
        self._update.mean[chosen] = recording.mean
        self._update.factor[chosen] = recording.factor
        self._update.nis[chosen] = np.nan
        self._statistics[chosen, :, : len(statistics.WINDOWS)] = 1.0
        if self._channels is not None:
            self._channels.restart(chosen)
        if self._memory is not None:
            self._memory.restart(chosen, recording.mean)
        self.factors[chosen] = 1.0
        self._to_score[chosen] = np.maximum(recording.scored_instants, 1.0)
        mask = np.zeros(self.batch, bool)
        mask[chosen] = True
        self._score(mask)
        self._look(mask)

    def _errors_of_nominal(self, recording: Recording) -> Array:
        run = self.filter.run(recording)
        off = (run.mean - recording.truth)[..., self._position]
        error = np.sqrt(off[..., 0] ** 2 + off[..., 1] ** 2 + off[..., 2] ** 2)
        return np.where(error < self.scenario.lost_distance, error, self.scenario.lost_distance)

    # ----- one decision -------------------------------------------------------------

    def step(self, action: Array, running: Mask) -> tuple[Array, Mask, Mask]:
        """Apply an action (B, K) for one decision interval to the running filters.

        A lost track pays at once for all that remained. Where measurements are rarer than
        filter steps, fading acts at the instants of theirs.

        Returns:
            Reward, terminated and truncated, each (B,); zero and False where not running.
        """
        statistics.turn_knobs(action, self._log_low, self._log_high, self.knob_place, self.factors)
        self._action[running] = action[running]
        squared, nominal, count = np.zeros((3, self.batch))
        active, begin = running.copy(), self.index.copy()
        known_error = np.full(self.batch, np.nan)  # the latest of this decision
        for _ in range(self.interval):
            self._correct(active)
            self._score(active)
            np.copyto(known_error, self.error, where=active & ~np.isnan(self.error))
            statistics.account(
                self.error, self.nees, self.status, self._nominal_error,
                self.scenario.lost_distance, self.index, active, self.lost,
                squared, nominal, self.total_nees, count,
            )  # fmt: skip
            self._predict(active)
            self._look(active)
            if not active.any():
                break
        np.copyto(self.error, known_error, where=running)
        self.total_squared_error += squared
        self.total_scored += count
        lost = running & self.lost
        ended = running & ~lost & (self.index >= len(self.time))
        if self.options.reward == rewards.IMPROVEMENT:
            count = np.maximum(count, 1.0)
            reward = self._improvement(squared / count, nominal / count, begin)
        elif self.has_truth:
            reward = self._added_cost()
        else:
            reward = self._price_of_failure()
        return np.where(running, reward, 0.0), lost, ended

    def _improvement(self, squared: Array, nominal: Array, begin: NDArray[np.int64]) -> Array:
        """Of a decision begun at these indices, from mean squared errors."""
        reward = np.zeros(self.batch)
        if self.has_truth:
            rewards.improvement(nominal, squared, reward)
        remaining = -(-(len(self.time) - begin) // self.interval)
        return np.where(self.lost, -rewards.IMPROVEMENT_CAP * remaining, reward)

    def _added_cost(self) -> Array:
        """Of an episode whose return is its score."""
        scale = self.scenario.error_scale
        mean_square = rewards.mean_square(
            self.total_squared_error, self.total_scored, self._to_score, self.lost,
            self.scenario.lost_distance, supposed=scale,
        )  # fmt: skip
        to_come = np.where(self.lost, 0.0, 1.0 - self.total_scored / self._to_score)
        return rewards.book(self.options.reward, mean_square, to_come, scale, self._cost)

    def _price_of_failure(self) -> Array:
        """Where no truth tells of errors: the worst return's share of what remained."""
        worst = rewards.worst(
            self.options.reward, self.scenario.error_scale, self.scenario.lost_distance
        )
        return np.where(self.lost, -worst * (1.0 - self.index / len(self.time)), 0.0)

    def _gather(self, name: str) -> Array:
        """What an episode holds at each filter's instant, or at the last one beyond it."""
        return self._episode[name][self._rows, self._instant]

    def _measurement(self) -> Measurement:
        """What arrives at each filter's instant."""
        episode, here = self._episode, (self._rows, self._instant)
        return Measurement(
            episode["sensor_inputs"][here], episode["measurement"][here], episode["noise"][here]
        )

    @property
    def _instant(self) -> NDArray[np.int64]:
        return np.minimum(self.index, self._last)

    def _correct(self, active: Mask) -> None:
        arrived = self._measurement()
        noise = arrived.noise * self.factors[:, 2 + self._group]
        told = arrived._replace(noise=noise * self.factors[:, self._channel_knobs])
        work = np.where(active, self.status, IDLE)
        due = self.index % self.scenario.steps_per_measurement == 0
        knobs = Knobs(np.where(due, self.factors[:, 0], 1.0), self.factors[:, 1].copy())
        outlier_odds = (self.factors[:, self._outlier_knob].copy(),) if self.options.mixture else ()
        prediction = turn_states(self._prediction, self.factors, self._state_knobs)
        result = self.filter.update(prediction, knobs, told, work, *outlier_odds)
        self._update = _merge(self._update, result, active)
        np.copyto(self._scored, self.index, where=active)
        np.copyto(self.status, work, where=active)
        failed = active & (work != 0)
        if failed.any():  # its outputs are meaningless
            self._update.mean[failed] = np.nan
            self._update.nis[failed] = np.nan

    def _predict(self, active: Mask) -> None:
        work = np.where(active, self.status, IDLE)
        dt = self._dt[self._instant]
        result = self.filter.predict(
            self._update.mean, self._update.factor, self._gather("motion_inputs"), dt, work
        )
        self._prediction = _merge(self._prediction, result, active)
        np.copyto(self.status, work, where=active)

    def _look(self, active: Mask) -> None:
        """Form the pending innovation with nominal knobs and take it into the statistics."""
        work = np.where(active, self.status, IDLE)
        arrived = self._measurement()
        result = self.filter.innovate(self._prediction, self._nominal, arrived, work)
        self._pending = _merge(self._pending, result, active)
        np.copyto(self.status, work, where=active)
        dt = self._dt[self._instant]
        statistics.collect(
            self._pending.whitened, self._group, self._statistics, self._since, dt, work
        )
        if self._channels is not None:
            self._channels.collect(self._pending, arrived, work == 0)
        if self._memory is not None:
            self._memory.collect(self._pending, arrived, dt, work == 0)

    def _score(self, active: Mask) -> None:
        if self.has_truth:
            work = np.where(active, self.status, IDLE)
            statistics.score(
                self._update.mean, self._update.factor, self._gather("truth"), self._position,
                work, self.error, self.nees,
            )  # fmt: skip
            unknown = active & (self._gather("scored") == 0.0)
            self.error[unknown] = self.nees[unknown] = np.nan
        statistics.note_runaways(
            self._statistics, self._update.factor, self._position, self.scenario.lost_distance,
            active, self.error,
        )  # fmt: skip
        failed = active & (self.status != 0)
        if failed.any():
            self.error[failed] = self.scenario.lost_distance
            self.nees[failed] = np.nan

    # ----- what the agent sees ------------------------------------------------------

    def observation(self) -> NDArray[np.float32]:
        """A fresh (B, D) array; see `feature_names`."""
        out, pends = np.zeros((self.batch, self.observation_size)), self._pends
        statistics.observe(
            self._pending.whitened, self._pending.variance, self._gather("noise"),
            self._pending.factor, self._position, self._velocity, self.scenario.error_scale,
            self._group, self._statistics, self._since, pends, out,
        )  # fmt: skip
        rest = out[:, self._statistics.shape[1] * statistics.PER_GROUP + statistics.COMMON :]
        if self._channels is not None:
            told = self._channels.observe(pends)
            rest[:, : told.shape[1]] = told
            rest = rest[:, told.shape[1] :]
        if self._memory is not None:
            self._memory.observe(self._pending.mean, self._instant, pends, rest)
        out[:, -len(self.knobs) :] = self._action
        out[self.status != 0] = 0.0
        return out.astype(np.float32)

    def information(self) -> dict[str, Any]:
        """Fresh arrays (B, ...) for the info dictionary; nothing of them is in the observation."""
        pends = self._pends[:, None]
        info: dict[str, Any] = {
            "time": self.time[self._scored],
            "estimate": self._update.mean.copy(),
            "position_error": self.error.copy(),
            "nis": self._update.nis.copy(),
            "innovation": np.where(pends, self._pending.innovation, np.nan),
            "innovation_variance": np.where(pends, self._pending.variance, np.nan),
            "noise": self._gather("noise"),
        }
        if self._channels is not None:
            info["innovation_covariance"] = pends[..., None] * self._channels.covariance
        if self.has_truth:
            info["nees"] = self.nees.copy()
            info["truth"] = self._episode["truth"][self._rows, self._scored]
        return info

    @property
    def _pends(self) -> Mask:
        """Whether a measurement waits for its update; not where the episode is over."""
        return (self.index < len(self.time)) & ~self.lost & (self.status == 0)

    def position_covariance(self) -> Array:
        """A fresh (B, 3, 3): the posterior covariance of the position, m^2."""
        rows = self._update.factor[:, self._position]
        return rows @ rows.transpose(0, 2, 1)

    def feature_names(self) -> tuple[str, ...]:
        """What each component of the observation is."""
        names = [*statistics.feature_names(self.scenario.sensor.groups)]
        for part in (self._channels, self._memory):
            names.extend(part.feature_names() if part is not None else ())
        names.extend(f"previous action: {knob.name}" for knob in self.knobs)
        return tuple(names)


def make_filter(scenario: Any, options: Options) -> Filter:
    """The engine, a Gaussian sum, or a square-root filter of the reference tier by name.

    Raises:
        ValueError: for an unknown name or one without a square-root factor.
    """
    motion, sensor = scenario.motion, scenario.sensor
    if options.filter == ENGINE:
        return Engine(motion, sensor, options.kappa)
    from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, build_tier, told_design
    from kfenv.filters.designs import DESIGNS, find_design
    from kfenv.filters.reference import ReferenceFilter

    if options.mixture:
        design = told_design(options.filter, scenario.mixture)
        return build_tier(motion, sensor, design, compiled=True)
    if options.filter in ADAPTIVE_DESIGNS and ADAPTIVE_DESIGNS[options.filter].fading:
        raise ValueError(
            f"The filter {options.filter!r} fades by itself, and here fading is a knob: choose "
            f"one of {', '.join(GAUSSIAN_SUMS)} and let an agent turn it."
        )
    if options.filter in ADAPTIVE_DESIGNS:
        raise ValueError(
            f"The filter {options.filter!r} is a contestant of its own: name it as an agent of "
            "`kfenv evaluate`, or take 'srckf-joseph-exact', whose knobs can be turned."
        )
    if find_design(options.filter).form != "square-root":
        known = [name for name, design in DESIGNS.items() if design.form == "square-root"]
        raise ValueError(
            f"The filter {options.filter!r} carries a covariance, and the knobs need a "
            f"factor: choose one of {', '.join(known)}."
        )
    return ReferenceFilter(motion, sensor, options.filter, kappa=options.kappa)


def _empty_update(batch: int, n: int, m: int) -> Update:
    return Update(
        np.zeros((batch, n)), np.zeros((batch, n, n)), *np.full((3, batch, m), np.nan),
        np.full(batch, np.nan), np.zeros(batch),
    )  # fmt: skip


def _merge(old, new, active: Mask):
    """The new results where active, the old ones elsewhere."""
    if active.all():
        return new
    for before, after in zip(old, new, strict=True):
        before[active] = after[active]
    return old
