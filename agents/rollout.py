"""Agents on recordings: everything scored, everyone on the same noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.options import Options, split_keywords
from kfenv.scenarios.recording import Recording

from .agent import Agent, Briefing

Array = NDArray[np.float64]

# Streams of random numbers that never meet: training draws from plain seeds, the
# others from children of the seed's sequence under a key of their own.
SPLITS = {"tuning": 1, "validation": 2, "test": 3}


def episode_rngs(split: str, seed: int, episodes: int) -> list[Generator]:
    """A generator for each episode of a split."""
    key = SPLITS[split]
    return [default_rng(SeedSequence(seed, spawn_key=(key, i))) for i in range(episodes)]


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
    env_id: str, env_kwargs: dict[str, Any], split: str, seed: int, episodes: int
) -> Recording:
    """The episodes of a split: of a real log at most as many as that part of it has."""
    scenario, _ = scenario_and_options(env_id, env_kwargs)
    recorded = scenario.recorded(split, episodes)
    return recorded or scenario.sample(episode_rngs(split, seed, episodes))


@dataclass(frozen=True)
class Scores:
    """What an agent achieved on N episodes.

    Attributes:
        rmse: (N,) position RMSE over the whole episode, m; a lost track counts the loss
            distance for every remaining instant.
        lost: (N,) whether the track was lost.
        nees: (N,) mean position NEES per degree of freedom until the end or the loss.
        time: (D,) end of each decision, s, if traced.
        error: (D, N) position error then, m, if traced.
        factors: (D, N, K) all knobs' factors, if traced.
    """

    rmse: Array
    lost: NDArray[np.bool_]
    nees: Array
    time: Array | None = None
    error: Array | None = None
    factors: Array | None = None


def rollout(
    agent: Agent,
    env_id: str,
    env_kwargs: dict[str, Any],
    recording: Recording,
    seed: int = 0,
    trace: bool = False,
) -> Scores:
    """Run an agent over every episode of a recording, in lock-step.

    Raises:
        ValueError: if the recording has no truth to score against.
    """
    if recording.truth is None:
        raise ValueError("The episodes have no truth, so no error can be scored.")
    scenario, options = scenario_and_options(env_id, env_kwargs)
    options = replace(options, recording=recording, reward="rmse", **agent.own_options)
    core = Core(scenario, options, len(recording), recording.time, has_truth=True)
    core.load(np.arange(len(recording)), recording)
    shown = recording if agent.clairvoyant else None
    agent.reset(
        Briefing(core.knobs, scenario.sensor, core.batch, seed, shown, options.decision_interval)
    )
    running, lost = np.ones(core.batch, bool), np.zeros(core.batch, bool)
    times, errors, factors = [], [], []
    while running.any():
        action = np.clip(agent.act(core.observation(), _without_truth(core)), -1.0, 1.0)
        _, gone, ended = core.step(action, running)
        lost |= gone
        running &= ~(gone | ended)
        if trace:
            times.append(recording.time[min(core.index.max(), len(recording.time)) - 1])
            errors.append(core.error.copy())
            factors.append(core.factors.copy())
    steps = len(recording.time)
    scored = np.where(lost, core.index + 1, steps)
    squared = core.total_squared_error + (steps - scored) * scenario.lost_distance**2
    own_scores = (np.sqrt(squared / steps), lost, core.total_nees / scored / 3.0)
    traces = (np.array(times), np.array(errors), np.array(factors)) if trace else ()
    return Scores(*own_scores, *traces)


def _without_truth(core: Core) -> dict[str, Any]:
    """The info dictionary less what only a simulation knows."""
    info = core.information()
    for name in ("truth", "position_error", "nees"):
        info.pop(name, None)
    return info
