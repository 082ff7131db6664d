"""The command that tries the product with what nobody thought of."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from .console import complaints, console, progress
from .options import Seed

if TYPE_CHECKING:
    from ..fuzzing.campaign import Tally


def fuzz(
    minutes: Annotated[float, typer.Option(min=0.0, help="All subjects get the same time.")] = 10.0,
    seed: Seed = 0,
    what: Annotated[
        list[str] | None,
        typer.Option(
            help="A subject or a group ('filters', 'readers', 'folders', 'environments', 'engine', "
            "'rinex' ...); repeat. Default: all."
        ),
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(
            help="A folder of valid files to spoil in place of those that come with kfenv: "
            "tracks/*.csv, rinex/*.??o and *.??n, almanac/*.yuma, ins/imu*.csv and gnss*.csv."
        ),
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for the cases that went wrong.")] = Path(
        "findings"
    ),
    replay: Annotated[
        Path | None, typer.Option(help="Try a case again that went wrong, and nothing else.")
    ] = None,
) -> None:
    """Try filters, environments and readers with random and spoilt input.

    Any error but the documented ones, and any NaN in an estimate whose status is OK, is a finding:
    its case is saved, and the exit code is 1. Ctrl-C ends it early.
    """
    from ..fuzzing.campaign import fuzz as run
    from ..fuzzing.readers import SAMPLES
    from ..fuzzing.subjects import make_subjects

    if replay is not None:
        return _replay(replay)
    with complaints():
        subjects = make_subjects(tuple(what or ()), samples or SAMPLES)
        with progress() as bar:
            task = bar.add_task("fuzzing", total=max(1, round(60.0 * minutes)))

            def advance(tallies: dict[str, Tally]) -> None:
                found = sum(len(tally.findings) for tally in tallies.values())
                spent = int(sum(tally.seconds for tally in tallies.values()))
                bar.update(task, completed=spent, description=f"{found} findings")

            tallies = run(subjects, seed, output, minutes, advance=advance)
    console.print(_table(tallies))
    for name, tally in tallies.items():
        for said, (often, path) in tally.findings.items():
            console.print(f"[red]{name}[/], {often} times: {escape(said)}\n  {path}")
    if any(tally.findings for tally in tallies.values()):
        raise typer.Exit(1)


def _replay(path: Path) -> None:
    from ..fuzzing.campaign import attempt
    from ..fuzzing.subject import load_case
    from ..fuzzing.subjects import make_subjects

    with complaints():
        name, case = load_case(path)
        [subject] = make_subjects((name,))
        _, wrong = attempt(subject, case)
    console.print(f"{name}: {'as promised' if wrong is None else escape(wrong)}")
    if wrong is not None:
        raise typer.Exit(1)


def _table(tallies: dict[str, Tally]) -> Table:
    table = Table("subject", "cases", "filter steps", "findings")
    for name, tally in tallies.items():
        table.add_row(name, f"{tally.cases:,}", f"{tally.steps:,}", str(len(tally.findings)))
    cases, steps, found = (
        sum(of(tally) for tally in tallies.values())
        for of in (lambda t: t.cases, lambda t: t.steps, lambda t: len(t.findings))
    )
    table.add_section()
    table.add_row("all", f"{cases:,}", f"{steps:,}", str(found))
    return table
