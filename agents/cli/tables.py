"""The results of a contest as a table."""

from __future__ import annotations

from collections.abc import Mapping
from math import expm1
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from .options import is_real_log


def results_table(results: list[dict[str, Any]], where: str = "unseen episodes") -> Table:
    """A row per agent, the least median first."""
    against = results[0].get("against")
    notes = [
        "geo.: geometric mean; lost: tracks lost, %; ANEES and NIS of each channel group: 1 if "
        "consistent, lost tracks left out; cost: CPU time, engine predict + update = 1"
    ]
    if against is not None:
        notes.append(f"vs {against}: ratio of the geometric means, paired")
    if is_real_log(results[0]["env_kwargs"]):
        had, asked = (results[0][key] for key in ("episodes", "episodes_asked"))
        count = f"{had}" if had == asked else f"{had} of {asked} asked"
        where = f"{count} windows of a real log, kept from training and tuning"
        notes.append("windows of one log resemble each other, so intervals are too narrow")
    columns = ["agent", "median", "geo.", "p95", "lost", "ANEES", "NIS", "cost",
               "below fixed, %"]  # fmt: skip
    if against is not None:
        columns.append(f"vs {against}, %")
    elif "difference_to_fixed_tuned" in results[0]:
        columns.append("vs fixed-tuned, m")
    title = f"Position RMSE on {where}, m (medians with 95 % intervals)"
    table = Table(*columns, box=SIMPLE_HEAD, title=title, caption="; ".join(notes))
    for column in table.columns:
        column.no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for result in sorted(results, key=lambda result: result["rmse_median"]):
        table.add_row(*_row(result))
    return table


def _row(result: dict[str, Any]) -> list[str]:
    better = [100.0 * result[key] for key in ("improvement_over_fixed", "ci_low", "ci_high")]
    row = [
        result["agent"],
        *(short(result[key]) for key in ("rmse_median", "rmse_geometric_mean", "rmse_p95")),
        f"{100.0 * result['track_loss']:.0f}",
        consistency(result["anees"]),
        nis(result["nis"]),
        "-" if result["cost"] is None else short(result["cost"]),
        f"{better[0]:+.0f} ({better[1]:+.0f}, {better[2]:+.0f})",
    ]
    if "against" in result:
        row.append(ratio(result))
    elif "difference_to_fixed_tuned" in result:
        keys = ("difference_to_fixed_tuned", "difference_ci_low", "difference_ci_high")
        middle, low, high = (_signed(result[key]) for key in keys)
        row.append(f"{middle} ({low}, {high})")
    return row


def short(number: float) -> str:
    """Three digits, or a whole number where that needs more."""
    return f"{number:.3g}" if abs(number) < 1000.0 or abs(number) >= 1e5 else f"{number:.0f}"


def consistency(mean: float | None) -> str:
    """A mean of NEES or NIS per degree of freedom."""
    if mean is None:
        return "-"
    if not 0.01 <= mean <= 999.0:
        return "<0.01" if mean < 0.01 else ">999"
    return f"{mean:.2g}" if mean < 9.95 else f"{mean:.0f}"


def nis(means: Mapping[str, float | None]) -> str:
    """That of each group, or of all channels together where a filter does not tell more."""
    everything, *groups = means.values()
    told = [mean for mean in groups if mean is not None]
    return "/".join(consistency(mean) for mean in (groups if told else [everything]))


def ratio(result: dict[str, Any]) -> str:
    """How much larger the error is than the rival's, in per cent, with its interval."""
    keys = ("log_ratio", "log_ratio_ci_low", "log_ratio_ci_high")
    middle, low, high = (f"{100.0 * expm1(result[key]):+.0f}" for key in keys)
    return f"{middle} ({low}, {high})"


def _signed(metres: float) -> str:
    return f"{metres:+.0f}" if abs(metres) >= 9.95 else f"{metres:+.1f}"
