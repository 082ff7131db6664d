"""The command that looks for memory that is not given back."""

from __future__ import annotations

from typing import Annotated

import typer

from .console import complaints, console, progress


def soak(
    minutes: Annotated[float, typer.Option(min=0.0, help="At least five rounds.")] = 60.0,
) -> None:
    """Step vector environments, render and evaluate in a loop; memory must stay flat within 1 %.

    Tells the memory after the warm-up and at the end; the exit code is 1 if it grew by more.
    """
    from ..fuzzing.soak import MOST_GROWTH, WARM_UP, growth
    from ..fuzzing.soak import soak as run

    with complaints(), progress() as bar:
        task = bar.add_task("soaking", total=max(1, round(60.0 * minutes)))
        taken = run(minutes, lambda seconds: bar.update(task, completed=int(seconds)))
        grown = growth(taken)
    warm = taken[int(WARM_UP * len(taken))]
    console.print(
        f"{len(taken)} rounds; {warm / 1e6:.1f} MB after the warm-up, {taken[-1] / 1e6:.1f} MB at "
        f"the end: {100.0 * grown:+.2f} %"
    )
    if grown > MOST_GROWTH:
        raise typer.Exit(1)
