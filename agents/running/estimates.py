"""A whole log, or a simulated episode, through an agent's filter: what it says at each step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.knobs import choose_knobs
from kfenv.envs.options import Options, check_recording
from kfenv.filters.protocol import Filter, Knobs, Measurement, Status
from kfenv.filters.results import FAILURES, OK, Update
from kfenv.names import unknown
from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.recording import Whole

from ..contest.rollout import draw_episodes, scenario_and_options, without_truth
from ..contestants.agent import Agent, Briefing, Contestant, RecordingFilter
from ..contestants.registry import make_agent

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimates:
    """What a filter said at K instants of one episode, until its end or the filter's.

    Attributes:
        scenario: motion, sensor, frames.
        whole: what was filtered, of T instants.
        mean: (K, n) of the states.
        covariance: (K, n, n).
        nis: (K,) NaN where nothing arrived.
        knobs: names of the F knobs that were turned; none of a filter that turns none.
        factors: (K, F) of these.
        ended: why there are fewer than T, in a sentence; None if there are not.
    """

    scenario: Any
    whole: Whole
    mean: Array
    covariance: Array
    nis: Array
    knobs: tuple[str, ...]
    factors: Array
    ended: str | None

    @property
    def time(self) -> Array:
        """(K,) by the log's clock, s."""
        return _clock(self.whole)[: len(self.mean)]

    @property
    def channels(self) -> NDArray[np.int64]:
        """How many channels arrived (K,)."""
        return (~np.isnan(self.whole.recording.measurement[0])).sum(axis=1)[: len(self.mean)]

    @property
    def position(self) -> Array:
        """(K, 3) in the state's frame."""
        return self.mean[:, list(self.scenario.motion.position)]

    @property
    def truth(self) -> Array | None:
        """True positions (K, 3) in the state's frame, NaN where they are not known."""
        recording = self.whole.recording
        if recording.truth is None:
            return None
        truth = recording.truth[0][: len(self.mean), list(self.scenario.motion.position)].copy()
        if recording.scored is not None:
            truth[recording.scored[0, : len(self.mean)] == 0.0] = np.nan
        return truth

    def summary(self) -> dict[str, Any]:
        """What it amounts to: how long and consistent, and how far off where that is known."""
        arrived = self.channels > 0
        nis = self.nis[arrived].sum() / max(1, self.channels[arrived].sum())
        truth = self.truth
        squared = np.full(1, np.nan)
        if truth is not None:
            squared = np.sum((self.position - truth) ** 2, axis=1)
        known = np.isfinite(squared)
        return {
            "begin": float(self.time[0]),
            "seconds": float(np.ptp(self.time)),
            "instants": len(self.mean),
            "measurements": int(arrived.sum()),
            "nis": float(nis),
            "rmse": float(np.sqrt(squared[known].mean())) if known.any() else None,
            "ended": self.ended,
        }

    def local(self, position: Array) -> Array:
        """Positions (k, 3) of the state's frame as east, north and up of where it begins."""
        start = self.whole.recording.mean[0][list(self.scenario.motion.position)]
        origin, rotation = self.scenario.local_frame(start)
        return (position - origin) @ rotation.T

    @property
    def measured(self) -> Array | None:
        """(T, 3) positions that were measured, east, north and up; None if no sensor does."""
        if self.whole.fixes is not None:
            return self.local(self.whole.fixes)
        return measured_positions(self.scenario.sensor, self.whole.recording.measurement[0])

    @property
    def spread(self) -> Array:
        """Covariances (K, 3, 3) of the position, east, north and up."""
        place = list(self.scenario.motion.position)
        _, rotation = self.scenario.local_frame(self.whole.recording.mean[0][place])
        return rotation @ self.covariance[:, place][:, :, place] @ rotation.T


