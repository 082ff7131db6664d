"""A fair contest: all agents on the same episodes, with intervals on paired differences."""

from __future__ import annotations

import hashlib
import json
import signal
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contestants.agent import RecordingFilter
from ..contestants.learned import Learned
from ..contestants.registry import NAMES, make_agent
from ..files import write_json, written_whole
from .rollout import Scores, check_scored, draw_episodes, rollout, scenario_and_options
from .tuning import tune

Array = NDArray[np.float64]

RESAMPLES = 5000
CONFIDENCE = 0.95
YARDSTICKS = ("fixed", "fixed-tuned")


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
    """

    env_id: str
    env_kwargs: dict[str, Any]
    agents: tuple[str, ...]
    episodes: int
    seed: int
    tuning_episodes: int = 32
    tuning_trials: int = 60
    split: str = "test"

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
        """The yardsticks first; `fixed-tuned` only where there is tuning."""
        yardsticks = YARDSTICKS if self.tuning_trials > 0 else YARDSTICKS[:1]
        return tuple(dict.fromkeys((*yardsticks, *self.agents)))


def evaluate(
    contest: Contest,
    output: Path,
    processes: int = 2,
    resume: bool = False,
    started: Callable[[int], None] = lambda total: None,
    advance: Callable[[str], None] = lambda name: None,
) -> list[dict[str, Any]]:
    """Run a contest and write ``results.json`` and each agent's scores into a folder.

    ``fixed`` and (with tuning) ``fixed-tuned`` always take part, as yardsticks. An
    agent's scores are written when it is done, so that resuming repeats none of them.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        ValueError: if it holds another contest, or an agent is unknown.
    """
    _complain_first(contest)
    _admit(output, contest, resume)
    names = contest.all_agents
    todo = [name for name in names if not _scores_path(output, name).exists()]
    started(len(names))
    for name in set(names) - set(todo):
        advance(name)
    for name, (scores, values) in _run_all(contest, todo, processes):
        _write_scores(_scores_path(output, name), scores, values)
        advance(name)
    scores = {make_agent(name).name: read_scores(output, name) for name in names}
    results = [
        _summary(contest, make_agent(name).name, scores) | {"given_as": name} for name in names
    ]
    write_json(output / "results.json", results)
    return results


def _complain_first(contest: Contest) -> None:
    """Meet what can be refused before anything is written."""
    place = (contest.env_id, contest.env_kwargs)
    scenario, options = scenario_and_options(*place)
    if scenario.recorded(contest.split, 1) is not None:
        check_log(*place, contest.split, contest.seed, contest.episodes)
        if contest.tuning_trials > 0:
            tuning = draw_episodes(*place, "tuning", contest.seed, contest.tuning_episodes)
            check_scored(tuning)
    episode = draw_episodes(*place, contest.split, contest.seed, 1)
    for contestant in map(make_agent, contest.all_agents):
        if isinstance(contestant, RecordingFilter):
            contestant.check(scenario, options, episode)


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


def run_agent(contest: Contest, name: str) -> tuple[Scores, dict[str, float]]:
    """Tune one agent on the tuning episodes and score it on the test episodes."""
    agent = make_agent(name)
    options = (contest.env_id, contest.env_kwargs)
    if contest.tuning_trials > 0:
        recording = draw_episodes(*options, "tuning", contest.seed, contest.tuning_episodes)
        agent = tune(agent, *options, recording, contest.tuning_trials, contest.seed)
    recording = draw_episodes(*options, contest.split, contest.seed, contest.episodes)
    return rollout(agent, *options, recording, contest.seed), agent.values


def _run_all(contest: Contest, names: Sequence[str], processes: int):
    """Yield each agent's scores as they come, from worker processes if more than one."""
    if processes < 2 or len(names) < 2:
        for name in names:
            yield name, run_agent(contest, name)
        return
    # Fresh processes: a forked one would inherit threads of the progress display. They
    # leave Ctrl-C to this one, which ends them on its way out.
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with get_context("spawn").Pool(processes, signal.signal, ignore) as pool:
        yield from pool.imap_unordered(partial(_named_run, contest), names)


def _named_run(contest: Contest, name: str) -> tuple[str, tuple[Scores, dict[str, float]]]:
    return name, run_agent(contest, name)


