"""The command that tells how far a navigator drifts without fixes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import complaints, console
from .options import Option, Rate, Seed, TuneOn, env_kwargs

ENVIRONMENT = "kfenv/InsGnss-v0"


def outages(
    imu: Annotated[Path, typer.Argument(metavar="IMU", help="Inertial samples, CSV.")],
    gnss: Annotated[Path, typer.Argument(metavar="GNSS", help="Fixes, CSV.")],
    begin: Annotated[float, typer.Option(help="Last fix before the first outage, s.")],
    end: Annotated[float, typer.Option(help="Last fix before the last outage, s.")],
    every: Annotated[float, typer.Option(min=0.1, help="From outage to outage, s.")] = 15.0,
    agent: Annotated[list[str] | None, typer.Option(help="As of `evaluate`; repeat.")] = None,
    tuning_trials: Annotated[
        int, typer.Option(min=0, help="Settings tried per parameter; 0: no tuning.")
    ] = 60,
    tuning_episodes: Annotated[
        int, typer.Option(min=1, help="Outages in the log's first 30 % to tune on.")
    ] = 17,
    tune_on: TuneOn = "error",
    seed: Seed = 0,
    rate: Rate = None,
    option: Option = None,
) -> None:
    """Withhold 15 s of fixes again and again: drift of a real log's navigation, RMS.

    Each outage is a window of its own (25 s long unless told otherwise), which begins with what
    the log before it taught the filter. Errors are distances to the fixes withheld.
    """
    with complaints():
        import kfenv  # noqa: F401  (registers the environments)

        from ..contest.outages import AFTER, outage_errors

        kwargs = {"duration": 25.0} | env_kwargs(rate, None, None, None, option)
        kwargs["log"] = [str(imu.resolve()), str(gnss.resolve())]
        times = np.arange(begin, end + 1e-6, every)
        table = Table("agent", *(f"after {t:g} s" for t in AFTER), box=SIMPLE_HEAD, title=(
            f"{len(times)} outages: horizontal / vertical RMS, m"))  # fmt: skip
        for name in agent or ("fixed",):
            errors = outage_errors(
                ENVIRONMENT, kwargs, name, times, (tuning_trials, tuning_episodes), seed, tune_on
            )
            table.add_row(name, *_cells(errors))
        console.print(table)


def _cells(errors: NDArray[np.float64]) -> list[str]:
    rms = np.sqrt(np.mean(errors**2, axis=0))
    return [f"{horizontal:.2f} / {vertical:.2f}" for horizontal, vertical in rms]
