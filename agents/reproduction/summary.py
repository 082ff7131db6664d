"""The claims of a finished run as the README shows them; those of the full run are kept here.

To bring both up to date::

    kfenv reproduce all --output DIR
    cp DIR/claims.json agents/reproduction/claims.json
    kfenv claims --readme README.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from ..files import written_whole
from .claims import Claim, row
from .experiments import EXPERIMENTS

KEPT = Path(__file__).with_name("claims.json")
BEGIN, END = "<!-- claims: begin -->", "<!-- claims: end -->"


def read_claims(path: Path) -> list[Claim]:
    """The claims that a run wrote.

    Raises:
        ValueError: if the file holds none.
    """
    try:
        return [Claim(**fields) for fields in json.loads(path.read_text(encoding="utf-8"))]
    except (TypeError, ValueError):
        raise ValueError(
            f"{path} holds no claims: give a folder that `kfenv reproduce` wrote."
        ) from None


def summary(claims: Sequence[Claim]) -> str:
    """A Markdown table of the papers' claims, one a row, and the runs it rests on."""
    rows: dict[tuple[str, str, str], list[Claim]] = {}
    for claim in claims:
        if re.match(r"S\d", claim.printed):  # the others are not the papers'
            label = re.sub(r" \(\w+\)$", "", claim.name)
            rows.setdefault((label, claim.statement, claim.printed), []).append(claim)
    lines = [row("claim", "what the numbers say", "verdict"), "|---|---|---|"]
    for (label, statement, printed), found in rows.items():
        told = "; ".join(f"{_experiment(c)}: {_first_sentence(c.measured)}" for c in found)
        lines.append(row(f"{label}: {statement} ({printed})", told, _verdicts(found)))
    return "\n".join([*lines, "", _runs(claims)])


def _experiment(claim: Claim) -> str:
    """Its name, from ``"C3 (E1)"``, ``"E3 rain"`` or ``"hard: vague prior"``."""
    return re.findall(r"\w+", claim.name)[-1 if claim.name.endswith(")") else 0]


def _first_sentence(text: str) -> str:
    return re.split(r"\. (?=\D)", text, maxsplit=1)[0]


def _verdicts(found: Sequence[Claim]) -> str:
    if len({claim.verdict for claim in found}) == 1:
        return found[0].verdict
    return ", ".join(f"{_experiment(claim)} {claim.verdict}" for claim in found)


def _expected(experiment: str) -> int:
    """Runs of an experiment unless told; of one that there is no more, none."""
    return EXPERIMENTS[experiment].runs if experiment in EXPERIMENTS else 0


def _runs(claims: Sequence[Claim]) -> str:
    runs = {_experiment(claim): claim.runs for claim in claims}
    short = [name for name, count in runs.items() if count < _expected(name)]
    counts = (
        f"{name} {count}" + (f" of {_expected(name)}" if name in short else "")
        for name, count in runs.items()
    )
    seeds = sorted({claim.seed for claim in claims})
    told = f"Runs: {', '.join(counts)}; seed {', '.join(map(str, seeds))}."
    return f"{told} **A short run: more may change verdicts.**" if short else told


def write_summary(claims: Sequence[Claim], readme: Path) -> None:
    """Put the summary between the markers of a README.

    Raises:
        ValueError: if it has not both markers, once and in order.
    """
    head, begin, rest = readme.read_text(encoding="utf-8").partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{readme} has no lines {BEGIN} and {END} for the table to stand between.")
    with written_whole(readme) as file:
        file.write(f"{head}{BEGIN}\n{summary(claims)}\n{END}{tail}".encode())
