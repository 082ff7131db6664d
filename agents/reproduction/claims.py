"""The papers' claims: what was printed, what was measured, and whether it holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from ..files import write_json, written_whole

Array = NDArray[np.float64]

HOLDS = "holds"
OTHER_REASON = "holds for another reason"
FAILS = "does not hold"
VERDICTS = (HOLDS, OTHER_REASON, FAILS)


@dataclass(frozen=True)
class Claim:
    """One row of a claims table.

    Attributes:
        name: as in the specification, with the experiment, e.g. ``"C3 (E1)"``.
        statement: the claim in a few words.
        printed: paper and place; S0 De Vivo et al. 2017, S1 De Vivo et al. 2016,
            S3 Lazarov et al., S4 Benzerrouk et al. 2014.
        measured: the numbers with their spread; the first sentence stands alone in the README.
        verdict: one of `VERDICTS`, decided by the numbers.
        runs, seed: of the experiment; given when it is done.
    """

    name: str
    statement: str
    printed: str
    measured: str
    verdict: str
    runs: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            kind = int if isinstance(field.default, int) else str
            if type(getattr(self, field.name)) is not kind:
                raise TypeError(f"{field.name} of a claim must be {kind.__name__}")
        if not re.search(r"\w", self.name):
            raise ValueError(f"a claim's name holds no word: {self.name!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict must be one of {', '.join(VERDICTS)}; got {self.verdict!r}.")


def judge(holds: bool, reason_holds: bool = True) -> str:
    """The verdict on a claim and on the reason that was given for it."""
    if not holds:
        return FAILS
    return HOLDS if reason_holds else OTHER_REASON


def write_claims(claims: Sequence[Claim], folder: Path) -> None:
    """Write ``claims.json`` and ``claims.md``."""
    write_json(folder / "claims.json", [asdict(claim) for claim in claims])
    lines = [row("claim", "printed in", "measured", "verdict"), "|---|---|---|---|"]
    for claim in claims:
        name = f"{claim.name}: {claim.statement}"
        lines.append(row(name, claim.printed, claim.measured, claim.verdict))
    with written_whole(folder / "claims.md") as file:
        file.write(("\n".join(lines) + "\n").encode())


def row(*cells: str) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def claims_table(claims: Sequence[Claim]) -> Table:
    """The claims for the terminal."""
    table = Table("claim", "printed in", "measured", "verdict", box=SIMPLE_HEAD, show_lines=True)
    colours = {HOLDS: "green", OTHER_REASON: "yellow", FAILS: "red"}
    for claim in claims:
        verdict = f"[{colours[claim.verdict]}]{claim.verdict}[/]"
        table.add_row(f"{claim.name}: {claim.statement}", claim.printed, claim.measured, verdict)
    return table


def mean_and_interval(values: Array) -> tuple[float, float, float]:
    """Mean of independent values and the ends of its 95 % interval (Student's t).

    Only of the finite ones: NaN and infinity stand for runs that a filter lost, whose number
    a claim must tell besides (`with_interval` does) or count in its verdict.
    """
    from scipy.stats import t

    values = values[np.isfinite(values)]
    if len(values) < 2:
        return float("nan"), float("nan"), float("nan")
    half = t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean()), float(values.mean() - half), float(values.mean() + half)


def too_few(values: Array, threshold: float) -> str:
    """What to add where the mean's interval leaves open on which side of a threshold it lies."""
    _, low, high = mean_and_interval(values)
    open_ended = not (high < threshold or low > threshold)
    return "; too few runs to tell" if open_ended and not high - low <= threshold else ""


def with_interval(values: Array, unit: str = "m") -> str:
    """Mean with its 95 % interval, and how many lost runs it leaves out, for a table."""
    lost = int(np.sum(~np.isfinite(values)))
    without = f" without {lost} of {len(values)} runs, lost" if lost else ""
    mean, low, high = map(digits, mean_and_interval(values))
    return f"{mean} ({low} to {high}) {unit}{without}"


def digits(value: float) -> str:
    """Three significant digits, or all that stand before the point, for a table."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"
