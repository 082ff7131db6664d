"""The command that shows all of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..files import is_free
from .console import complaints, console
from .contest import DEFAULT_AGENTS, run_contest
from .options import Resume, Seed
from .training import load_training


def demo(
    output: Annotated[Path, typer.Option(help="New folder for everything it writes.")] = Path(
        "demo"
    ),
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = 5_000_000,
    episodes: Annotated[int, typer.Option(min=2, help="Unseen episodes.")] = 200,
    resume: Resume = False,
) -> None:
    """The whole idea in a few minutes: train an agent, then contest it.

    On kfenv/RadarTracking-v0 at 2 measurements per second, the harder contest.
    """
    env, kwargs = "kfenv/RadarTracking-v0", {"rate": 2.0}
    learned = output / "learned"
    with complaints():
        if not is_free(output) and not resume:
            raise FileExistsError(
                f"The folder {output} is not empty: name another with --output, or go on "
                "with --resume."
            )
        if not (resume and (learned / "policy.npz").exists() and _trained(learned) >= steps):
            console.print(f"Training PPO for {steps:,} steps on random flights and faults ...")
            load_training()(
                env, algorithm="ppo", steps=steps, seed=seed, output=learned, env_kwargs=kwargs,
                resume=resume and (learned / "config.json").exists(),
            )  # fmt: skip
        console.print(f"Contest on {episodes} unseen episodes; every rule is tuned first ...")
        run_contest(
            env, kwargs, (*DEFAULT_AGENTS, str(learned)), episodes, seed, 32, 60,
            output / "evaluation", 2, resume,
        )  # fmt: skip


def _trained(folder: Path) -> int:
    try:
        return int(json.loads((folder / "training.json").read_text())["steps"])
    except (OSError, ValueError, TypeError, KeyError):
        return 0
