"""Folders that commands wrote, one file of them spoilt: gone on with, or refused in a sentence."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

from numpy.random import Generator

import kfenv  # noqa: F401  (registers the environments)

from ..contest.contest import Contest
from ..contest.evaluation import evaluate
from ..contest.leaderboard import read_results, section
from ..contest.limit import Limit, measure_limit
from ..contest.suite_run import machine
from ..contest.suites import IN_DISTRIBUTION, SUITES
from ..files import write_json
from ..reproduction.claims import claims_table
from ..reproduction.summary import KEPT, read_claims, summary
from .mutations import mutate
from .readers import check_complaint
from .subject import Case, Wrong

LINEAR, SHORT = "kfenv/BistaticTracking-v0", {"duration": 2.0}
CONTEST = Contest(LINEAR, SHORT, ("huber-gate",), 3, 0, tuning_episodes=2, tuning_trials=2)
LIMIT = Limit(LINEAR, SHORT, episodes=2, particles=8, repeats=2)
SUITE = "bistatic"
CLAIMS = 12


class Folders:
    """A folder of results and a command that goes on with it.

    Args:
        name: in `KINDS`.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._make, self._again = KINDS[name]

    @cached_property
    def _whole(self) -> dict[str, bytes]:
        """The files that the command leaves."""
        with tempfile.TemporaryDirectory(prefix="kfenv-fuzz-") as place:
            folder = Path(place) / "out"
            self._make(folder)
            files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
            return {str(path.relative_to(folder)): path.read_bytes() for path in files}

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        files = dict(self._whole)
        name = [*files][rng.integers(len(files))]
        files[name] = mutate(rng, files[name])
        if rng.random() < 0.1:
            del files[name]
        return {"names": [*files], **{f"file {i}": one for i, one in enumerate(files.values())}}

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        with tempfile.TemporaryDirectory(prefix="kfenv-fuzz-") as place:
            folder = Path(place) / "out"
            folder.mkdir()
            for i, name in enumerate(case["names"]):
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(case[f"file {i}"])
            try:
                self._again(folder)
            except (ValueError, FileNotFoundError, FileExistsError) as error:
                check_complaint(str(error), [place])
        return 0


def _contest(folder: Path) -> None:
    evaluate(CONTEST, folder, processes=1, resume=folder.exists())
    _check_json(folder / "results.json")


def _limit(folder: Path) -> None:
    measure_limit(LIMIT, folder, processes=1, resume=folder.exists())
    _check_json(folder / "limit.json")


def _suite(folder: Path) -> None:
    """Results as a suite's folder has them, of another contest's numbers."""
    suite = SUITES[SUITE]
    told = {"suite": SUITE, "version": suite.version, "recordings": suite.recordings,
            "episodes_at_most": None, "machine": machine()}  # fmt: skip
    case = {"case": IN_DISTRIBUTION, "what": "as tuned"}
    results = evaluate(CONTEST, folder, processes=1)
    for path in folder.rglob("*.*"):
        path.unlink()
    write_json(folder / "results.json", [case | result | told for result in results])


def _page(folder: Path) -> None:
    section(read_results(folder), folder, folder / "page.md")


def _claims(folder: Path) -> None:
    folder.mkdir()
    write_json(folder / "claims.json", json.loads(KEPT.read_text())[:CLAIMS])


def _summary(folder: Path) -> None:
    claims = read_claims(folder / "claims.json")
    claims_table(claims)
    summary(claims)


def _check_json(path: Path) -> None:
    def refuse(name: str) -> None:
        raise Wrong(f"{path.name} holds {name}, which JSON has not")

    json.loads(path.read_text(), parse_constant=refuse)


# What writes a folder, and what reads it again
KINDS: dict[str, tuple[Callable[[Path], None], Callable[[Path], None]]] = {
    "contest": (_contest, _contest),
    "limit": (_limit, _limit),
    "leaderboard": (_suite, _page),
    "claims": (_claims, _summary),
}
