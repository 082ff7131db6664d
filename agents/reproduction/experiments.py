"""The experiments by name, and how some of them are run: `kfenv reproduce`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rich.progress import Progress

from kfenv.names import unknown

from ..files import is_free, locked
from ..jobs.carried import carried
from ..jobs.executor import Workers
from . import (
    bistatic,
    gnss_tracking,
    hard_geometry,
    inertial_navigation,
    precision,
    radar_tracking,
    radar_validation,
)
from .claims import Claim, write_claims
from .laboratory import Laboratory


class Experiment(NamedTuple):
    """An experiment of SPEC 7.1.

    Attributes:
        title: what it is.
        runs: how many it makes unless told; the papers' number in E1 and E2, more than the
            paper's ten in E3, where spreads and lost tracks want more.
        reproduce: writes the figures and returns the claims.
    """

    title: str
    runs: int
    reproduce: Callable[[Laboratory], list[Claim]]


EXPERIMENTS: dict[str, Experiment] = {
    "E1": Experiment("radar at 10 Hz, constant noise (S1 sec. 4)", 500, radar_validation.at_10_hz),
    "E2": Experiment("radar at 2 Hz, constant noise (S0 sec. 4)", 500, radar_validation.at_2_hz),
    "E3": Experiment(
        "phased array at 10 Hz, jamming and signal loss (S0 sec. 5.1)",
        40,
        radar_tracking.reproduce,
    ),
    "E4": Experiment(
        "GNSS tracking, clock fault and loss of lock (S0 sec. 5.2)", 100, gnss_tracking.reproduce
    ),
    "E5": Experiment("bistatic tracking, linear filter (S3 sec. 5)", 2000, bistatic.reproduce),
    "E6": Experiment(
        "inertial navigation with outlying fixes (S4 sec. 5)", 100, inertial_navigation.reproduce
    ),
    "precision": Experiment(
        "every design of E1 and E2 in float32 and float64", 50, precision.reproduce
    ),
    "hard": Experiment("lost tracks in hard geometry", 200, hard_geometry.reproduce),
}


def chosen_experiments(name: str) -> tuple[str, ...]:
    """The experiment of that name, or every one for ``"all"``.

    Raises:
        ValueError: if there is none.
    """
    if name == "all":
        return tuple(EXPERIMENTS)
    if name not in EXPERIMENTS:
        raise ValueError(unknown("experiment", name, (*EXPERIMENTS, "all")))
    return (name,)


def reproduce(
    names: Sequence[str],
    output: Path,
    runs: int | None,
    seed: int,
    processes: Workers,
    resume: bool,
    progress: Progress,
    almanac: str | None = None,
) -> list[Claim]:
    """Run experiments: figures and claims into a folder for each, all claims into `output`.

    Args:
        names: of the experiments.
        runs: in place of each experiment's own number.
        resume: take finished runs from the folder.
        almanac: path of a YUMA file for E4.

    Raises:
        FileExistsError: if the folder holds anything and `resume` is not set.
        RuntimeError: if another process works in it.
        ValueError: if there are too few runs to tell a spread, or the almanac is none or not used.
    """
    if runs is not None and runs < 2:
        raise ValueError(f"runs must be at least 2, since spreads are told, got {runs}.")
    if not is_free(output) and not resume:
        raise FileExistsError(
            f"The folder {output} is not empty: name another with --output, or go on with --resume."
        )
    if almanac is not None:
        _check_almanac(names, almanac)
    output.mkdir(parents=True, exist_ok=True)
    claims: list[Claim] = []
    with locked(output):
        for name in names:
            experiment = EXPERIMENTS[name]
            own, folder = runs or experiment.runs, output / name
            folder.mkdir(parents=True, exist_ok=True)
            place = Laboratory(folder, own, seed, processes, progress, carried(almanac))
            found = [replace(claim, runs=own, seed=seed) for claim in experiment.reproduce(place)]
            write_claims(found, folder)
            claims += found
        write_claims(claims, output)
    return claims


def _check_almanac(names: Sequence[str], almanac: str) -> None:
    if "E4" not in names:
        raise ValueError("almanac is for E4, the one experiment with satellites: leave it out.")
    gnss_tracking.papers_case(almanac)  # complains before hours of other experiments
