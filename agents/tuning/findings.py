"""What is wrong with a filter's noise, in sentences, and what to paste of what is right."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

FACTOR = 1.5  # by which a sensor's told noise may be off without a word
OUTLYING = 0.005  # share of innovations beyond four deviations without a word
ALWAYS, NEVER = 0.5, 0.001  # shares of decisions in which a gate fires
DIGITS = 4  # of numbers to paste


def warnings(report: dict[str, Any]) -> list[str]:
    """Sentences about what a `study.run_study` report shows, each with its remedy."""
    chosen = report["static"][report["by"][0]]["parameters"]
    return [*_of_noise(chosen), *_of_channels(report["channels"]), *_of_rules(report["rules"])]


def _of_noise(parameters: dict[str, Any]) -> Iterator[str]:
    unmoved = [name for name, row in parameters.items() if not row["moved"]]
    if unmoved:
        yield (
            f"No data moved {', '.join(unmoved)}: the log does not tell it, so leave it as it is, "
            "choose a simpler --noise, or give a log that excites it."
        )
    for name, row in parameters.items():
        if not row["moved"]:
            continue
        if row["at_edge"]:
            yield (
                f"{name} lies at the end of its range ({short(row['value'])}): the model lacks "
                "something, or what it stands for hardly matters here."
            )
        elif row["what"] == "deviation" and _off(row):
            yield (
                f"The told deviation of {name.removesuffix('_noise')} is off by a factor of "
                f"{short(row['value'])} ({interval(row)}): tell the filter the new one."
            )


def _off(row: dict[str, Any]) -> bool:
    """Whether a factor is beyond `FACTOR` and its interval leaves one out."""
    low, high = row["low"], row["high"]
    outside = low is not None and high is not None and not low <= 1.0 <= high
    return outside and not 1.0 / FACTOR < row["value"] < FACTOR


def _of_channels(channels: Sequence[dict[str, Any]]) -> Iterator[str]:
    for row in channels:
        if row["biased"]:
            yield (
                f"{row['name']} is biased by {short(row['mean'])} {row['unit']} "
                f"({short(row['mean_low'])} to {short(row['mean_high'])}): look for an offset of "
                "the sensor, its clock or its axes; no noise accounts for it."
            )
        if row["outlying"] > OUTLYING:
            yield (
                f"{100.0 * row['outlying']:.2g} % of {row['name']} lies beyond four deviations: "
                "faults or outliers, which one static noise averages; name a robust rule, such as "
                "--rule huber-gate, or tune --by withheld."
            )


def _of_rules(rules: Sequence[dict[str, Any]]) -> Iterator[str]:
    for rule in rules:
        fired = rule["fired"]
        if fired is not None and not NEVER <= fired <= ALWAYS:
            how = "hardly ever" if fired < NEVER else "nearly always"
            remedy = (
                "it does nothing here, so leave it out" if fired < NEVER
                else "the noise is too low for it, or nothing here is an outlier"
            )  # fmt: skip
            yield (
                f"The gate of {rule['name']} fires {how} ({100.0 * fired:.2g} % of decisions): "
                f"{remedy}."
            )


def lines_to_paste(report: dict[str, Any]) -> list[str]:
    """Python lines of R, and of Q at the log's step, SI units and radians."""
    told = report["matrices"]
    r = ", ".join(f"{v:.{DIGITS}g}" if v == v else "nan" for v in told["R"])
    rows = ",\n              ".join(
        "[" + ", ".join(f"{v:.{DIGITS}g}" for v in row) + "]" for row in told["Q"]
    )
    return [
        f"R = diag([{r}])  # {', '.join(told['channels'])}, squared",
        f"Q = array([{rows}])  # a step of {told['dt']:g} s: {', '.join(told['states'])}",
    ]


def as_yaml(report: dict[str, Any]) -> str:
    """The tuned numbers as YAML: names, and values as JSON, which YAML holds."""
    chosen = report["static"][report["by"][0]]
    lines = [
        f"environment: {json.dumps(report['environment'])}",
        f"options: {json.dumps(report['options'])}",
        f"tuned_by: {report['by'][0]}",
        "# factors on what the filter is told: variance of Q, deviation of R; with 95 % interval",
        "factors:",
        *(
            f"  {json.dumps(name)}: {_number(row['value'])}  # {interval(row)}"
            for name, row in chosen["parameters"].items()
        ),
        *(["rules:"] if report["rules"] else []),
        *(f"  {rule['name']}: {json.dumps(rule['values'])}" for rule in report["rules"]),
        f"# SI units and radians, squared: {', '.join(report['matrices']['channels'])}",
        f"R_diagonal: [{', '.join(map(_number, report['matrices']['R']))}]",
        f"# of a step of {report['matrices']['dt']:g} s: {', '.join(report['matrices']['states'])}",
        "Q:",
        *(f"  - [{', '.join(map(_number, row))}]" for row in report["matrices"]["Q"]),
    ]
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """As YAML reads it: a float needs its point."""
    if value != value:
        return ".nan"
    text = f"{value:.6g}"
    mantissa, e, exponent = text.partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def interval(row: dict[str, Any]) -> str:
    """Of a parameter."""
    if row["low"] is None or row["high"] is None:
        return "not told by the data"
    return f"{short(row['low'])} to {short(row['high'])}"


def short(number: float) -> str:
    """Three digits."""
    return f"{number:.3g}"
