"""The results of a contest as a table."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from .options import is_real_log


def results_table(results: list[dict[str, Any]], where: str = "unseen episodes") -> Table:
    tuned = "difference_to_fixed_tuned" in results[0]
    notes = ["lost: tracks lost, %; ANEES: 1 if consistent, lost tracks left out"]
    if is_real_log(results[0]["env_kwargs"]):
        had, asked = (results[0][key] for key in ("episodes", "episodes_asked"))
        count = f"{had}" if had == asked else f"{had} of {asked} asked"
        where = f"{count} windows of a real log, kept from training and tuning"
        notes.append("windows of one log resemble each other, so intervals are too narrow")
    table = Table(
        "agent", "median", "mean", "std", "p95", "lost", "ANEES", "below fixed, %",
        *(("vs fixed-tuned, m",) if tuned else ()),
        box=SIMPLE_HEAD,
        title=f"Position RMSE on {where}, m (medians with 95 % intervals)",
        caption="; ".join(notes),
    )  # fmt: skip
    for column in table.columns:
        column.no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for r in sorted(results, key=lambda result: result["rmse_median"]):
        better = [100.0 * r[key] for key in ("improvement_over_fixed", "ci_low", "ci_high")]
        row = [
            r["agent"],
            *(_short(r[key]) for key in ("rmse_median", "rmse", "rmse_std", "rmse_p95")),
            f"{100.0 * r['track_loss']:.0f}",
            "-" if r["anees"] is None else "<0.01" if r["anees"] < 0.01 else _short(r["anees"]),
            f"{better[0]:+.0f} ({better[1]:+.0f}, {better[2]:+.0f})",
        ]
        if tuned:
            low, high = r["difference_ci_low"], r["difference_ci_high"]
            middle = r["difference_to_fixed_tuned"]
            row.append(f"{_signed(middle)} ({_signed(low)}, {_signed(high)})")
        table.add_row(*row)
    return table


def _short(number: float) -> str:
    return f"{number:.3g}" if abs(number) < 1000.0 or abs(number) >= 1e5 else f"{number:.0f}"


def _signed(metres: float) -> str:
    return f"{metres:+.0f}" if abs(metres) >= 9.95 else f"{metres:+.1f}"
