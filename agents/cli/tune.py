"""The command that tunes a filter's noise to a log, and tells what its innovations say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from .console import complaints, console, progress
from .options import (
    Environment,
    Faults,
    Option,
    Plots,
    Rate,
    Resume,
    Rinex,
    Seed,
    Track,
    Truth,
    env_kwargs,
)


def tune(
    env: Environment,
    output: Annotated[Path, typer.Option(help="New folder for report, YAML and figures.")],
    by: Annotated[
        list[str] | None,
        typer.Option(
            metavar="likelihood|withheld|consistency|error",
            help="What the noise is chosen by; repeat to compare, the first is reported. "
            "likelihood (default): of the filter's innovations. withheld: it foresees measurements "
            "that it never gets. consistency: NIS at one and white innovations. error: of the "
            "position, where the truth is known.",
        ),
    ] = None,
    noise: Annotated[
        str,
        typer.Option(
            metavar="groups|sources|channels|full",
            help="groups: a factor on Q and on each channel group's deviation, as the knobs are. "
            "sources: one on each part of Q that is independent of the others (an axis, a clock). "
            "channels: one on each channel's deviation besides. full: a whole Q, which takes "
            "minutes and a long log.",
        ),
    ] = "groups",
    rule: Annotated[
        list[str] | None,
        typer.Option(help="Tune this rule's gates and windows as well, e.g. huber-gate; repeat."),
    ] = None,
    trials: Annotated[
        int, typer.Option(min=1, help="Settings that a rule tries per parameter.")
    ] = 40,
    episodes: Annotated[
        int, typer.Option(min=1, help="Windows (or drawn episodes) to tune on.")
    ] = 32,
    test_episodes: Annotated[
        int, typer.Option(min=1, help="Others, kept from tuning, that the report looks at.")
    ] = 100,
    seed: Seed = 0,
    rate: Rate = None,
    faults: Faults = None,
    track: Track = None,
    rinex: Rinex = None,
    plots: Plots = None,
    truth: Truth = None,
    option: Option = None,
    resume: Resume = False,
) -> None:
    """A log in, numbers out: Q and R by maximum likelihood or otherwise, with intervals.

    Needs no truth. The first 30 % of a real log are tuned on, and the report looks at its last
    half. Q is always part of it: where noise of measurements alone may change, likelihood reads
    manoeuvres as noise. A likelihood also takes faults (jamming, outliers) for noise of
    all times; 'withheld' bears outliers, but says little of how large Q and R are together.

    The table tells each factor on what the filter is told (variance of Q, deviation of R), with a
    95 % interval from blocks of the log; then each channel's innovations in its own unit:
    mean, deviation, NIS (1 if the noise is right) with its chi-square bounds, correlation from one
    arrival to the next (0 if nothing is left to foresee). 'report.json' has all of it with
    histograms and quantiles, 'noise.yaml' the numbers, and two figures show them.

    Example: kfenv tune kfenv/InsGnss-v0 --option 'log=["imu.csv","gnss.csv"]' --output tuned
    """
    with complaints():
        import kfenv  # noqa: F401  (registers the environments)

        from ..files import written_whole
        from ..tuning.figures import draw_study
        from ..tuning.findings import as_yaml
        from ..tuning.study import Study, run_study

        study = Study(
            env, env_kwargs(rate, faults, track, rinex, option, plots, truth),
            tuple(by or ("likelihood",)), noise, tuple(rule or ()), trials, episodes,
            test_episodes, seed,
        )  # fmt: skip
        with progress() as bar:
            task = bar.add_task("tuning", total=None)
            report = run_study(
                study, output, resume,
                lambda job: bar.update(task, description=job.replace("-", " by ", 1)),
                lambda: bar.update(task, advance=1),
            )  # fmt: skip
            bar.update(task, description="done", total=bar.tasks[task].completed)
        with written_whole(output / "noise.yaml") as file:
            file.write(as_yaml(report).encode())
        _tell(report)
        for path in draw_study(report, output):
            console.print(f"Figure: {path}")
        console.print(f"Numbers: {output / 'noise.yaml'}, {output / 'report.json'}")


def _tell(report: dict[str, Any]) -> None:
    """Tables, warnings, and lines to paste."""
    from ..tuning.findings import lines_to_paste, warnings

    console.print(_noise_table(report))
    console.print(_scores_table(report))
    if report["rules"]:
        console.print(_rules_table(report))
    console.print(_channels_table(report))
    for sentence in warnings(report):
        console.print(f"[yellow]Warning:[/yellow] {sentence}")
    console.print("To paste (SI units, radians):")
    for line in lines_to_paste(report):
        console.print(f"  {line}", markup=False, highlight=False)


def _noise_table(report: dict[str, Any]) -> Table:
    from ..tuning.findings import interval, short

    told = report["static"][report["by"][0]]["parameters"]
    table = Table(
        "factor on", *report["by"], box=SIMPLE_HEAD, caption=f"intervals: {report['intervals']}",
        title="Static noise: factors on Q's variance and on R's deviations, 95 % intervals",
    )  # fmt: skip
    for name in told:
        rows = [report["static"][by]["parameters"][name] for by in report["by"]]
        table.add_row(name, *(f"{short(row['value'])} ({interval(row)})" for row in rows))
    return table


def _scores_table(report: dict[str, Any]) -> Table:
    windows = report["windows"]["test"]
    table = Table(
        "noise", "NIS " + "/".join(report["nominal"]["nis"]), "RMSE median, m",
        "RMSE geo. mean, m", box=SIMPLE_HEAD, title=f"On {windows} windows kept from tuning",
    )  # fmt: skip
    for name, row in {"as told": report["nominal"], **report["static"]}.items():
        nis = "/".join("-" if value is None else f"{value:.2g}" for value in row["nis"].values())
        error = (_cell(row.get(key)) for key in ("rmse_median", "rmse_geometric_mean"))
        table.add_row(name, nis, *error)
    return table


def _cell(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.4g}"


def _rules_table(report: dict[str, Any]) -> Table:
    table = Table(
        "rule", "parameter", "value", "95 % of resampled logs", "gate fires, %", box=SIMPLE_HEAD,
        title="Gates and windows",
    )  # fmt: skip
    for rule in report["rules"]:
        fired = "" if rule["fired"] is None else f"{100.0 * rule['fired']:.3g}"
        for name, value in rule["values"].items():
            between = f"{rule['low'][name]:.3g} to {rule['high'][name]:.3g}"
            table.add_row(rule["name"], name, f"{value:.3g}", between, fired)
    return table


def _channels_table(report: dict[str, Any]) -> Table:
    table = Table(
        "channel", "unit", "arrived", "mean (95 %)", "deviation", "expected", "NIS (chi-square)",
        "next correlation", box=SIMPLE_HEAD, title="Innovations there, static noise as tuned by "
        f"{report['by'][0]}", caption="correlation: beyond its bound something is left to foresee",
    )  # fmt: skip
    for row in report["channels"]:
        table.add_row(
            row["name"], row["unit"], str(row["count"]),
            f"{row['mean']:.3g} ({row['mean_low']:.3g} to {row['mean_high']:.3g})",
            f"{row['deviation']:.3g}", f"{row['expected']:.3g}",
            f"{row['nis']:.2f} ({row['nis_low']:.2f} to {row['nis_high']:.2f})",
            f"{row['lags'][0]:+.3f} (bound {row['lag_bound']:.3f})",
        )  # fmt: skip
    return table
