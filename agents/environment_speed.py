"""Speed of vector environments while no episode ends: against the engine alone, and in threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from kfenv.filters.engine import Engine

FEW, MANY = 256, 1024  # sub-environments
DECISIONS = 100


def measured(env_id: str, best: Callable[[int, Callable], float]) -> dict[str, float]:
    """Steps per second, the most of several times: of the engine alone, of as many
    sub-environments, and of more of them in one thread and in two.

    Args:
        best: the shortest of so many times of a call, s.
    """
    calls = {
        "engine": _engine(env_id),
        "environments": _environments(env_id, FEW, 1),
        "one thread": _environments(env_id, MANY, 1),
        "two threads": _environments(env_id, MANY, 2),
    }
    speed = dict.fromkeys(calls, 0.0)
    for _ in range(4):  # in turn, so that a drift of the machine's speed meets all
        for name, (run, steps) in calls.items():
            speed[name] = max(speed[name], steps / best(1, run))
    return speed


def _engine(env_id: str) -> tuple[Callable[[], Any], int]:
    """A call that filters whole episodes, and the number of its steps."""
    scenario = gym.make(env_id, faults="none").unwrapped.scenario
    recording = scenario.sample([np.random.default_rng(i) for i in range(FEW)])
    run = partial(Engine(scenario.motion, scenario.sensor).run, recording)
    run()
    return run, FEW * len(recording.time)


def _environments(env_id: str, count: int, threads: int) -> tuple[Callable[[], Any], int]:
    """A call that makes some decisions from where the one before ended, and their number."""
    vector = gym.make_vec(env_id, num_envs=count, faults="none", info="none", threads=threads)
    vector.reset(seed=0)
    action = np.zeros(vector.action_space.shape, np.float32)

    def run() -> None:
        for _ in range(DECISIONS):
            vector.step(action)

    return run, count * DECISIONS
