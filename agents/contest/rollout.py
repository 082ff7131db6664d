"""Contestants on recordings: everything scored by one rule, everyone on the same noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import NDArray

from kfenv.envs import rewards, scoring
from kfenv.envs.core import Core
from kfenv.envs.knobs import knobs_of
from kfenv.envs.options import Options, check_recording, split_keywords
from kfenv.envs.statistics import IDLE
from kfenv.filters.matrices import cholesky, symmetric
from kfenv.filters.results import History
from kfenv.models.yardstick import Yardstick, lines_of
from kfenv.scenarios.recording import Recording

from ..contestants.agent import Agent, Briefing, Contestant, RecordingFilter
from .scores import Scores
from .watch import Stopwatch, WatchedFilter

Array = NDArray[np.float64]

# Streams of random numbers that never meet: training draws from plain seeds, the
# others from children of the seed's sequence under a key of their own.
SPLITS = {"tuning": 1, "validation": 2, "test": 3}

HISTORY_SIZE = 10_000_000  # numbers in the covariances that are held at once: 80 MB


def episode_rngs(split: str, seed: int, episodes: int, begin: int = 0) -> list[Generator]:
    """A generator of its own for each episode of a split, from `begin` on."""
    key = SPLITS[split]
    return [default_rng(SeedSequence(seed, spawn_key=(key, i))) for i in range(begin, episodes)]


def scenario_and_options(env_id: str, env_kwargs: dict[str, Any]) -> tuple[Any, Options]:
    """The scenario and options that ``gym.make(env_id, **env_kwargs)`` would work with."""
    creator = load_env_creator(find_spec(env_id).entry_point)
    if not hasattr(creator, "scenario_class"):
        raise ValueError(f"{env_id} is no environment of kfenv: `kfenv envs` lists them.")
    return split_keywords(creator.scenario_class, env_kwargs)


def find_spec(env_id: str) -> EnvSpec:
    """What Gymnasium knows of an id, which may begin with the module that registers it.

    Raises:
        ValueError: if there is no such environment.
    """
    module, _, name = env_id.rpartition(":")
    try:
        if module:
            import_module(module)
        return gym.spec(name)
    except (gym.error.Error, ModuleNotFoundError) as error:
        raise ValueError(f"Unknown environment {env_id!r}: {error}") from None


def draw_episodes(
    env_id: str,
    env_kwargs: dict[str, Any],
    split: str,
    seed: int,
    episodes: int,
    block: tuple[int, int] | None = None,
) -> Recording:
    """The episodes of a split: of a real log at most as many as that part of it has.

    Args:
        block: begin and end of those that are wanted; None for all.
    """
    scenario, _ = scenario_and_options(env_id, env_kwargs)
    recorded = scenario.recorded(split, episodes)
    begin, end = block or (0, episodes)
    if recorded is not None:
        return recorded[begin:end]
    return scenario.sample(episode_rngs(split, seed, end, begin))


def rollout(
    contestant: Contestant,
    env_id: str,
    env_kwargs: dict[str, Any],
    recording: Recording,
    seed: int = 0,
    trace: bool = False,
    block: tuple[int, int] | None = None,
) -> Scores:
    """Run a contestant over every episode of a recording.

    Args:
        block: if they are a part of a contest's episodes, which of them is the first and how many
            there are in all: what an agent draws then is the same however they are parted.

    Raises:
        ValueError: if an episode has no truth to score against.
    """
    check_scored(recording)
    scenario, options = scenario_and_options(env_id, env_kwargs)
    contestant = contestant.suited_to(scenario)
    if isinstance(contestant, RecordingFilter):
        return _filter(contestant, scenario, options, recording, trace)
    return _decide(contestant, scenario, options, recording, seed, trace, block or (0, None))


def check_scored(recording: Recording) -> None:
    """Complain if an episode has no instant at which its error is known.

    Raises:
        ValueError: saying how many have none, and what would give them one.
    """
    scored = np.zeros(len(recording)) if recording.truth is None else recording.scored_instants
    if not scored.all():
        raise ValueError(
            f"{int(np.sum(scored == 0.0))} of {len(recording)} episodes have no truth, so no "
            "error can be scored: give a truth (with a log of two files a third), or let the "
            "filter miss fixes to be scored at (faults='outages', longer outages)."
        )


def _decide(
    agent: Agent, scenario: Any, options: Options, recording: Recording, seed: int, trace: bool,
    block: tuple[int, int | None],
) -> Scores:  # fmt: skip
    """All episodes in lock-step, an action from the agent per decision."""
    core = make_core(agent, scenario, options, recording, "rmse")
    watched = WatchedFilter(core.filter, scenario.sensor, core.batch, agent.sees != "nothing")
    core.filter, watch = watched, watched.watch
    lost = np.zeros(core.batch, bool)
    times, errors, factors, offs = [], [], [], []
    for _, gone in play(agent, core, recording, seed, watch, block):
        lost |= gone
        if trace:
            times.append(recording.times[0, min(core.index.max(), recording.time.shape[-1]) - 1])
            errors.append(core.error.copy())
            factors.append(core.factors.copy())
            offs.append(_offset(core))
    totals = core.total_scored, core.total_squared_error, core.total_nees
    traces = tuple(map(np.array, (times, errors, factors, offs))) if trace else ()
    told = watched.nis, watch.seconds
    return _settle(scenario, recording, lost, *totals, *told, *traces)


def make_core(
    agent: Agent, scenario: Any, options: Options, recording: Recording, reward: str
) -> Core:
    """The decision process of a recording's episodes, with the agent's own options."""
    options = replace(options, recording=recording, reward=reward, **agent.own_options)
    has_truth = recording.truth is not None
    return Core(scenario, options, len(recording), recording.time, has_truth)


def play(
    agent: Agent, core: Core, recording: Recording, seed: int,
    watch: Callable = lambda function, *arguments: function(*arguments),
    block: tuple[int, int | None] = (0, None),
) -> Iterator[tuple[Array, NDArray[np.bool_]]]:  # fmt: skip
    """Let an agent decide until all episodes are over.

    Args:
        watch: calls what costs time.
        block: as for `rollout`.

    Yields:
        After each decision its rewards (B,), and whose track it lost.
    """
    core.load(np.arange(len(recording)), recording)
    shown = recording if agent.clairvoyant else None
    agent.reset(Briefing(core.knobs, core.scenario, core.batch, seed, shown, core.interval, *block))
    running = np.ones(core.batch, bool)
    while running.any():
        seen = watch(core.observation) if agent.sees == "observation" else core.observation()
        action = np.clip(watch(agent.act, seen, without_truth(core)), -1.0, 1.0)
        reward, gone, ended = core.step(action, running)
        running &= ~(gone | ended)
        yield reward, gone


def _settle(
    scenario: Any, recording: Recording, lost: NDArray[np.bool_], scored: Array,
    squared_error: Array, nees: Array, nis: Array, seconds: float, *traces: Array,
) -> Scores:  # fmt: skip
    """The scores from sums over the `scored` instants until the end, or the loss."""
    all_scored = recording.scored_instants
    mean_square = rewards.mean_square(
        squared_error, scored, all_scored, lost, scenario.lost_distance
    )
    nees = nees / np.maximum(scored, 1.0) / len(scenario.yardstick)
    return Scores(np.sqrt(mean_square), lost, nees, nis, seconds, *traces)


def _filter(
    contestant: RecordingFilter,
    scenario: Any,
    options: Options,
    recording: Recording,
    trace: bool,
) -> Scores:
    """Some episodes at a time, so that their covariances fit into memory."""
    check_recording(recording, scenario)
    size = recording.time.shape[-1] * recording.mean.shape[1] ** 2
    chunk = max(1, HISTORY_SIZE // size)
    parts = []
    for begin in range(0, len(recording), chunk):
        part = recording[begin : begin + chunk]
        told = replace(part, truth=None, true_noise=None, true_bias=None, faults=())
        watch = Stopwatch()
        history = watch(contestant.filter, scenario, options, told)
        parts.append(_score(history, scenario, part, watch.seconds, trace))
    joined = [
        np.concatenate([getattr(p, name) for p in parts])
        for name in ("rmse", "lost", "nees", "nis")
    ]
    joined.append(sum(p.seconds for p in parts))
    if not trace:
        return Scores(*joined)
    traces = (np.concatenate([getattr(p, name) for p in parts], axis=1)
              for name in ("error", "factors", "off"))  # fmt: skip
    return Scores(*joined, recording.times[0], *traces)


def _score(
    history: History, scenario: Any, recording: Recording, seconds: float, trace: bool
) -> Scores:
    """Book a filter's history instant by instant, as `Core` books its own."""
    batch, steps = history.mean.shape[:2]
    yardstick = scenario.yardstick
    means, truth = (
        yardstick.values(x).swapaxes(0, 1).copy() for x in (history.mean, recording.truth)
    )
    roots = _roots(yardstick, history)
    lines = lines_of(range(len(yardstick)), [roots.shape[3]] * len(yardstick), yardstick.angles)
    squared, nominal, nees_sum, count, nees, latest = np.zeros((6, batch))
    known = np.ones((batch, steps)) if recording.scored is None else recording.scored
    index, active, lost = np.zeros(batch, np.int64), np.ones(batch, bool), np.zeros(batch, bool)
    no_rival, error, errors = np.zeros((batch, steps)), np.full(batch, np.nan), []
    for t in range(steps):
        failed = (history.failed_at >= 0) & (history.failed_at <= t)
        status = np.where(failed, history.status, 0)
        work = np.where(active, status, IDLE)
        scoring.score(means[t], roots[t], truth[t], lines, yardstick.weight, work, error, nees)
        error[known[:, t] == 0.0] = nees[known[:, t] == 0.0] = np.nan
        error[active & failed], nees[active & failed] = scenario.lost_distance, np.nan
        scoring.account(
            error, nees, status, no_rival, scenario.lost_distance, index, active, lost,
            squared, nominal, nees_sum, count, latest,
        )  # fmt: skip
        errors.append(error.copy())
    knobs = len(knobs_of(scenario.sensor.groups, state_groups=scenario.motion.groups))
    off = yardstick.off(history.mean, recording.truth).swapaxes(0, 1)
    traces = (recording.times[0], np.array(errors), np.ones((steps, batch, knobs)), off)
    told = _told_nis(history, scenario, recording), seconds
    traces = traces if trace else ()
    return _settle(scenario, recording, lost, count, squared, nees_sum, *told, *traces)


