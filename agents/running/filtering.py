"""A whole log, or a simulated episode, through an agent's filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.knobs import choose_knobs
from kfenv.envs.options import Options, check_recording
from kfenv.filters.protocol import Filter, Knobs, Measurement, Status
from kfenv.filters.results import FAILURES, OK, Update
from kfenv.names import unknown
from kfenv.scenarios.recording import Whole

from ..contest.rollout import draw_episodes, scenario_and_options, without_truth
from ..contestants.agent import Agent, Briefing, Contestant, RecordingFilter
from ..contestants.registry import make_agent
from .estimates import Estimates, estimates, joined

Array = NDArray[np.float64]

MOST_BEGINS = 100


def filtered(
    env_id: str, env_kwargs: dict[str, Any], name: str, values: Mapping[str, float] | None = None,
    seed: int = 0,
) -> Estimates:  # fmt: skip
    """Filter an environment's whole log, or else the first episode that a contest tests on.

    A filter that fails or loses its target on a log, in a long gap for one, begins anew where
    it can.

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
    check_recording(whole.recording, scenario)
    agent = _with_values(make_agent(name).suited_to(scenario), scenario, options, values or {})
    agent.check(scenario, options, whole.recording)
    clairvoyant = isinstance(agent, Agent) and agent.clairvoyant
    if clairvoyant and (whole.recording.true_noise is None or whole.recording.truth is None):
        raise ValueError(
            f"The agent {agent.name!r} is shown what nobody knows of a real log: name another."
        )
    origin = scenario.yardstick.values(whole.recording.mean[0])
    runs: list[Estimates] = []
    while whole is not None and len(runs) < MOST_BEGINS:
        runs.append(_run(agent, scenario, options, whole, origin, seed))
        whole = scenario.whole(_end(runs[-1], whole)) if runs[-1].ended else None
    return joined(runs)


def _run(
    agent: Contestant, scenario: Any, options: Options, whole: Whole, origin: Array, seed: int
) -> Estimates:
    if isinstance(agent, RecordingFilter):
        return _by_itself(agent, scenario, options, whole, origin)
    return _decided(agent, scenario, options, whole, origin, seed)


def _end(run: Estimates, whole: Whole) -> float:
    return float(run.time[-1]) if len(run.time) else whole.begin


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

    def arrays(self, n: int) -> tuple[Array, Array, Array]:
        """Means (K, n), covariances (K, n, n) and NIS (K,)."""
        means, roots = (
            np.array([update[part] for update in self.updates]).reshape(-1, *shape)
            for part, shape in ((0, (n,)), (1, (n, n)))
        )
        nis = np.array([update[2] for update in self.updates])
        return means, roots @ roots.swapaxes(1, 2), nis


def _decided(
    agent: Agent, scenario: Any, options: Options, whole: Whole, origin: Array, seed: int
) -> Estimates:
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
    knobs = tuple(knob.name for knob in core.knobs)
    turned = np.array(factors).reshape(-1, len(knobs))
    said = tape.arrays(recording.mean.shape[1])
    run = estimates(scenario, whole, origin, *said, knobs, turned)
    if not core.lost[0]:
        return run
    return replace(run, ended=(_reason(int(core.status[0]), scenario, _end(run, whole)),))


def _by_itself(
    agent: RecordingFilter, scenario: Any, options: Options, whole: Whole, origin: Array
) -> Estimates:
    """A filter that needs no decisions, until it fails or its error is that of a lost track."""
    told = replace(whole.recording, truth=None, true_noise=None, true_bias=None, faults=())
    history = agent.filter(scenario, options, told)
    status, count = int(history.status[0]), told.time.shape[-1]
    count = count if status == OK else int(history.failed_at[0])
    run = estimates(
        scenario, whole, origin, history.mean[0, :count], history.covariance[0, :count],
        history.nis[0, :count], (), np.empty((count, 0)),
    )  # fmt: skip
    away = run.error
    if run.has_position:
        deviation = np.sqrt(np.trace(run.spread, axis1=1, axis2=2))
        away = np.where(np.isnan(away), deviation, away)
    lost = np.flatnonzero(away > scenario.lost_distance)
    if len(lost):
        return _until(run, int(lost[0]) + 1, _reason(OK, scenario, run.time[lost[0]]))
    if status == OK:
        return run
    return replace(run, ended=(_reason(status, scenario, _end(run, whole)),))


def _until(run: Estimates, count: int, ended: str) -> Estimates:
    arrays = {
        name: value[:count]
        for name, value in vars(run).items()
        if isinstance(value, np.ndarray) and name != "origin"
    }
    return replace(run, **arrays, ended=(ended,))


def _reason(status: int, scenario: Any, time: float) -> str:
    if status != OK:
        return f"The filter failed after t = {time:.10g} s: {FAILURES[status]}."
    return (
        f"The track was lost at t = {time:.10g} s: its error, or the deviation that the filter "
        f"tells, passed {scenario.lost_distance:g} {scenario.yardstick.unit}, or innovations were "
        "a hundred times as large as it expects."
    )
