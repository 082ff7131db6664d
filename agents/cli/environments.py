"""The command that lists the environments."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import console


def envs() -> None:
    """List the environments."""
    import gymnasium

    import kfenv

    table = Table("id", "what", "observes", "knobs", "rate", "episode", box=SIMPLE_HEAD)
    for env_id in kfenv.ENVIRONMENTS:
        env = gymnasium.make(env_id).unwrapped
        table.add_row(
            env_id,
            type(env).__doc__.splitlines()[0],
            str(env.observation_space.shape[0]),
            str(env.action_space.shape[0]),
            f"{env.scenario.rate:g} Hz",
            f"{env.scenario.duration:g} s",
        )
    console.print(table)
    console.print("Their pages: python -c \"import gymnasium, kfenv; "
                  "help(type(gymnasium.make('kfenv/RadarTracking-v0').unwrapped))\"")  # fmt: skip
