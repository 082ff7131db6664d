"""The commands that repeat the papers' experiments and tell what came of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import complaints, console, progress
from .options import Executor, Processes, Resume, Seed, workers


def reproduce(
    experiment: Annotated[
        str,
        typer.Argument(metavar="NAME", help="E1 to E6, precision, hard (lost tracks), or all."),
    ],
    output: Annotated[Path, typer.Option(help="New folder for figures and claims.")],
    runs: Annotated[
        int | None, typer.Option(min=2, help="In place of each experiment's own number.")
    ] = None,
    seed: Seed = 0,
    processes: Processes = 2,
    executor: Executor = "processes",
    resume: Resume = False,
    almanac: Annotated[
        Path | None,
        typer.Option(
            help="YUMA file with the satellites of E4's day, 2016-02-29, in place of the baseline "
            "constellation."
        ),
    ] = None,
) -> None:
    """Repeat the experiments of the papers: figures, and a table of which claims hold.

    E1 and E2: radar of constant noise at 10 and 2 Hz; E3: phased array under jamming and loss;
    E4: GNSS under a clock fault; E5: bistatic tracking; E6: inertial navigation with outlying
    fixes; precision: every design of E1 and E2 in float32 and float64; hard: lost tracks in hard
    geometry.
    claims.md holds the table.
    """
    from ..reproduction.claims import claims_table
    from ..reproduction.experiments import chosen_experiments
    from ..reproduction.experiments import reproduce as run_experiments

    with complaints():
        names = chosen_experiments(experiment)
        satellites = None if almanac is None else str(almanac.resolve())
        where = workers(executor, processes)
        with progress() as bar:
            claims = run_experiments(names, output, runs, seed, where, resume, bar, satellites)
        console.print(claims_table(claims))
        console.print(f"Figures and claims: {output}")


def claims(
    folder: Annotated[
        Path | None,
        typer.Argument(help="Of a finished `kfenv reproduce`; the kept full run by default."),
    ] = None,
    readme: Annotated[
        Path | None, typer.Option(help="Markdown file whose table of claims is to be renewed.")
    ] = None,
) -> None:
    """Tell which of the papers' claims hold, as the full run found."""
    from ..reproduction.claims import claims_table
    from ..reproduction.summary import KEPT, read_claims, write_summary

    with complaints():
        found = read_claims(KEPT if folder is None else folder / "claims.json")
        console.print(claims_table(found))
        if readme is not None:
            write_summary(found, readme)
