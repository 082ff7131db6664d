"""The command that trains an agent."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..files import write_json
from .console import complaints, console
from .options import (
    Environment,
    Faults,
    Option,
    Plots,
    Rate,
    ResumeTraining,
    Rinex,
    Seed,
    Track,
    Truth,
    env_kwargs,
    is_real_log,
)
from .tables import results_table

VALIDATION_EPISODES = 100  # at most, on which training's result is scored


def train(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for checkpoint, policy and logs.")],
    algo: Annotated[str, typer.Option(help="'ppo', 'sac', 'recurrent-ppo' or 'taught'.")] = "ppo",
    steps: Annotated[
        int, typer.Option(min=1, help="Environment steps in all (not of taught).")
    ] = 5_000_000,
    seed: Seed = 0,
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
    resume: ResumeTraining = False,
) -> None:
    """Train an agent (needs the extra 'train').

    'ppo' and 'sac' learn from the reward. 'taught' first imitates an agent that knows the true
    noise, and with --refine then follows the gradient of the error through the filter itself: far
    less time for a better result, where episodes carry the truth.
    """
    with complaints():
        kwargs = env_kwargs(rate, faults, track, rinex, option, plots, truth)
        train_agent = load_training()
        if is_real_log(kwargs):  # what would only show at the end
            _check_validation(env, kwargs, seed)
        if algo == "taught":
            lessons = {"teacher": str(distil) if distil else teacher, "world": world,
                       "minutes": refine, "updates": updates, "init": init}  # fmt: skip
            kwargs = _teach(env, kwargs, seed, output, config, resume, units, lessons)
        else:
            train_agent(
                env, algorithm=algo, steps=steps, seed=seed, output=output, env_kwargs=kwargs,
                config_path=config, init=init, resume=resume,
            )  # fmt: skip
        _validate(env, kwargs, seed, output)
    console.print(f"The policy is in {output / 'policy.npz'}; contest it with")
    options = "".join(f" --option '{key}={json.dumps(kwargs[key])}'" for key in kwargs)
    console.print(f"  kfenv evaluate {env}{options} --agent {output} --output {output}-evaluation")


def _teach(
    env: str, kwargs: dict[str, Any], seed: int, output: Path, config: Path | None, resume: bool,
    units: int | None, lessons: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Train by lessons; returns the environment's keywords that the policy works with."""
    from ..learning.teaching.course import Curriculum
    from ..learning.teaching.training import teach

    if lessons["teacher"] == "none":
        lessons["teacher"] = None
    if lessons["init"] is not None:
        lessons["init"] = str(lessons["init"])
    overrides = {} if units is None else {"units": units}
    teach(
        env, Curriculum(**lessons), seed=seed, output=output, env_kwargs=kwargs,
        config_path=config, resume=resume, **overrides,
    )  # fmt: skip
    return kwargs


def _check_validation(env: str, kwargs: dict[str, Any], seed: int) -> None:
    """Complain if a real log has too little for validation."""
    import kfenv  # noqa: F401  (registers the environments)

    from ..contest.evaluation import check_log

    check_log(env, _scored(kwargs), "validation", seed, VALIDATION_EPISODES)


def _scored(kwargs: dict[str, Any]) -> dict[str, Any]:
    """The keywords of training less the reward, which is no matter of scores."""
    return {key: value for key, value in kwargs.items() if key != "reward"}


def _validate(env: str, kwargs: dict[str, Any], seed: int, output: Path) -> None:
    """Score a trained policy on validation episodes: ``results.json`` beside it."""
    from ..contest.evaluation import Contest, evaluate

    policies = (str(output),)
    contest = Contest(env, _scored(kwargs), policies, VALIDATION_EPISODES, seed, 1, 0, "validation")
    folder = output / "validation"
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier, shorter run
    results = evaluate(contest, folder, processes=1)
    write_json(output / "results.json", results)
    console.print(results_table(results, "validation episodes, nothing tuned"))


def load_training() -> Callable[..., Path]:
    """The function that trains; complains if the learning library is not installed."""
    try:
        from ..learning.reinforcement.training import train
    except ImportError as error:
        raise ValueError(str(error)) from None
    return train
