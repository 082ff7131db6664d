"""The command that trains an agent."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..files import write_json
from ..jobs.carried import carried
from ..jobs.executor import Workers
from .console import complaints, console, progress
from .options import (
    Environment,
    Executor,
    Faults,
    Option,
    Plots,
    Processes,
    Rate,
    ResumeTraining,
    Rinex,
    Seed,
    Track,
    Truth,
    env_kwargs,
    is_real_log,
    workers,
)
from .tables import results_table, seeds_table

VALIDATION_EPISODES = 100  # at most, on which training's result is scored
VALIDATED = "validation episodes, nothing tuned"


def train(
    env: Environment,
    more: Annotated[list[int] | None, typer.Argument(hidden=True)] = None,
    *,
    output: Annotated[Path, typer.Option(help="New folder for checkpoint, policy and logs.")],
    algo: Annotated[str, typer.Option(help="'ppo', 'sac', 'recurrent-ppo' or 'taught'.")] = "ppo",
    steps: Annotated[
        int, typer.Option(min=1, help="Environment steps in all (not of taught).")
    ] = 5_000_000,
    seed: Seed = 0,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="N ...",
            help="Several seeds, such as 0 1 2 3 4: a folder each, and seeds.json with the median.",
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="TOML file with settings that differ from the defaults.")
    ] = None,
    init: Annotated[
        Path | None,
        typer.Option(
            help="Start from this taught policy, a file or a folder, without more lessons."
        ),
    ] = None,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    plots: Plots = None,
    truth: Truth = None,
    option: Option = None,
    teacher: Annotated[
        str,
        typer.Option(
            help="taught: who gives the lessons, an agent that knows more ('clairvoyant', "
            "'clairvoyant-rq', 'clairvoyant-channels') or any other; 'none' for no lessons."
        ),
    ] = "clairvoyant",
    distil: Annotated[
        Path | None,
        typer.Option(help="taught: a policy as the teacher, to be made smaller by --units."),
    ] = None,
    units: Annotated[
        int | None, typer.Option(min=1, help="taught: width of the network and its memory.")
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            help="taught: a wider world to train in, 'radar' or a TOML file of parts with their "
            "share and the keywords of ENV that differ."
        ),
    ] = None,
    refine: Annotated[
        float,
        typer.Option(min=0.0, help="taught: minutes of gradients through the filter afterwards."),
    ] = 0.0,
    updates: Annotated[
        int | None,
        typer.Option(min=0, help="taught: refine by so many updates instead, to repeat a run."),
    ] = None,
    processes: Processes = 2,
    executor: Executor = "processes",
    resume: ResumeTraining = False,
) -> None:
    """Train an agent (needs the extra 'train').

    'ppo' and 'sac' learn from the reward. 'taught' first imitates an agent that knows the true
    noise, and with --refine then follows the gradient of the error through the filter itself: far
    less time for a better result, where episodes carry the truth.
    """
    with complaints():
        kwargs = env_kwargs(rate, faults, track, rinex, option, plots, truth)
        load_training()
        chosen = _seeds(seeds, more)
        if is_real_log(kwargs):  # what would only show at the end
            _check_validation(env, kwargs, seed)
        lessons = {"teacher": str(distil) if distil else teacher, "world": world,
                   "minutes": refine, "updates": updates,
                   "init": None if init is None else str(init)}  # fmt: skip
        order = {"env": env, "kwargs": kwargs, "algo": algo, "steps": steps, "units": units,
                 "config": None if config is None else str(config), "lessons": lessons}  # fmt: skip
        if chosen:
            return _train_seeds(order, chosen, output, workers(executor, processes), resume)
        console.print(results_table(_train(order, seed, output, seed, resume), VALIDATED))
    console.print(f"The policy is in {output / 'policy.npz'}; contest it with")
    options = "".join(f" --option '{key}={json.dumps(kwargs[key])}'" for key in kwargs)
    console.print(f"  kfenv evaluate {env}{options} --agent {output} --output {output}-evaluation")


def _seeds(first: str | None, more: list[int] | None) -> list[int]:
    """The numbers of --seeds, of which the command line takes the later ones for arguments."""
    if first is None:
        if more:
            raise ValueError(f"Unexpected arguments: {more}. Several seeds are named by --seeds.")
        return []
    if not first.isdecimal():
        raise ValueError(f"--seeds takes whole numbers, got {first!r}.")
    return [int(first), *(more or [])]


def _policy_file(name: Any) -> Any:
    """A policy's file, also if it is named by its folder; what names no policy is left alone."""
    file = Path(name or "", "policy.npz")
    return str(file) if name is not None and file.is_file() else name


