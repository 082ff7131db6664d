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
    Rate,
    Resume,
    Rinex,
    Seed,
    Track,
    env_kwargs,
    is_real_log,
)
from .tables import results_table

VALIDATION_EPISODES = 100  # at most, on which training's result is scored


def train(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for checkpoint, policy and logs.")],
    algo: Annotated[str, typer.Option(help="'ppo', 'sac' or 'recurrent-ppo'.")] = "ppo",
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = 5_000_000,
    seed: Seed = 0,
    config: Annotated[
        Path | None, typer.Option(help="TOML file with settings that differ from the defaults.")
    ] = None,
    init: Annotated[
        Path | None, typer.Option(help="Start from this taught policy, a file or a folder.")
    ] = None,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    option: Option = None,
    resume: Resume = False,
) -> None:
    """Train an agent (needs the extra 'train')."""
    with complaints():
        kwargs = env_kwargs(rate, faults, track, rinex, option)
        train_agent = load_training()
        if is_real_log(kwargs):  # what would only show at the end
            _check_validation(env, kwargs, seed)
        train_agent(
            env, algorithm=algo, steps=steps, seed=seed, output=output, env_kwargs=kwargs,
            config_path=config, init=init, resume=resume,
        )  # fmt: skip
        _validate(env, kwargs, seed, output)
    console.print(f"The policy is in {output / 'policy.npz'}; contest it with")
    options = "".join(f" --option '{key}={json.dumps(kwargs[key])}'" for key in kwargs)
    console.print(f"  kfenv evaluate {env}{options} --agent {output} --output {output}-evaluation")


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
        from ..learning.training import train
    except ImportError as error:
        raise ValueError(str(error)) from None
    return train
