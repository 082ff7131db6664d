"""The command that shows all of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..files import is_free
from .console import complaints, console
from .contest import run_contest
from .options import ResumeTraining, Seed
from .training import load_training

RIVALS = (
    "innovation-fading", "huber-gate", "innovation-noise", "pooled-noise", "hmm-turn", "hmm-2q",
    "clairvoyant", "learned", "learned-small",
)  # fmt: skip
TUNING_EPISODES, TUNING_TRIALS = 32, 20
SHORT = {"units": 32, "episodes": 384, "rounds": 2, "epochs": 8, "tuning_trials": 8}
UPDATES = 30  # through the filter: a small network's first half minute


def demo(
    output: Annotated[Path, typer.Option(help="New folder for everything it writes.")] = Path(
        "demo"
    ),
    seed: Seed = 0,
    episodes: Annotated[int, typer.Option(min=2, help="Unseen episodes.")] = 200,
    resume: ResumeTraining = False,
) -> None:
    """The whole idea in a few minutes: the agents that come with kfenv, then one of your own.

    On kfenv/RadarTracking-v0 at 2 measurements per second. First a contest of the trained agents
    with fixed, rule-based and clairvoyant filters, every rule tuned; then a small agent is taught,
    and joins it.
    """
    env, kwargs = "kfenv/RadarTracking-v0", {"rate": 2.0}
    taught, evaluation = output / "taught", output / "evaluation"
    with complaints():
        if not is_free(output) and not resume:
            raise FileExistsError(
                f"The folder {output} is not empty: name another with --output, or go on "
                "with --resume."
            )
        load_training()  # complains before the contest if there is nothing to train with
        if not (resume and (evaluation / "results.json").exists()):
            console.print(f"Contest on {episodes} unseen episodes; every rule is tuned first ...")
            _contest(env, kwargs, RIVALS, episodes, seed, evaluation, resume)
        if not (resume and _is_taught(taught)):
            console.print("Teaching a small agent on random flights and faults ...")
            _teach(env, kwargs, seed, taught, resume and (taught / "config.json").exists())
        console.print("The same contest with it ...")
        _contest(env, kwargs, (*RIVALS, str(taught)), episodes, seed, evaluation, True)


def _contest(
    env: str, kwargs: dict[str, float], agents: tuple[str, ...], episodes: int, seed: int,
    output: Path, resume: bool,
) -> None:  # fmt: skip
    run_contest(
        env, kwargs, agents, episodes, seed, TUNING_EPISODES, TUNING_TRIALS, output, 2, resume
    )


def _teach(env: str, kwargs: dict[str, float], seed: int, output: Path, resume: bool) -> None:
    from ..learning.teaching.course import Curriculum
    from ..learning.teaching.training import teach

    teach(
        env, Curriculum(updates=UPDATES), seed=seed, output=output, env_kwargs=kwargs,
        resume=resume, **SHORT,
    )  # fmt: skip


def _is_taught(folder: Path) -> bool:
    try:
        return bool(json.loads((folder / "training.json").read_text())["finished"])
    except (OSError, ValueError, TypeError, KeyError):
        return False