def _train_seeds(
    order: dict[str, Any], seeds: list[int], output: Path, where: Workers, resume: bool
) -> None:
    """Train with each seed, and print what they came to."""
    from ..learning.seeds import train_seeds

    lessons = order["lessons"]
    policies = {key: _policy_file(lessons[key]) for key in ("teacher", "init")}
    away = carried(order | {"lessons": lessons | policies})
    work = partial(_train_quietly, away, seeds[0])
    with progress() as bar:
        task = bar.add_task("seeds", total=len(seeds))
        summary = train_seeds(
            work, order, seeds, output, where, resume,
            lambda seed: bar.update(task, advance=1, description=f"seed {seed} done"),
        )  # fmt: skip
    console.print(seeds_table(summary, VALIDATED))
    console.print(f"Results: {output / 'seeds.json'}")


def _train_quietly(order: dict[str, Any], validation_seed: int, seed: int, output: Path) -> None:
    _train(order, seed, output, validation_seed, shown=False)


def _train(
    order: dict[str, Any], seed: int, output: Path, validation_seed: int, resume: bool = False,
    shown: bool = True,
) -> list[dict[str, Any]]:  # fmt: skip
    """Train as ordered, and return the scores on validation episodes."""
    common = {"seed": seed, "output": output, "env_kwargs": order["kwargs"], "resume": resume,
              "config_path": order["config"], "progress": shown}  # fmt: skip
    if order["algo"] == "taught":
        _teach(order, common)
    else:
        load_training()(
            order["env"], algorithm=order["algo"], steps=order["steps"],
            init=order["lessons"]["init"], **common,
        )  # fmt: skip
    return _validate(order["env"], order["kwargs"], validation_seed, output)


def _teach(order: dict[str, Any], common: dict[str, Any]) -> None:
    """Train by lessons."""
    from ..learning.teaching.course import Curriculum
    from ..learning.teaching.training import teach

    lessons = dict(order["lessons"])
    if lessons["teacher"] == "none":
        lessons["teacher"] = None
    overrides = {} if order["units"] is None else {"units": order["units"]}
    teach(order["env"], Curriculum(**lessons), **common, **overrides)


def _check_validation(env: str, kwargs: dict[str, Any], seed: int) -> None:
    """Complain if a real log has too little for validation."""
    import kfenv  # noqa: F401  (registers the environments)

    from ..contest.evaluation import check_log

    check_log(env, _scored(kwargs), "validation", seed, VALIDATION_EPISODES)


def _scored(kwargs: dict[str, Any]) -> dict[str, Any]:
    """The keywords of training less the reward, which is no matter of scores."""
    return {key: value for key, value in kwargs.items() if key != "reward"}


def _validate(env: str, kwargs: dict[str, Any], seed: int, output: Path) -> list[dict[str, Any]]:
    """Score a trained policy on validation episodes: ``results.json`` beside it."""
    from ..contest.evaluation import Contest, evaluate

    policies = (str(output),)
    contest = Contest(env, _scored(kwargs), policies, VALIDATION_EPISODES, seed, 1, 0, "validation")
    folder = output / "validation"
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier, shorter run
    results = evaluate(contest, folder, processes=1)
    write_json(output / "results.json", results)
    return results


def load_training() -> Callable[..., Path]:
    """The function that trains; complains if the learning library is not installed."""
    try:
        from ..learning.reinforcement.training import train
    except ImportError as error:
        raise ValueError(str(error)) from None
    return train
