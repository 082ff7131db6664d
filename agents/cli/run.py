"""The command that filters a whole log and writes what the filter says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from ..files import is_free, write_json
from .console import complaints, console
from .options import (
    Environment,
    Faults,
    Log,
    Option,
    Plots,
    Rate,
    Rinex,
    Seed,
    Track,
    Truth,
    env_kwargs,
    is_real_log,
)

if TYPE_CHECKING:
    from ..running.estimates import Estimates

SHORT = 20.0  # s


def run(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for the files.")],
    agent: Annotated[
        str, typer.Option(help="As of `evaluate`: a name, a filter, the path of a policy.")
    ] = "fixed",
    value: Annotated[
        list[str] | None,
        typer.Option(help="KEY=NUMBER, a parameter of the agent; repeat."),
    ] = None,
    tuned: Annotated[
        Path | None,
        typer.Option(
            help="Folder of an `evaluate` or a `tune` whose parameters the agent takes; static "
            "noise of `tune` is for the agent fixed-tuned."
        ),
    ] = None,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    plots: Plots = None,
    truth: Truth = None,
    rinex: Rinex = None,
    log: Log = None,
    option: Option = None,
    every_step: Annotated[
        bool,
        typer.Option("--every-step", help="A row for every filter step, not only where a "
                     "measurement is due."),
    ] = False,
) -> None:  # fmt: skip
    """Filter a whole log once with an agent: the estimate as a table, on maps and in a figure.

    Writes estimate.csv (time, states, deviations, knobs, NIS, and the error where the truth is
    told), map.png, run.json, and track.geojson and track.kml where positions have a place on
    Earth. Without a log it filters the first episode that `evaluate` tests on with that seed.
    """
    with complaints():
        kwargs = env_kwargs(rate, faults, track, rinex, option, plots, truth, log)
        if is_real_log(kwargs):  # a short log has room for no window, and needs none
            kwargs.setdefault("duration", SHORT)
        _run(env, kwargs, agent, _values(value, tuned, agent), seed, output, every_step)


def _run(
    env: str, kwargs: dict[str, Any], agent: str, values: dict[str, float], seed: int,
    output: Path, every_step: bool,
) -> None:  # fmt: skip
    import kfenv  # noqa: F401  (registers the environments)

    from ..running.filtering import filtered
    from ..running.geography import geodetic_tracks, write_geojson, write_kml
    from ..running.map_figure import draw_map, draw_series
    from ..running.table import write_table

    if not is_free(output):
        raise FileExistsError(f"The folder {output} is not empty: name another with --output.")
    result = filtered(env, kwargs, agent, values, seed)
    if not len(result.mean):
        raise ValueError(f"There is nothing to write. {' '.join(result.ended)}")
    output.mkdir(parents=True, exist_ok=True)
    rows = np.arange(len(result.mean)) if every_step else result.due
    write_table(result, rows, output / "estimate.csv")
    draw = draw_map if result.has_position else draw_series
    draw(result, rows, f"{env}, {agent}", output / "map.png")
    tracks = geodetic_tracks(result, result.due)
    if tracks:
        write_geojson(tracks, output / "track.geojson")
        write_kml(tracks, output / "track.kml")
    told = result.summary() | {"rows": len(rows), "values": values, "seed": seed}
    write_json(output / "run.json", {"env": env, "env_kwargs": kwargs, "agent": agent} | told)
    console.print(_sentence(told))
    for said in _endings(result):
        console.print(f"[yellow]Note:[/yellow] {said}")
    for path in sorted(output.iterdir()):
        console.print(f"  {path}")


def _sentence(told: dict[str, Any]) -> str:
    error = told["rmse"]
    known = "" if error is None else f", RMSE {error:.4g} {told['unit']}"
    return (
        f"{told['seconds']:.5g} s, {told['instants']} filter steps, {told['measurements']} with a "
        f"measurement, NIS {told['nis']:.3g} a channel (1 is consistent){known}."
    )


def _endings(result: Estimates) -> list[str]:
    """Why and when the filter stopped, and where it began anew."""
    begins = result.time[np.flatnonzero(np.diff(result.stretch)) + 1]
    anew = [f"It began anew at t = {time:.10g} s." for time in begins]
    anew += ["The files hold what there was."] * (len(result.ended) - len(anew))
    return [f"{said} {then}" for said, then in zip(result.ended, anew, strict=False)]


def _values(value: list[str] | None, tuned: Path | None, agent: str) -> dict[str, float]:
    """Parameters that were tuned, and those given over them."""
    from ..running.parameters import tuned_values

    values = {} if tuned is None else tuned_values(tuned, agent)
    for item in value or ():
        key, _, number = item.partition("=")
        try:
            values[key] = float(number)
        except ValueError:
            raise ValueError(f"--value {item!r} is not of the form KEY=NUMBER.") from None
    return values
