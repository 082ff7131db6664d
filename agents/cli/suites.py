"""The commands that run frozen suites and publish what came out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import complaints, console, progress
from .options import Against, Executor, Processes, Resume, workers
from .tables import results_table


def suites() -> None:
    """List the frozen suites, and whether they still draw the episodes of their version."""
    import kfenv  # noqa: F401  (registers the environments)

    from ..contest.suite_run import hash_of
    from ..contest.suites import SUITES

    table = Table("suite", "version", "environment", "episodes", "cases", "recordings",
                  box=SIMPLE_HEAD)  # fmt: skip
    for name, one in SUITES.items():
        drawn = hash_of(one)
        told = drawn if drawn == one.recordings else f"{drawn}, not {one.recordings}"
        episodes = sum(case.episodes for case in one.cases.values())
        table.add_row(name, str(one.version), one.env_id, str(episodes), ", ".join(one.cases), told)
    console.print(table)


def suite(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A suite that `kfenv suites` lists.")],
    output: Annotated[Path, typer.Option(help="New folder for results.")],
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="As of `kfenv evaluate`; repeat. Default: all that suit it but the fixed family."
        ),
    ] = None,
    case: Annotated[
        list[str] | None, typer.Option(help="Only this case, and the one in distribution; repeat.")
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(min=2, help="At most so many of each case: a first look, and told as such."),
    ] = None,
    tracks: Annotated[
        list[Path] | None,
        typer.Option(help="A real flight (CSV), or a folder of them, as further cases; repeat."),
    ] = None,
    against: Against = None,
    processes: Processes = 2,
    executor: Executor = "processes",
    resume: Resume = False,
) -> None:
    """Run a frozen suite: agents are tuned once and tested in and out of distribution.

    A folder that resumes keeps its agents and takes more. results.json has an object per case
    and agent; a table and a page of them: `kfenv leaderboard`.
    """
    import kfenv  # noqa: F401  (registers the environments)

    from ..contest.suite_run import SuiteRun, run_suite, suitable
    from ..contest.suites import find_suite

    with complaints():
        agents = tuple(agent) if agent else suitable(find_suite(name))
        cases = tuple(case) if case else None
        run = SuiteRun(name, agents, cases, episodes, tuple(tracks or ()), against)
        with progress() as bar:
            task = bar.add_task("agents", total=None)
            results = run_suite(
                run, output, workers(executor, processes), resume,
                started=lambda total: bar.update(task, total=total),
                advance=lambda what: bar.update(task, advance=1, description=f"{what} done"),
            )  # fmt: skip
    for one in dict.fromkeys(result["case"] for result in results):
        chosen = [result for result in results if result["case"] == one]
        count, what = chosen[0]["episodes"], chosen[0]["what"]
        console.print(results_table(chosen, f"{count} episodes of {name}, {one}: {what}"))
    if episodes is not None:
        console.print(f"Shortened to at most {episodes} episodes a case: a first look, no result.")
    if results[0]["recordings"] != run.suite.recordings:
        console.print(
            f"The episodes are not those of version {run.suite.version}: the simulation or "
            "NumPy has changed, and these results compare with no others."
        )
    console.print(f"Results: {output / 'results.json'}")


def leaderboard(
    folders: Annotated[list[Path], typer.Argument(help="Folders that `kfenv suite` wrote.")],
    page: Annotated[
        Path, typer.Option(help="Markdown page whose generated sections are replaced.")
    ],
) -> None:
    """Write the results of suites into a page of tables, and figures into the suites' folders."""
    from ..contest.figures import draw_error_against_cost
    from ..contest.leaderboard import ranked, read_results, write_sections

    with complaints():
        write_sections(page, folders)
        for folder in folders:
            figure = folder / "error-cost.png"
            draw_error_against_cost(ranked(read_results(folder)), figure)
            console.print(f"Figure: {figure}")
    console.print(f"Page: {page}")
