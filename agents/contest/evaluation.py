"""A fair contest: all agents on the same episodes, with intervals on paired differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

from ..contestants.learned import Learned
from ..contestants.registry import make_agent
from ..files import blamed_on, goes_on, locked, read_json, write_json
from ..jobs.executor import Workers
from ..plain import plain
from .blocks import play
from .contest import Contest
from .rollout import check_scored, draw_episodes, scenario_and_options
from .scores import read_cost, read_scores, scores_path
from .summary import NOMINAL, TUNED, summarise
from .tuning_costs import AXES, ERROR

# What is compared, not on what: an evaluated folder may gain agents and change the rival.
COMPARED = ("agents", "against", "policies")


def evaluate(
    contest: Contest,
    output: Path,
    processes: Workers = 2,
    resume: bool = False,
    started: Callable[[int], None] = lambda total: None,
    advance: Callable[[str], None] = lambda name: None,
) -> list[dict[str, Any]]:
    """Run a contest and write ``results.json`` and each agent's scores into a folder.

    ``fixed`` and (with tuning) ``fixed-tuned`` always take part, to be compared with. What is
    finished of an agent (its tuning, blocks of episodes, its scores) is kept, so that resuming
    repeats none of it. A folder may gain agents by resuming with more of them.

    Args:
        processes: so many of this machine, or a cluster's.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        RuntimeError: if a worker process dies of a job twice; what else was done is kept. Also if
            another process works in the folder.
        ValueError: if it holds another contest, or an agent is unknown.
    """
    [results] = evaluate_all(
        {output: contest}, processes, resume, started, lambda folder, name: advance(name)
    ).values()
    return results


def evaluate_all(
    contests: Mapping[Path, Contest],
    processes: Workers,
    resume: bool,
    started: Callable[[int], None],
    advance: Callable[[Path, str], None],
) -> dict[Path, list[dict[str, Any]]]:
    """Run contests of the same agents and the same tuning, each into a folder; see `evaluate`."""
    for contest in contests.values():
        _complain_first(contest)
    for output, contest in contests.items():
        _admit(output, contest, resume)
    with ExitStack() as until_done:
        for output, contest in contests.items():
            output.mkdir(parents=True, exist_ok=True)
            until_done.enter_context(locked(output))
            # Once more: another run may have ended in between
            write_json(output / "contest.json", _admit(output, contest, resume))
        return _run(contests, processes, started, advance)


def _run(
    contests: Mapping[Path, Contest],
    processes: Workers,
    started: Callable[[int], None],
    advance: Callable[[Path, str], None],
) -> dict[Path, list[dict[str, Any]]]:
    """Run what is left of contests in their folders."""
    names = next(iter(contests.values())).all_agents
    sizes = {output: _episodes(contest) for output, contest in contests.items()}
    done = [(o, name) for o in contests for name in names if scores_path(o, name).exists()]
    for output, name in done:
        read_scores(output, name, sizes[output])  # complains
    started(len(contests) * len(names))
    for output, name in done:
        advance(output, name)
    folders = list(contests)
    play(
        list(contests.values()), list(sizes.values()), folders, processes,
        lambda number, name: advance(folders[number], name),
    )  # fmt: skip
    results = {output: _results(contest, output) for output, contest in contests.items()}
    for output, found in results.items():
        write_json(output / "results.json", found)
    return results


def _episodes(contest: Contest) -> int:
    """How many there are: a real log may have fewer than asked."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    recorded = scenario.recorded(contest.split, contest.episodes)
    return contest.episodes if recorded is None else len(recorded)


def _results(contest: Contest, output: Path) -> list[dict[str, Any]]:
    """What the stored scores of the contest's agents amount to."""
    given = {make_agent(name).name: name for name in contest.all_agents}
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    rival = None if contest.against is None else make_agent(contest.against).name
    known = [name for name in (NOMINAL, TUNED, rival) if name in given]
    met = {name: read_scores(output, given[name]) for name in known}

    def result(name: str, path: str) -> dict[str, Any]:  # so few scores are held at once
        scores = met if name in met else met | {name: read_scores(output, path)}
        return {
            "agent": name,
            "env": contest.env_id,
            "env_kwargs": plain(contest.env_kwargs),
            "seed": contest.seed,
            "episodes": len(scores[name].rmse),
            "episodes_asked": contest.episodes,  # a real log may have fewer
            **_unit(scenario),
            **summarise(name, scores, rival, scenario.sensor.groups, contest.seed),
            "cost": read_cost(output, path),
            "given_as": path,
        }

    return [result(name, path) for name, path in given.items()]


def _unit(scenario: Any) -> dict[str, str]:
    """Of the errors, where they are others than a position's in metres."""
    yardstick = scenario.yardstick
    if yardstick.name == "position":
        return {}
    names = ", ".join(component.name for component in yardstick.components)
    return {"scored": names, "unit": yardstick.unit}


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
            if contest.tune_on in (ERROR, AXES):
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


def _admit(output: Path, contest: Contest, resume: bool) -> dict[str, Any]:
    """What the folder shall hold of this contest; complains if it cannot, touching nothing."""
    told = {item.name: getattr(contest, item.name) for item in fields(contest)}
    content = plain(told) | {"policies": _digests(contest)}
    path = output / "contest.json"
    if goes_on(output, resume):
        remedy = "name another folder for the contest"
        held = read_json(path, dict, remedy) if path.exists() else {}
        with blamed_on(path, remedy):
            continues = _continues(held, content)
            content["policies"] = held.get("policies", {}) | content["policies"]
        if not continues:
            raise ValueError(
                f"The folder {output} holds another contest: name another folder, or repeat the "
                "options that it was begun with."
            )
    return content


def _continues(held: dict[str, Any], content: dict[str, Any]) -> bool:
    """Whether a contest compares on the same as the one held, with the same policies."""
    held = {"tune_on": ERROR} | held  # of folders older than the choice
    one, other = ({k: v for k, v in c.items() if k not in COMPARED} for c in (held, content))
    former, now = held.get("policies", {}), content["policies"]
    return one == other and all(former[k] == now[k] for k in former.keys() & now.keys())


def _digests(contest: Contest) -> dict[str, str]:
    """A hash of each policy's numbers, so that a changed policy is another contest."""
    scenario, _ = scenario_and_options(contest.env_id, contest.env_kwargs)
    agents = [make_agent(name).suited_to(scenario) for name in contest.all_agents]
    return {agent.name: agent.policy.digest for agent in agents if isinstance(agent, Learned)}
