"""Running a frozen suite: one contest per case, tuned once, in a folder that resumes."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from kfenv.names import unknown

from ..contestants.registry import AGENTS, FILTERS, make_agent
from ..files import blamed_on, goes_on, locked, read_json, write_json
from ..jobs.executor import Workers
from .contest import Contest
from .evaluation import evaluate_all
from .recording_hash import recording_hash
from .rollout import draw_episodes, scenario_and_options
from .suites import FLIGHT, IN_DISTRIBUTION, Case, Suite, find_suite

HASHED = 2  # episodes of each case, and of those that agents are tuned on


@dataclass(frozen=True)
class SuiteRun:
    """What is asked of a suite.

    Attributes:
        name: of the suite.
        agents: names or paths.
        cases: only these, besides the one in distribution, in which agents are tuned; None for
            all.
        episodes: at most so many of each case, for a first look; None for all.
        tracks: files of real flights, each a case of its own.
        against: an agent that all are compared with.
    """

    name: str
    agents: tuple[str, ...]
    cases: tuple[str, ...] | None = None
    episodes: int | None = None
    tracks: tuple[Path, ...] = ()
    against: str | None = None

    @property
    def suite(self) -> Suite:
        """The suite of that name."""
        return find_suite(self.name)

    @property
    def chosen(self) -> dict[str, Case]:
        """The cases to run, in distribution first.

        Raises:
            ValueError: for an unknown case.
        """
        known = self.suite.cases | track_cases(self.suite, self.tracks)
        for case in self.cases or ():
            if case not in known:
                raise ValueError(unknown("case", case, known))
        wanted = known if self.cases is None else {IN_DISTRIBUTION, *self.cases}
        return {name: case for name, case in known.items() if name in wanted}

    def contest(self, case: Case, agents: tuple[str, ...]) -> Contest:
        """The contest of a case, with the suite's tuning."""
        suite = self.suite
        episodes = min(case.episodes, self.episodes or case.episodes)
        own = dict(suite.kwargs) | dict(case.kwargs)
        return Contest(
            suite.env_id, own, agents, episodes, suite.seed, suite.tuning_episodes,
            suite.tuning_trials, tuning_kwargs=dict(suite.kwargs), against=self.against,
        )  # fmt: skip


def run_suite(
    run: SuiteRun,
    output: Path,
    processes: Workers = 2,
    resume: bool = False,
    started: Callable[[int], None] = lambda total: None,
    advance: Callable[[str], None] = lambda what: None,
) -> list[dict[str, Any]]:
    """Run the cases of a suite and write ``results.json`` into a folder, with a folder for each.

    The case in distribution comes first: what is tuned there serves all the others. A folder
    that resumes keeps its agents and takes more.

    Returns:
        An object per case and agent: a contest's, with the case, the suite, the hash of its
        recordings, whether it was shortened, and the machine.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        RuntimeError: if another process works in it.
        ValueError: if it holds another suite, or an agent or case is unknown.
    """
    cases, told = run.chosen, _told(run)
    _admit(output, told, run.agents, resume)
    output.mkdir(parents=True, exist_ok=True)
    with locked(output):
        agents = _admit(output, told, run.agents, resume)  # another run may have ended meanwhile
        contests = {output / name: run.contest(case, agents) for name, case in cases.items()}
        write_json(output / "suite.json", told | {"agents": agents})
        evaluate_all(
            contests, processes, True, started,
            lambda folder, agent: advance(f"{folder.name}: {agent}"),
        )  # fmt: skip
        results = _gather(run.suite, output, told)
        write_json(output / "results.json", results)
    return results


def hash_of(suite: Suite) -> str:
    """The hash of a suite's recordings: the first episodes of tuning and of every case."""
    recordings = [_first(suite, {}, "tuning")]
    recordings += [_first(suite, case.kwargs, "test") for case in suite.cases.values()]
    return recording_hash(recordings)


def _first(suite: Suite, kwargs: Mapping[str, Any], split: str) -> Any:
    return draw_episodes(suite.env_id, dict(suite.kwargs) | dict(kwargs), split, suite.seed, HASHED)


def suitable(suite: Suite) -> tuple[str, ...]:
    """All agents and banks that have nothing to complain of in a suite's environment."""
    scenario, options = scenario_and_options(suite.env_id, dict(suite.kwargs))
    episode = draw_episodes(suite.env_id, dict(suite.kwargs), "test", suite.seed, 1)

    def suits(name: str) -> bool:
        try:
            make_agent(name).check(scenario, options, episode)
        except ValueError:
            return False
        return True

    return tuple(name for name in (*AGENTS, *FILTERS) if suits(name))


def track_cases(suite: Suite, tracks: Sequence[Path]) -> dict[str, Case]:
    """A case for each real flight, named after its file.

    Args:
        tracks: CSV files, or folders of them.

    Raises:
        ValueError: if the suite's environment cannot fly them, or a folder has none.
    """
    files = [file for path in tracks for file in _csv_files(path)]
    scenario, _ = scenario_and_options(suite.env_id, dict(suite.kwargs))
    if files and "track" not in [item.name for item in fields(scenario)]:
        raise ValueError(f"{suite.env_id} flies no tracks: leave them out.")
    return {
        f"flight-{file.stem}": Case(FLIGHT, {"track": str(file.resolve())}, 100) for file in files
    }


def _csv_files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.csv"))
    if not found:
        raise ValueError(f"The folder {path} holds no CSV file of a flight.")
    return found


def _told(run: SuiteRun) -> dict[str, Any]:
    """What a folder of results says of the suite."""
    suite = run.suite
    return {
        "suite": run.name,
        "version": suite.version,
        "recordings": hash_of(suite),
        "episodes_at_most": run.episodes,
    }


def _admit(output: Path, told: dict[str, Any], agents: tuple[str, ...], resume: bool) -> tuple:
    """The agents that the folder then has; complains if it is not for them, touching nothing."""
    for agent in agents:
        make_agent(agent)  # complains
    path = output / "suite.json"
    if not goes_on(output, resume):
        return agents
    held = read_json(path, dict, "name another folder for the suite") if path.exists() else {}
    if any(held.get(key) != value for key, value in told.items()):
        raise ValueError(
            f"The folder {output} holds another suite, other recordings or another number of "
            "episodes: name another folder, or repeat the options that it was begun with."
        )
    with blamed_on(path, "name another folder for the suite"):
        return tuple(dict.fromkeys((*held["agents"], *agents)))


def _gather(suite: Suite, output: Path, told: dict[str, Any]) -> list[dict[str, Any]]:
    """The results of every case that the folder holds, real flights last."""
    found = {path.parent.name: path for path in sorted(output.glob("*/results.json"))}
    order = [name for name in suite.cases if name in found]
    order += [name for name in found if name not in order]
    about = told | {"machine": machine()}
    what = {name: case.what for name, case in suite.cases.items()}
    return [
        {"case": name, "what": what.get(name, FLIGHT)} | result | about
        for name in order
        for result in read_json(found[name], list, f"run the case {name} with --resume")
    ]


def machine() -> dict[str, Any]:
    """What computed, as far as costs may depend on it."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def _processor() -> str:
    """The processor's model, or at least its kind."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()
