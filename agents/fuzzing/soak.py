"""Hours of ordinary use in a loop, and how much memory it takes: it must not grow."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import gymnasium as gym
import numpy as np

import kfenv

from ..contest.contest import Contest
from ..contest.evaluation import evaluate

SUB_ENVIRONMENTS, STEPS, FRAMES = 32, 100, 3
LINEAR, SHORT = "kfenv/BistaticTracking-v0", {"duration": 4.0}
WARM_UP = 0.2  # share of the rounds after which everything has been compiled and cached
FEWEST = 5  # rounds, of which memory at the start and at the end can be told
MOST_GROWTH = 0.01


def soak(minutes: float, advance: Callable[[float], None] = lambda seconds: None) -> list[int]:
    """Vector steps with resets, rendering and a contest, round after round; Ctrl-C ends it.

    Returns:
        Memory that the process has after each round, bytes.
    """
    began, taken = time.monotonic(), []
    try:
        while len(taken) < FEWEST or time.monotonic() - began < 60.0 * minutes:
            _round(len(taken))
            taken.append(resident_memory())
            advance(time.monotonic() - began)
    except KeyboardInterrupt:
        pass  # what was measured is told
    return taken


def growth(taken: list[int]) -> float:
    """By how much memory grew from the end of the warm-up to the end, as a share.

    Raises:
        ValueError: if there are too few rounds to tell.
    """
    if len(taken) < FEWEST:
        raise ValueError(f"{len(taken)} rounds are too few to tell growth: give it more minutes.")
    warm = taken[int(WARM_UP * len(taken)) :]
    few = max(1, len(warm) // 5)
    return median(warm[-few:]) / median(warm[:few]) - 1.0


def resident_memory() -> int:
    """Bytes that this process has in memory.

    Raises:
        ValueError: where the system does not tell.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        raise ValueError("Memory is told by Linux alone: run kfenv soak there.") from None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _round(number: int) -> None:
    for env_id in kfenv.ENVIRONMENTS:
        _step(env_id, number)
        _render(env_id, number)
    contest = Contest(LINEAR, SHORT, ("huber-gate",), 8, number, 2, 2)
    with tempfile.TemporaryDirectory(prefix="kfenv-soak-") as place:
        evaluate(contest, Path(place) / "out", processes=1)


def _step(env_id: str, seed: int) -> None:
    """A vector of short episodes, each of which ends and begins anew some times."""
    env = gym.make_vec(env_id, num_envs=SUB_ENVIRONMENTS, duration=3.0, autoreset_mode="same_step")
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    for _ in range(STEPS):
        env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
    env.close()


def _render(env_id: str, seed: int) -> None:
    env = gym.make(env_id, duration=3.0, render_mode="rgb_array")
    env.reset(seed=seed)
    for _ in range(FRAMES):
        env.step(np.zeros(env.action_space.shape, np.float32))
        env.render()
    env.close()