def _summary(contest: Contest, name: str, scores: dict[str, Scores]) -> dict[str, Any]:
    own = scores[name]
    nees = own.nees[~own.lost]
    improvement = 1.0 - own.rmse / scores["fixed"].rmse
    low, high = median_interval(improvement, contest.seed)
    rmse_low, rmse_high = median_interval(own.rmse, contest.seed)
    summary = {
        "agent": name,
        "env": contest.env_id,
        "env_kwargs": contest.env_kwargs,
        "seed": contest.seed,
        "episodes": len(own.rmse),
        "episodes_asked": contest.episodes,  # a real log may have fewer
        "rmse": float(own.rmse.mean()),
        "rmse_std": float(own.rmse.std(ddof=1)),
        "rmse_median": float(np.median(own.rmse)),
        "rmse_median_ci_low": rmse_low,
        "rmse_median_ci_high": rmse_high,
        "rmse_p95": float(np.percentile(own.rmse, 95)),
        "track_loss": float(own.lost.mean()),
        "anees": float(np.mean(nees)) if len(nees) > 0 and np.isfinite(nees).all() else None,
        "improvement_over_fixed": float(np.median(improvement)),
        "ci_low": low,
        "ci_high": high,
    }
    if "fixed-tuned" in scores:
        difference = own.rmse - scores["fixed-tuned"].rmse
        low, high = median_interval(difference, contest.seed)
        summary["difference_to_fixed_tuned"] = float(np.median(difference))
        summary["difference_ci_low"], summary["difference_ci_high"] = low, high
    return summary


def median_interval(values: Array, seed: int) -> tuple[float, float]:
    """Percentile-bootstrap confidence interval of the median over episodes."""
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    from scipy.stats import bootstrap

    result = bootstrap(
        (values,), np.median, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
        method="percentile", rng=np.random.default_rng(seed),
    )  # fmt: skip
    interval = result.confidence_interval
    return float(interval.low), float(interval.high)


def _admit(output: Path, contest: Contest, resume: bool) -> None:
    """Take the folder for this contest, or complain before anything is touched."""
    content = json.loads(json.dumps(asdict(contest))) | {"policies": _digests(contest)}
    path = output / "contest.json"
    if output.exists() and not output.is_dir():
        raise FileExistsError(f"{output} is a file: name a folder for the results.")
    if output.exists() and any(output.iterdir()):
        if not resume:
            raise FileExistsError(
                f"The folder {output} is not empty: name another, or go on with --resume."
            )
        if not path.exists() or json.loads(path.read_text()) != content:
            raise ValueError(
                f"The folder {output} holds another contest: name another folder, or repeat the "
                "options that it was begun with."
            )
    output.mkdir(parents=True, exist_ok=True)
    write_json(path, content)


def _digests(contest: Contest) -> dict[str, str]:
    """A hash of each policy's numbers, so that a changed policy is another contest."""
    agents = [make_agent(name) for name in contest.agents]
    digests = {}
    for agent in agents:
        if isinstance(agent, Learned):
            digest = hashlib.sha256()
            for array in (*agent.policy.weights, *agent.policy.biases):
                digest.update(array.tobytes())
            digests[agent.name] = digest.hexdigest()
    return digests


def _scores_path(output: Path, name: str) -> Path:
    return output / "scores" / f"{make_agent(name).name}.npz"


def _write_scores(path: Path, scores: Scores, values: dict[str, float]) -> None:
    path.parent.mkdir(exist_ok=True)
    with written_whole(path) as file:
        np.savez(
            file, rmse=scores.rmse, lost=scores.lost, nees=scores.nees,
            parameters=list(values), values=list(values.values()),
        )  # fmt: skip


def read_scores(output: Path, name: str) -> Scores:
    """The stored scores of an agent."""
    with np.load(_scores_path(output, name)) as file:
        return Scores(file["rmse"], file["lost"], file["nees"])


def read_values(output: Path, name: str) -> dict[str, float]:
    """The parameters that an agent was scored with."""
    with np.load(_scores_path(output, name)) as file:
        return dict(zip(file["parameters"].tolist(), file["values"].tolist(), strict=True))
