"""The command that tells what a log says of itself: an inertial and a GNSS file, or plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import complaints, console
from .options import Plots


def inspect(
    imu: Annotated[
        Path | None, typer.Argument(metavar="[IMU", help="Inertial samples, CSV.")
    ] = None,
    gnss: Annotated[Path | None, typer.Argument(metavar="GNSS]", help="Fixes, CSV.")] = None,
    plots: Plots = None,
) -> None:
    """Estimate a real log's clock offset, mounting and errors at rest, with deviations.

    What is to be corrected goes to InsGnss as time_offset=S and mounting=[ROLL,PITCH,YAW]. With
    --plots instead: how often a radar's plots come, what is missing, where and how fast their
    target is, and their noise, measured, beside what the file tells.
    """
    with complaints():
        if plots is not None and imu is None:
            from .plots_table import plots_table

            console.print(plots_table(plots))
            return
        if imu is None or gnss is None or plots is not None:
            raise ValueError("Give an inertial and a GNSS file (IMU GNSS), or --plots FILE.")
        from kfenv.scenarios.inertial.files import read_fixes, read_imu

        console.print(_table(read_imu(imu), read_fixes(gnss)))


def _table(imu, fixes) -> Table:
    from kfenv.scenarios.inertial.measured import at_rest, clock_offset, mounting

    table = Table("measured", "value", "deviation", box=SIMPLE_HEAD)
    offset = clock_offset(imu, fixes)
    if offset is None:
        table.add_row("inertial clock ahead by, s", "not told by the drive", "")
    else:
        table.add_row("inertial clock ahead by, s", *(f"{value:.3f}" for value in offset))
    found = mounting(imu, fixes)
    for name in ("roll", "pitch", "yaw"):
        told = ("not told by the drive", "")
        if found is not None:
            told = tuple(f"{np.degrees(value):.2f}" for value in getattr(found, name))
        table.add_row(f"{name} of the unit in the vehicle, deg", *told)
    if found is not None and found.mirrored:
        table.add_row("fx and fy are mirrored", found.mirrored, "")
    rest = at_rest(imu, fixes)
    if rest is not None:
        table.add_row("at rest for, s", f"{rest.duration:.1f}", "")
        table.add_row("  specific force, m/s^2", f"{rest.force:.3f}", "")
        table.add_row("  gravity there, m/s^2", f"{rest.gravity:.3f}", "")
        rates = ", ".join(f"{value:.3f}" for value in np.degrees(rest.rate))
        table.add_row("  angular rates, deg/s", rates, "")
    return table
