"""The results of a contest as a table."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from ..contest.formatting import (
    consistency,
    cost,
    improvement,
    nis,
    ratio,
    short,
    with_interval,
)
from ..contest.intervals import FEW, FEWEST
from .options import is_real_log


def results_table(results: list[dict[str, Any]], where: str = "unseen episodes") -> Table:
    """A row per agent, the least median first."""
    against = results[0].get("against")
    notes = [
        "geo.: geometric mean; lost: tracks lost, %; ANEES and NIS of each channel group: 1 if "
        "consistent, lost tracks left out; cost: CPU time, engine predict + update = 1"
    ]
    episodes = results[0]["episodes"]
    if episodes < FEWEST:
        notes.append(f"no intervals of fewer than {FEWEST} episodes")
    elif episodes < FEW:
        notes.append(f"intervals of fewer than {FEW} episodes: order statistics and Student's")
    if against is not None:
        notes.append(f"vs {against}: ratio of the geometric means, paired")
    if is_real_log(results[0]["env_kwargs"]):
        had, asked = (results[0][key] for key in ("episodes", "episodes_asked"))
        count = f"{had}" if had == asked else f"{had} of {asked} asked"
        where = f"{count} windows of a real log, kept from training and tuning"
        notes.append("windows of one log resemble each other, so intervals are too narrow")
    unit = results[0].get("unit", "m")
    columns = ["agent", "median", "geo.", "p95", "lost", "ANEES", "NIS", "cost",
               "below fixed, %"]  # fmt: skip
    if against is not None:
        columns.append(f"vs {against}, %")
    elif "difference_to_fixed_tuned" in results[0]:
        columns.append(f"vs fixed-tuned, {unit}")
    what = results[0].get("scored", "Position")
    title = f"{what} RMSE on {where}, {unit} (medians with 95 % intervals)"
    table = Table(*columns, box=SIMPLE_HEAD, title=title, caption="; ".join(notes))
    for column in table.columns:
        column.no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for result in sorted(results, key=lambda result: result["rmse_median"]):
        table.add_row(*_row(result))
    return table


def _row(result: dict[str, Any]) -> list[str]:
    row = [
        result["agent"],
        *(short(result[key]) for key in ("rmse_median", "rmse_geometric_mean", "rmse_p95")),
        f"{100.0 * result['track_loss']:.0f}",
        consistency(result["anees"]),
        nis(result["nis"]),
        cost(result["cost"]),
        improvement(result),
    ]
    if "against" in result:
        row.append(ratio(result))
    elif "difference_to_fixed_tuned" in result:
        keys = ("difference_to_fixed_tuned", "difference_ci_low", "difference_ci_high")
        row.append(with_interval([result[key] for key in keys], _signed))
    return row


def _signed(error: float) -> str:
    if 0.0 < abs(error) < 0.05:
        return f"{error:+.2g}"
    return f"{error:+.0f}" if abs(error) >= 9.95 else f"{error:+.1f}"


def seeds_table(summary: dict[str, Any], where: str) -> Table:
    """A column per seed, and their median: what training with several seeds came to."""
    seeds = summary["seeds"]
    table = Table(
        "of the seeds", "median", *(f"seed {seed}" for seed in seeds), box=SIMPLE_HEAD,
        title=f"{len(seeds)} trainings on {where}",
    )  # fmt: skip
    for figure, told in summary.items():
        if figure != "seeds":
            numbers = (told["median"], *told["each"])
            table.add_row(figure.replace("_", " "), *(f"{number:.3g}" for number in numbers))
    return table