def filtered(
    env_id: str, env_kwargs: dict[str, Any], name: str, values: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Estimates:  # fmt: skip
    """Filter an environment's whole log, or else the first episode that a contest tests on.

    Args:
        env_id, env_kwargs: the environment.
        name: of the agent, see `kfenv.agents.contestants.registry.make_agent`.
        values: parameters of the agent that differ from its defaults.
        seed: of the episode, and of an agent that draws.

    Raises:
        ValueError: if the agent does not suit the environment, has no such parameter, or would
            have to be shown what a log does not tell.
    """
    scenario, options = scenario_and_options(env_id, env_kwargs)
    whole = scenario.whole()
    if whole is None:
        drawn = draw_episodes(env_id, env_kwargs, "test", seed, 1)
        whole = Whole(drawn, float(drawn.times[0, 0]))
    recording = whole.recording
    check_recording(recording, scenario)
    agent = _with_values(make_agent(name).suited_to(scenario), scenario, options, values or {})
    agent.check(scenario, options, recording)
    if isinstance(agent, RecordingFilter):
        return _by_itself(agent, scenario, options, whole)
    if agent.clairvoyant and recording.true_noise is None:
        raise ValueError(
            f"The agent {agent.name!r} is shown what nobody knows of a real log: name another."
        )
    return _decided(agent, scenario, options, whole, seed)


def _with_values(
    agent: Contestant, scenario: Any, options: Options, values: Mapping[str, float]
) -> Contestant:
    """The agent with other parameters, of which it must have those."""
    groups = scenario.motion.groups
    knobs = choose_knobs(None, scenario.sensor.groups, options.mixture, state_groups=groups)
    known = [parameter.name for parameter in agent.tunable(scenario, knobs)]
    for name in values:
        if name not in known:
            raise ValueError(unknown(f"parameter of {agent.name}", name, known or ["none"]))
    return agent.with_values({**agent.values, **values}) if values else agent


class Tape:
    """A filter that keeps what its updates said, until one failed.

    Args:
        filter: the one that works, on one episode.
    """

    def __init__(self, filter: Filter) -> None:
        self.filter = filter
        self.predict, self.innovate, self.run = filter.predict, filter.innovate, filter.run
        self.updates: list[tuple[Array, Array, float]] = []

    def update(
        self, prediction: Any, knobs: Knobs, measurement: Measurement, status: Status, *more: Any
    ) -> Update:
        """As the filter's, and kept."""
        told = self.filter.update(prediction, knobs, measurement, status, *more)
        if status[0] == OK:
            self.updates.append((told.mean[0].copy(), told.factor[0].copy(), float(told.nis[0])))
        return told


def _decided(agent: Agent, scenario: Any, options: Options, whole: Whole, seed: int) -> Estimates:
    """An action from the agent per decision."""
    recording = whole.recording
    options = replace(options, recording=recording, reward="rmse", **agent.own_options)
    core = Core(scenario, options, 1, recording.time, has_truth=recording.truth is not None)
    core.filter = tape = Tape(core.filter)
    core.load(np.zeros(1, np.int64), recording)
    shown = recording if agent.clairvoyant else None
    agent.reset(Briefing(core.knobs, scenario, 1, seed, shown, core.interval))
    running, factors = np.ones(1, bool), []
    while running.any():
        action = np.clip(agent.act(core.observation(), without_truth(core)), -1.0, 1.0)
        _, lost, over = core.step(action, running)
        factors += [core.factors[0, core.knob_place]] * (len(tape.updates) - len(factors))
        running &= ~(lost | over)
    n = recording.mean.shape[1]
    means, roots = (
        np.array([update[part] for update in tape.updates]).reshape(-1, *shape)
        for part, shape in ((0, (n,)), (1, (n, n)))
    )
    nis, ended = np.array([update[2] for update in tape.updates]), None
    if core.lost[0]:
        ended = _reason(int(core.status[0]), scenario, _clock(whole)[max(len(means) - 1, 0)])
    knobs = tuple(knob.name for knob in core.knobs)
    turned = np.array(factors).reshape(-1, len(knobs))
    covariance = roots @ roots.swapaxes(1, 2)
    return Estimates(scenario, whole, means, covariance, nis, knobs, turned, ended)


def _clock(whole: Whole) -> Array:
    """All instants (T,) by the log's clock, s."""
    times = whole.recording.times[0]
    return whole.begin + (times - times[0])


def _reason(status: int, scenario: Any, time: float) -> str:
    if status != OK:
        return f"The filter failed after t = {time:.10g} s: {FAILURES[status]}."
    return (
        f"The track was lost at t = {time:.10g} s: its error passed {scenario.lost_distance:g} m, "
        "or what the filter says of it did, or innovations are a hundred times what it expects."
    )


def _by_itself(agent: RecordingFilter, scenario: Any, options: Options, whole: Whole) -> Estimates:
    """A filter that needs no decisions, until it fails or its error is that of a lost track."""
    told = replace(whole.recording, truth=None, true_noise=None, true_bias=None, faults=())
    history = agent.filter(scenario, options, told)
    kept, status = told.time.shape[-1], int(history.status[0])
    kept = kept if status == OK else int(history.failed_at[0])
    run = Estimates(
        scenario, whole, history.mean[0, :kept], history.covariance[0, :kept],
        history.nis[0, :kept], (), np.empty((kept, 0)), None,
    )  # fmt: skip
    away = np.zeros(kept) if run.truth is None else np.linalg.norm(run.position - run.truth, axis=1)
    lost = np.flatnonzero(away > scenario.lost_distance)
    if len(lost):
        kept, status = int(lost[0]) + 1, OK
    elif status == OK:
        return run
    ended = _reason(status, scenario, _clock(whole)[max(kept - 1, 0)])
    return replace(
        run, mean=run.mean[:kept], covariance=run.covariance[:kept], nis=run.nis[:kept],
        factors=run.factors[:kept], ended=ended,
    )  # fmt: skip


def rows_due(run: Estimates) -> NDArray[np.int64]:
    """The instants (k,) at which a measurement is due, whether it arrived or not."""
    return np.arange(0, len(run.mean), run.scenario.steps_per_measurement)
