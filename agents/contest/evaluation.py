"""A fair contest: all agents on the same episodes, with intervals on paired differences."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..contestants.learned import Learned
from ..contestants.registry import NAMES, make_agent
from ..executor import run_jobs
from ..files import clear_partial, is_free, read_json, write_json
from .cost import relative_cost
from .rollout import check_scored, draw_episodes, rollout, scenario_and_options
from .scores import Scores, read_cost, read_scores, read_values, scores_path, write_scores
from .summary import NOMINAL, TUNED, summarise
from .tuning import tune

# What is compared, not on what: an evaluated folder may gain agents and change the rival.
COMPARED = ("agents", "against", "policies")


@dataclass(frozen=True)
class Contest:
    """What is compared on what; equal contests give equal results.

    Attributes:
        env_id, env_kwargs: the environment; kwargs must be plain JSON values.
        agents: names or paths, see `kfenv.agents.contestants.registry.make_agent`.
        episodes: number of test episodes.
        seed: of the episodes.
        split: which episodes the agents meet, "test" or "validation".
        tuning_episodes: the same for every agent that has parameters.
        tuning_trials: settings that each may try for each of its parameters.
        tuning_kwargs: of the environment that agents are tuned in, if others than `env_kwargs`.
            Its faults are then what they expect in the test as well.
        against: an agent that all are compared with besides the yardsticks.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    agents: tuple[str, ...]
    episodes: int
    seed: int
    tuning_episodes: int = 32
    tuning_trials: int = 60
    split: str = "test"
    tuning_kwargs: dict[str, Any] | None = None
    against: str | None = None

    def __post_init__(self) -> None:
        for name, least in (("episodes", 2), ("tuning_episodes", 1), ("tuning_trials", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}.")
        names = [make_agent(agent).name for agent in self.all_agents]
        for given, name in zip(self.all_agents, names, strict=True):
            if "/" in name:
                raise ValueError(f"An agent's name must not hold a slash: {name!r}.")
            if names.count(name) > 1 or (name in NAMES and given not in NAMES):
                raise ValueError(
                    f"Two agents are called {name!r}: name the trained one with OTHER=PATH."
                )

    @property
    def all_agents(self) -> tuple[str, ...]:
        """The yardsticks first, the tuned one only where there is tuning; then the rival."""
        yardsticks = (NOMINAL, TUNED) if self.tuning_trials > 0 else (NOMINAL,)
        rival = () if self.against is None else (self.against,)
        return tuple(dict.fromkeys((*yardsticks, *rival, *self.agents)))

    @property
    def tuning_place(self) -> tuple[str, dict[str, Any]]:
        """The environment that agents are tuned in, and its keywords."""
        return self.env_id, self.env_kwargs if self.tuning_kwargs is None else self.tuning_kwargs

    @property
    def expected_place(self) -> tuple[str, dict[str, Any]]:
        """The environment with the faults that agents expect: those that they were tuned to."""
        if self.tuning_kwargs is None:
            return self.env_id, self.env_kwargs
        own = {key: value for key, value in self.env_kwargs.items() if key != "faults"}
        expected = {key: value for key, value in self.tuning_kwargs.items() if key == "faults"}
        return self.env_id, own | expected


def evaluate(
    contest: Contest,
    output: Path,
    processes: int = 2,
    resume: bool = False,
    started: Callable[[int], None] = lambda total: None,
    advance: Callable[[str], None] = lambda name: None,
    tuned: Path | None = None,
) -> list[dict[str, Any]]:
    """Run a contest and write ``results.json`` and each agent's scores into a folder.

    ``fixed`` and (with tuning) ``fixed-tuned`` always take part, as yardsticks. An
    agent's scores are written when it is done, so that resuming repeats none of them.
    A folder may gain agents by resuming with more of them.

    Args:
        tuned: folder of a contest with the same tuning, whose parameters are taken over.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        RuntimeError: if a worker process dies of an agent twice; the others' scores are kept.
        ValueError: if it holds another contest, or an agent is unknown.
    """
    _complain_first(contest)
    _admit(output, contest, resume)
    names, episodes = contest.all_agents, _episodes(contest)
    todo = [name for name in names if not scores_path(output, name).exists()]
    done = [name for name in names if name not in todo]
    for name in done:
        read_scores(output, name, episodes)  # complains
    started(len(names))
    for name in done:
        advance(name)
    for name, scored in run_jobs(partial(run_agent, contest, tuned=tuned), todo, processes):
        write_scores(output, name, *scored)
        advance(name)
    results = _results(contest, output)
    write_json(output / "results.json", results)
    return results


def _episodes(contest: Contest) -> int:
    """How many there are: a real log may have fewer than asked."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    recorded = scenario.recorded(contest.split, contest.episodes)
    return contest.episodes if recorded is None else len(recorded)


def _results(contest: Contest, output: Path) -> list[dict[str, Any]]:
    """What the stored scores of the contest's agents amount to."""
    given = {make_agent(name).name: name for name in contest.all_agents}
    scores = {name: read_scores(output, path) for name, path in given.items()}
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    rival = None if contest.against is None else make_agent(contest.against).name
    return [
        {
            "agent": name,
            "env": contest.env_id,
            "env_kwargs": contest.env_kwargs,
            "seed": contest.seed,
            "episodes": len(scores[name].rmse),
            "episodes_asked": contest.episodes,  # a real log may have fewer
        }
        | summarise(name, scores, rival, scenario.sensor.groups, contest.seed)
        | {"cost": read_cost(output, path), "given_as": path}
        for name, path in given.items()
    ]


def _complain_first(contest: Contest) -> None:
    """Meet what can be refused before anything is written."""
    place = (contest.env_id, contest.env_kwargs)
    scenario, _ = scenario_and_options(*place)
    if scenario.recorded(contest.split, 1) is not None:
        check_log(*place, contest.split, contest.seed, contest.episodes)
        if contest.tuning_trials > 0:
            tuning = draw_episodes(
                *contest.tuning_place, "tuning", contest.seed, contest.tuning_episodes
            )
            check_scored(tuning)
    episode = draw_episodes(*place, contest.split, contest.seed, 1)
    for contestant in map(make_agent, contest.all_agents):
        contestant.check(*scenario_and_options(*contest.expected_place), episode)


def check_log(
    env_id: str, env_kwargs: dict[str, Any], split: str, seed: int, episodes: int
) -> None:
    """Complain if a split of a real log has too few windows, or some that cannot be scored.

    Raises:
        ValueError: with the remedy.
    """
    windows = draw_episodes(env_id, env_kwargs, split, seed, episodes)
    if len(windows) < 2:
        raise ValueError(
            f"The log gives {len(windows)} window for {split}, and a contest needs 2: shorten "
            "duration or give a longer log."
        )
    check_scored(windows)


def run_agent(
    contest: Contest, name: str, tuned: Path | None = None
) -> tuple[Scores, dict[str, float], float | None]:
    """Tune one agent on the tuning episodes and score it on the test episodes.

    Args:
        tuned: folder of a contest whose parameters are taken over instead.

    Returns:
        Its scores, parameters and relative cost.
    """
    agent = make_agent(name)
    if tuned is not None:
        agent = agent.with_values(read_values(tuned, name))
    elif contest.tuning_trials > 0:
        recording = draw_episodes(
            *contest.tuning_place, "tuning", contest.seed, contest.tuning_episodes
        )
        agent = tune(agent, *contest.tuning_place, recording, contest.tuning_trials, contest.seed)
    place = contest.expected_place
    recording = draw_episodes(
        contest.env_id, contest.env_kwargs, contest.split, contest.seed, contest.episodes
    )
    scores = rollout(agent, *place, recording, contest.seed)
    cost = relative_cost(agent, *place, recording, contest.seed, scores.seconds)
    return scores, agent.values, cost


def _admit(output: Path, contest: Contest, resume: bool) -> None:
    """Take the folder for this contest, or complain before anything is touched."""
    content = json.loads(json.dumps(asdict(contest))) | {"policies": _digests(contest)}
    path = output / "contest.json"
    if output.exists() and not output.is_dir():
        raise FileExistsError(f"{output} is a file: name a folder for the results.")
    if not is_free(output):
        if not resume:
            raise FileExistsError(
                f"The folder {output} is not empty: name another, or go on with --resume."
            )
        remedy = "name another folder for the contest"
        held = read_json(path, dict, remedy) if path.exists() else {}
        if not _continues(held, content):
            raise ValueError(
                f"The folder {output} holds another contest: name another folder, or repeat the "
                "options that it was begun with."
            )
        content["policies"] = held.get("policies", {}) | content["policies"]
    output.mkdir(parents=True, exist_ok=True)
    clear_partial(output)
    write_json(path, content)


def _continues(held: dict[str, Any], content: dict[str, Any]) -> bool:
    """Whether a contest compares on the same as the one held, with the same policies."""
    one, other = ({k: v for k, v in c.items() if k not in COMPARED} for c in (held, content))
    former, now = held.get("policies", {}), content["policies"]
    return one == other and all(former[k] == now[k] for k in former.keys() & now.keys())


def _digests(contest: Contest) -> dict[str, str]:
    """A hash of each policy's numbers, so that a changed policy is another contest."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    agents = [make_agent(name).suited_to(scenario) for name in contest.all_agents]
    return {agent.name: agent.policy.digest for agent in agents if isinstance(agent, Learned)}
