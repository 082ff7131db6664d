"""Arguments that commands share, and the keywords of an environment that they make up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from kfenv.names import unknown

from ..jobs.executor import Workers
from ..jobs.ray_cluster import RayCluster

Environment = Annotated[str, typer.Argument(metavar="ENV", help="An id that `kfenv envs` lists.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same result.")]
Rate = Annotated[
    float | None,
    typer.Option(help="Measurements per second; of InsGnss the inertial samples, not the fixes."),
]
Faults = Annotated[
    str | None,
    typer.Option(
        help="'random', 'paper', 'none', a JSON object, or another name that ENV's page tells."
    ),
]
Track = Annotated[
    Path | None,
    typer.Option(help="A real flight as the truth: CSV with t, lat, lon, alt_m or alt_ft."),
]
Rinex = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        metavar="OBS NAV",
        help="A real GNSS log: RINEX 2 or 3 observation and navigation file. Of a receiver that "
        "moved: --option moving=true, or with its truth "
        '--option \'rinex=["OBS","NAV","TRUTH"]\'. '
        "It is cut into windows: the first 30 % of its time for training and "
        "tuning, 20 % for validation, the last half for the test, without overlap.",
    ),
]
Plots = Annotated[
    Path | None,
    typer.Option(
        help="Real plots of a target: CSV with t and what ENV's page tells, for a radar range_m, "
        "azimuth_deg, elevation_deg. Cut into windows as with --rinex.",
    ),
]
Truth = Annotated[
    Path | None,
    typer.Option(
        help="The true track beside --plots: CSV with t, x_m, y_m, z_m, or a flight as --track "
        "takes (then --option radar_position=[LAT,LON,HEIGHT] too)."
    ),
]
Log = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        metavar="IMU GNSS",
        help="A real inertial log: samples and fixes, CSV (fixes also RTKLIB's .pos).",
    ),
]
Option = Annotated[
    list[str] | None,
    typer.Option("--option", help="KEY=VALUE, any other keyword of ENV, value in JSON."),
]
TuneOn = Annotated[
    str,
    typer.Option(
        metavar="error|likelihood|consistency|withheld|axes",
        help="What tuning makes small. error: of the position, which needs the truth. axes: of "
        "horizontal and vertical error alike, so that none is bought by the other. The others need "
        "no truth: likelihood of the next innovation, with the knobs held; consistency, NIS and "
        "whiteness of the same; withheld, the error of foreseeing one to three measurements kept "
        "from the filter. By likelihood alone, noise that is tuned without the process noise reads "
        "manoeuvres as noise: name agents that have process_noise among their parameters.",
    ),
]
Against = Annotated[
    str | None,
    typer.Option(help="A rival to compare every agent with, episode by episode: a name or path."),
]
Resume = Annotated[bool, typer.Option(help="Go on with what is in the output folder.")]
ResumeTraining = Annotated[
    bool,
    typer.Option(
        help="Go on with the run in the output folder. Only with one of your own: checkpoints of "
        "ppo and sac are pickles, and reading them runs the code that they hold."
    ),
]


Processes = Annotated[int, typer.Option(min=1, help="Worker processes of this machine.")]
Executor = Annotated[
    str,
    typer.Option(
        metavar="WHERE",
        help="'processes' of this machine, or 'ray' (the cluster of RAY_ADDRESS, else a Ray of "
        "so many --processes here), 'auto' (one that runs here), or an address: ray://HOST:PORT.",
    ),
]


def workers(executor: str, processes: int) -> Workers:
    """Who works: so many processes, or a cluster."""
    if executor == "processes":
        return processes
    if executor not in ("ray", "auto") and ":" not in executor:
        raise ValueError(
            unknown("executor", executor, ("processes", "ray", "auto", "ray://HOST:PORT"))
        )
    return RayCluster(None if executor == "ray" else executor, processes)


def env_kwargs(
    rate: float | None, faults: str | None, track: Path | None, rinex: tuple[Path, Path] | None,
    option: list[str] | None, plots: Path | None = None, truth: Path | None = None,
    log: tuple[Path, Path] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The environment's keywords; complains of an option that is no KEY=VALUE."""
    kwargs: dict[str, Any] = {}
    for item in option or ():
        key, equals, value = item.partition("=")
        if not equals:
            raise ValueError(f"--option {item!r} is not of the form KEY=VALUE.")
        kwargs[key] = json_or_text(value)
    if rate is not None:
        kwargs["rate"] = rate
    if faults is not None:
        kwargs["faults"] = json_or_text(faults)
    if track is not None:
        kwargs["track"] = str(track.resolve())
    if rinex is not None:
        kwargs["rinex"] = [str(path.resolve()) for path in rinex]
    if log is not None:
        kwargs["log"] = [str(path.resolve()) for path in log]
    if truth is not None and plots is None:
        raise ValueError("--truth goes with --plots: give the plots too.")
    if plots is not None:
        kwargs["plots"] = [str(path.resolve()) for path in (plots, truth) if path is not None]
    return kwargs


def json_or_text(value: str) -> Any:
    try:
        return json.loads(value)
    except json.JSONDecodeError:
        return value


def is_real_log(kwargs: dict[str, Any]) -> bool:
    """Whether the episodes are windows of a real log."""
    return any(kwargs.get(name) is not None for name in ("rinex", "log", "plots"))
