"""The command that measures how good any filter could be."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import complaints, console, progress
from .options import (
    Environment,
    Executor,
    Faults,
    Option,
    Processes,
    Rate,
    Resume,
    Seed,
    Track,
    env_kwargs,
    workers,
)


def limit(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for limit.json and finished blocks.")],
    episodes: Annotated[int, typer.Option(min=2, help="Those that `evaluate` begins with.")] = 100,
    particles: Annotated[int, typer.Option(min=2, help="Filters for each episode.")] = 256,
    repeats: Annotated[
        int, typer.Option(min=2, help="Runs whose spread is the Monte Carlo error.")
    ] = 3,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    option: Option = None,
    processes: Processes = 2,
    executor: Executor = "processes",
    resume: Resume = False,
) -> None:
    """Run the particle filter that knows how the faults are drawn: slow, a limit.

    A Rao-Blackwellised particle filter with the true priors of bursts, glint and misreported
    noise. It does not know how the target manoeuvres, so a filter that guesses that better may
    pass it. More particles come closer to the limit.
    """
    with complaints():
        from ..contest.limit import Limit, measure_limit

        kwargs = env_kwargs(rate, faults, track, None, option)
        chosen = Limit(env, kwargs, episodes, seed, particles, repeats)
        with progress() as bar:
            task = bar.add_task("blocks of episodes", total=None)
            summary = measure_limit(
                chosen, output, workers(executor, processes), resume,
                started=lambda total: bar.update(task, total=total),
                advance=lambda: bar.update(task, advance=1),
            )  # fmt: skip
        console.print(_table(summary))
        console.print(f"Results: {output / 'limit.json'}")


def _table(summary: dict[str, Any]) -> Table:
    table = Table(
        "position RMSE, m", "mean of the runs", "their std", "Monte Carlo error", box=SIMPLE_HEAD,
        title=f"{summary['particles']} particles, {summary['episodes']} unseen episodes, "
        f"{summary['repeats']} runs",
    )  # fmt: skip
    for name, label in (
        ("rmse_median", "median"),
        ("rmse_geometric_mean", "geometric mean"),
        ("rmse_p95", "95th percentile"),
        ("track_loss", "share of lost tracks"),
    ):
        table.add_row(label, *(f"{summary[name][key]:.3g}" for key in ("mean", "std", "error")))
    return table
