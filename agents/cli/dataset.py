"""The command that records episodes for learners that only watch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import complaints, console, progress
from .options import (
    Environment,
    Executor,
    Faults,
    Option,
    Processes,
    Rate,
    Rinex,
    Seed,
    Track,
    env_kwargs,
    workers,
)


def dataset(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder, for MINARI_DATASETS_PATH.")],
    agent: Annotated[
        str, typer.Option(help="Whose actions: an agent of `evaluate`, no fixed filter.")
    ] = "clairvoyant",
    episodes: Annotated[int, typer.Option(min=1, help="Those of training.")] = 1000,
    tuned: Annotated[
        Path | None,
        typer.Option(help="Folder of a contest whose tuned parameters the agent takes."),
    ] = None,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    option: Option = None,
    processes: Processes = 2,
    executor: Executor = "processes",
) -> None:
    """Record what an agent sees, does and earns as a Minari dataset, for offline learners.

    The environment has the knobs that the agent turns; episode i is that of reset(seed=seed + i),
    which no contest tests on.
    """
    with complaints():
        import kfenv  # noqa: F401  (registers the environments)

        from ..contest.dataset import Order, write_dataset

        kwargs = env_kwargs(rate, faults, track, rinex, option)
        order = Order(env, kwargs, agent, episodes, seed)
        with progress() as bar:
            task = bar.add_task("episodes", total=episodes)
            name = write_dataset(
                order, output, workers(executor, processes), tuned,
                lambda done: bar.update(task, advance=done),
            )  # fmt: skip
    console.print(f"MINARI_DATASETS_PATH={output} holds {name}: minari.load_dataset({name!r})")