def _roots(yardstick: Yardstick, history: History) -> Array:
    """Rows (T, B, d, k) of factors of the covariance of what is scored; NaN where there is none.

    Of states they are taken from its own block: a filter's whole covariance may be none.
    """
    place = list(yardstick.states) if yardstick.sensor is None else slice(None)
    blocks = history.covariance[..., place, :][..., place]
    batch, steps, size = blocks.shape[:3]
    with np.errstate(all="ignore"):
        roots = cholesky(symmetric(blocks.swapaxes(0, 1)).reshape(-1, size, size))
        if yardstick.sensor is not None:
            roots = yardstick.rows(history.mean.swapaxes(0, 1).reshape(-1, size), roots)
    return np.ascontiguousarray(roots.reshape(steps, batch, *roots.shape[1:]))


def _told_nis(history: History, scenario: Any, recording: Recording) -> Array:
    """NIS per channel that arrived (B, 1 + G); a history does not tell that of the groups."""
    nis = np.full((len(recording), 1 + len(scenario.sensor.groups)), np.nan)
    arrived = np.where(np.isnan(history.nis), 0, (~np.isnan(recording.measurement)).sum(axis=2))
    count = arrived.sum(axis=1)
    nis[:, 0] = np.where(count > 0, np.nansum(history.nis, axis=1) / np.maximum(count, 1), np.nan)
    return nis


def _offset(core: Core) -> Array:
    """Estimated less true position (N, 3), or what else is scored, at the latest instant."""
    info = core.information()
    return core.yardstick.off(info["estimate"], info["truth"])


def without_truth(core: Core) -> dict[str, Any]:
    """The info dictionary less what only a simulation knows."""
    info = core.information()
    for name in ("truth", core.yardstick.error_name, "nees"):
        info.pop(name, None)
    return info
