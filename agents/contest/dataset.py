"""Episodes of an agent as a Minari dataset, for learners that only watch."""

from __future__ import annotations

import os
import shutil
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from ..contestants.agent import Agent
from ..contestants.registry import make_agent
from ..files import is_free
from ..jobs.carried import carried
from ..jobs.executor import Workers, run_jobs
from .rollout import make_core, play, scenario_and_options
from .scores import read_values

BLOCK = 50  # episodes of one job
Block = tuple[int, int]  # begin and end
ROOT = "MINARI_DATASETS_PATH"  # where Minari looks


class Episode(NamedTuple):
    """What an agent met and did in T decisions."""

    observations: NDArray[np.float32]  # (T + 1, D)
    actions: NDArray[np.float32]  # (T, K)
    rewards: NDArray[np.float64]  # (T,)
    lost: bool  # it ended with the track


@dataclass(frozen=True)
class Order:
    """What is recorded; equal ones give equal episodes.

    Attributes:
        env_id, env_kwargs: the environment; kwargs must be plain JSON values.
        agent: a name, or the path of a policy.
        episodes: number of them; episode i is that of ``env.reset(seed=seed + i)``.
        seed: of the first.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    agent: str
    episodes: int
    seed: int = 0


def write_dataset(
    order: Order,
    output: Path,
    processes: Workers = 2,
    tuned: Path | None = None,
    advance: Callable[[int], None] = lambda episodes: None,
) -> str:
    """Record episodes, and write them into a folder that MINARI_DATASETS_PATH may name.

    The episodes are those of training, which no contest tests on. Their environment has the knobs
    that the agent turns.

    Args:
        tuned: folder of a contest whose tuned parameters the agent takes.
        advance: called with the number of episodes that were finished.

    Returns:
        The dataset's name.

    Raises:
        FileExistsError: if the folder holds anything.
        ValueError: if Minari is not installed, or the agent takes no actions.
    """
    minari = _minari()
    if not is_free(output):
        raise FileExistsError(f"The folder {output} is not empty: name another.")
    scenario, options = scenario_and_options(order.env_id, order.env_kwargs)
    agent = make_agent(order.agent)
    if tuned is not None:
        agent = agent.with_values(read_values(tuned, order.agent))
    agent = agent.suited_to(scenario)
    if not isinstance(agent, Agent):
        raise ValueError(f"{agent.name} is a filter, which takes no actions to record.")
    agent.check(scenario, options, scenario.sample([np.random.default_rng(0)]))
    name = f"{scenario.name}/{agent.name}-v0"
    env = gym.make(order.env_id, **order.env_kwargs | agent.own_options)
    away = partial(_record, replace(order, env_kwargs=carried(order.env_kwargs)), agent)
    jobs = [(b, min(b + BLOCK, order.episodes)) for b in range(0, order.episodes, BLOCK)]
    with _new_folder(output), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it would like to know an author and a link
        storage = minari.create_dataset_from_buffers(
            name, [], env=env, algorithm_name=agent.name, description=str(order)
        ).storage
        for (begin, end), block in _in_turn(run_jobs(away, jobs, processes), jobs):
            seeds = range(order.seed + begin, order.seed + end)
            storage.update_episodes(map(partial(_buffer, minari), seeds, block))
            advance(len(block))
    return name


def _minari() -> Any:
    try:
        import minari
    except ImportError:
        raise ValueError("Minari is not installed: pip install -e '.[dataset]'.") from None
    return minari


@contextmanager
def _new_folder(output: Path) -> Iterator[None]:
    """Let Minari write beside a folder, which appears when all is done."""
    new = output.resolve().with_name(f".{output.name}.new")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    former = os.environ.get(ROOT)
    os.environ[ROOT] = str(new)
    try:
        yield
    finally:
        del os.environ[ROOT]
        if former is not None:
            os.environ[ROOT] = former
    if output.exists():
        output.rmdir()
    new.replace(output)


def _in_turn(
    done: Iterator[tuple[Block, list[Episode]]], jobs: Sequence[Block]
) -> Iterator[tuple[Block, list[Episode]]]:
    """Jobs with their results in the order of the jobs."""
    early: dict[Block, list[Episode]] = {}
    waiting = deque(jobs)
    for job, result in done:
        early[job] = result
        while waiting and waiting[0] in early:
            yield waiting[0], early.pop(waiting.popleft())


def _record(order: Order, agent: Agent, block: Block) -> list[Episode]:
    """The episodes of a block."""
    scenario, options = scenario_and_options(order.env_id, order.env_kwargs)
    seeds = range(order.seed + block[0], order.seed + block[1])
    recording = scenario.sample([seeding.np_random(seed)[0] for seed in seeds])
    core = make_core(agent, scenario, options, recording, options.reward)
    seen: list[NDArray] = []
    actions: list[NDArray] = []

    def noted(function: Callable, *arguments: Any) -> Any:
        """An action as precise as the dataset has it, so that it can be repeated."""
        result = function(*arguments)
        if function != agent.act:
            return result
        seen.append(arguments[0])
        actions.append(np.clip(result, -1.0, 1.0).astype(np.float32))
        return actions[-1].astype(np.float64)

    rewards, losses = [], []
    place = (block[0], order.episodes)
    for reward, lost in play(agent, core, recording, order.seed, noted, place):
        rewards.append(reward)
        losses.append(lost)
    seen.append(core.observation())
    arrays = (np.swapaxes(each, 0, 1) for each in (seen, actions, rewards, losses))
    return [_cut(*parts) for parts in zip(*arrays, strict=True)]


def _cut(seen: NDArray, actions: NDArray, rewards: NDArray, losses: NDArray[np.bool_]) -> Episode:
    """An episode up to its end, or until the track was lost."""
    lost = bool(losses.any())
    steps = int(np.argmax(losses)) + 1 if lost else len(rewards)
    return Episode(seen[: steps + 1], actions[:steps], rewards[:steps], lost)


def _buffer(minari: Any, seed: int, episode: Episode) -> Any:
    last = np.arange(len(episode.rewards)) == len(episode.rewards) - 1
    return minari.data_collector.EpisodeBuffer(
        seed=seed, observations=episode.observations, actions=episode.actions,
        rewards=episode.rewards, terminations=last & episode.lost,
        truncations=last & (not episode.lost),
    )  # fmt: skip
