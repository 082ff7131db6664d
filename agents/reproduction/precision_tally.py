"""What rounding did to each design, in numbers and as a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from kfenv.filters.results import NOT_POSITIVE_DEFINITE

from ..files import written_whole
from .comparisons import POSITION, SETTLED
from .monte_carlo import Outcome, Study
from .radar_conditioning import onsets

Array = NDArray[np.float64]

HEADER = ("design", "computed in", "lost", "at, s", "not PD", "κ > 1e6", "at, s", "RMSE, m",
          "rounding, m")  # fmt: skip


LOST_BEYOND, LOST_AFTER = 1000.0, 150.0  # m rms, s (SPEC 7.1: a vague prior starts far off)


class Tally(NamedTuple):
    """One design in one precision over the runs of a case."""

    runs: int
    lost: int
    lost_at: float  # s, median of when these were last on track
    rootless: int  # runs that ended since the covariance was not positive definite
    broken: int  # runs whose condition number exceeded `BROKEN`
    broken_at: float  # s, median of those
    rmse: float  # m, mean over the runs kept
    rounding: float  # m, RMS distance of the position from the reference's, both kept


def tally(study: Study, outcome: Outcome, reference: Outcome) -> Tally:
    """Count what was lost, and how far the rest is from the same estimator worked out best."""
    gone, onset = lost(study, outcome), onsets(study, outcome)
    error = outcome.position_error[~gone][:, study.time > SETTLED]
    runs = np.sqrt(np.mean(np.sum(error**2, axis=2), axis=1))
    return Tally(
        len(gone),
        int(gone.sum()),
        _median(_last_on_track(study, outcome)[gone]),
        int(np.sum(outcome.failure == NOT_POSITIVE_DEFINITE)),
        int(np.isfinite(onset).sum()),
        _median(onset),
        float(np.mean(runs)) if len(runs) else float("nan"),
        distance(study, outcome, reference),
    )


def lost(study: Study, outcome: Outcome) -> NDArray[np.bool_]:
    """(N,) whether the filter failed, or is far off late in the run."""
    late = outcome.position_error[:, study.time > LOST_AFTER]
    return ~(np.sqrt(np.mean(np.sum(late**2, axis=2), axis=1)) <= LOST_BEYOND)


def on_track(outcome: Outcome) -> NDArray[np.bool_]:
    """(N, K) whether the position is within `LOST_BEYOND` of the truth."""
    return np.linalg.norm(outcome.position_error, axis=2) <= LOST_BEYOND


def _last_on_track(study: Study, outcome: Outcome) -> Array:
    """(N,) s; the start if never."""
    return np.max(np.where(on_track(outcome), study.time, study.time[0]), axis=1)


def distance(study: Study, one: Outcome, other: Outcome) -> float:
    """RMS distance between estimates of the position in runs that both kept; NaN if none, m."""
    both = ~(lost(study, one) | lost(study, other))
    if not both.any():
        return float("nan")
    apart = (one.error - other.error)[both][:, study.time > SETTLED, POSITION]
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=2))))


def _median(times: Array) -> float:
    happened = times[np.isfinite(times)]
    return float(np.median(happened)) if len(happened) else float("nan")


def table(title: str, rows: Mapping[tuple[str, str], Tally]) -> Table:
    """For the terminal."""
    drawn = Table(*HEADER, box=SIMPLE_HEAD, title=title)
    for column in drawn.columns[2:]:
        column.justify = "right"
    for row in _cells(rows):
        drawn.add_row(*row)
    return drawn


def write_tables(tables: Mapping[str, Mapping[tuple[str, str], Tally]], path: Path) -> None:
    """As markdown, one table a case."""
    lines = []
    for title, rows in tables.items():
        lines += [f"## {title}", "", _line(HEADER), "|" + "---|" * len(HEADER)]
        lines += [*map(_line, _cells(rows)), ""]
    with written_whole(path) as file:
        file.write("\n".join(lines).encode())


def _cells(rows: Mapping[tuple[str, str], Tally]) -> list[tuple[str, ...]]:
    return [
        (
            name, dtype, str(t.lost), _number(t.lost_at), str(t.rootless), str(t.broken),
            _number(t.broken_at), _number(t.rmse), _number(t.rounding),
        )
        for (name, dtype), t in rows.items()
    ]  # fmt: skip


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cells) + " |"
