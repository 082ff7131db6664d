"""The command that contests agents."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..jobs.executor import Workers
from .console import complaints, console, progress
from .options import (
    Against,
    Environment,
    Executor,
    Faults,
    Option,
    Plots,
    Processes,
    Rate,
    Resume,
    Rinex,
    Seed,
    Track,
    Truth,
    TuneOn,
    env_kwargs,
    is_real_log,
    workers,
)
from .tables import results_table

DEFAULT_AGENTS = (
    "innovation-fading", "innovation-fading-printed", "huber-gate", "innovation-noise",
    "pooled-noise", "hmm-noise", "hmm-turn", "clairvoyant", "clairvoyant-rq", "random",
)  # fmt: skip


def evaluate(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for results and figures.")],
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="An agent, a fixed filter, or the path of a trained policy (NAME=PATH names it); "
            "repeat."
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=2, help="Unseen episodes.")] = 200,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    plots: Plots = None,
    truth: Truth = None,
    option: Option = None,
    tuning_episodes: Annotated[
        int,
        typer.Option(min=1, help="Episodes that parameters are tuned on, none tested."),
    ] = 32,
    tuning_trials: Annotated[
        int, typer.Option(min=0, help="Settings tried per parameter; 0: no tuning.")
    ] = 60,
    tune_on: TuneOn = "error",
    against: Against = None,
    processes: Processes = 2,
    executor: Executor = "processes",
    resume: Resume = False,
) -> None:
    """Contest agents on the same unseen episodes: table, figures, results.json.

    Agents: fixed, fixed-tuned, innovation-fading, innovation-fading-printed, huber-gate,
    innovation-noise, pooled-noise, hmm-noise, hmm-turn, clairvoyant, clairvoyant-rq, random.
    Without --agent all of them take part (but the clairvoyant ones in a real log, whose noise
    nobody knows). To name as well: nis-gate, student-t, correntropy, strong-tracking,
    sage-husa, vb-noise; and in GnssTracking, for single satellites, raim, satellite-gate,
    satellite-hmm, clairvoyant-channels.
    """
    with complaints():
        kwargs = env_kwargs(rate, faults, track, rinex, option, plots, truth)
        run_contest(
            env, kwargs, tuple(agent or _default_agents(kwargs)), episodes, seed, tuning_episodes,
            tuning_trials, output, workers(executor, processes), resume, against, tune_on,
        )  # fmt: skip


def run_contest(
    env: str, kwargs: dict[str, Any], agents: tuple[str, ...], episodes: int, seed: int,
    tuning_episodes: int, tuning_trials: int, output: Path, processes: Workers, resume: bool,
    against: str | None = None, tune_on: str = "error",
) -> None:  # fmt: skip
    """Evaluate agents, print the table and draw the figures."""
    import kfenv  # noqa: F401  (registers the environments)

    from ..contest.evaluation import Contest, evaluate
    from ..contest.figures import draw_contest

    contest = Contest(
        env, kwargs, agents, episodes, seed, tuning_episodes, tuning_trials, against=against,
        tune_on=tune_on,
    )  # fmt: skip
    with progress() as bar:
        task = bar.add_task("agents", total=None)
        results = evaluate(
            contest, output, processes, resume,
            started=lambda total: bar.update(task, total=total),
            advance=lambda name: bar.update(task, advance=1, description=f"{name} done"),
        )  # fmt: skip
    console.print(results_table(results))
    for path in draw_contest(contest, results, output):
        console.print(f"Figure: {path}")
    console.print(f"Results: {output / 'results.json'}")


def _default_agents(kwargs: dict[str, Any]) -> tuple[str, ...]:
    log = is_real_log(kwargs)
    return tuple(name for name in DEFAULT_AGENTS if not (log and "clairvoyant" in name))
