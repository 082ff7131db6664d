"""What a contestant achieved, in memory and on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contestants.registry import make_agent
from ..files import read_arrays, written_whole

Array = NDArray[np.float64]
STORED = ("rmse", "lost", "nees", "nis", "seconds")
REMEDY = "delete it, and --resume scores the agent again"


@dataclass(frozen=True)
class Scores:
    """What a contestant achieved on N episodes.

    Attributes:
        rmse: (N,) position RMSE over the whole episode, m; a lost track counts the loss
            distance for every remaining instant.
        lost: (N,) whether the track was lost.
        nees: (N,) mean position NEES per degree of freedom until the end or the loss; NaN
            where a covariance on the way was not positive definite.
        nis: (N, 1 + G) of the updates until then: the mean NIS per channel that arrived; then,
            for each group of channels, the mean of nu^2 / S. NaN where nothing arrived, and in
            the groups where a filter does not tell.
        seconds: CPU time of filtering and deciding, without scoring.
        time: (D,) end of each decision, s, if traced; every instant of a recording filter.
        error: (D, N) position error then, m, if traced.
        factors: (D, N, K) all knobs' factors, if traced.
        off: (D, N, 3) estimated less true position then, m, if traced.
    """

    rmse: Array
    lost: NDArray[np.bool_]
    nees: Array
    nis: Array
    seconds: float
    time: Array | None = None
    error: Array | None = None
    factors: Array | None = None
    off: Array | None = None


def scores_path(output: Path, name: str) -> Path:
    """Where a contest's folder holds the scores of an agent, given by name or path."""
    return output / "scores" / f"{make_agent(name).name}.npz"


def write_scores(
    output: Path, name: str, scores: Scores, values: dict[str, float], cost: float | None
) -> None:
    """Store an agent's scores, the parameters that it had, and its relative cost."""
    store(scores_path(output, name), scores, values, cost)


def store(path: Path, scores: Scores, values: dict[str, float], cost: float | None) -> None:
    """Write scores into a file, see `write_scores`."""
    path.parent.mkdir(exist_ok=True, parents=True)
    with written_whole(path) as file:
        np.savez(
            file, **{field: getattr(scores, field) for field in STORED},
            cost=np.nan if cost is None else cost,
            parameters=list(values), values=list(values.values()),
        )  # fmt: skip


def read_scores(output: Path, name: str, episodes: int | None = None) -> Scores:
    """The stored scores of an agent.

    Args:
        episodes: that they must be of.

    Raises:
        ValueError: if the file is damaged, or of another number of episodes.
    """
    *arrays, seconds = read_arrays(scores_path(output, name), STORED, REMEDY).values()
    for field, array in zip(STORED, arrays, strict=False):
        if array.shape[:1] != (episodes or len(arrays[0]),):
            raise ValueError(
                f"{scores_path(output, name)} holds {field} of shape {array.shape} where "
                f"{episodes} episodes were expected: {REMEDY}."
            )
    return Scores(*arrays, float(seconds))


def joined(paths: Sequence[Path]) -> tuple[Scores, dict[str, float], float | None]:
    """The scores in the files of an agent's blocks, one after the other; parameters; cost.

    Raises:
        ValueError: if a file is damaged.
    """
    blocks = [read_arrays(path, STORED, REMEDY) for path in paths]
    arrays = [np.concatenate([block[field] for block in blocks]) for field in STORED[:-1]]
    seconds = float(sum(block["seconds"] for block in blocks))
    first = read_arrays(paths[0], ("parameters", "values", "cost"), REMEDY)
    return Scores(*arrays, seconds), _values(first), _cost(first)


def read_values(output: Path, name: str) -> dict[str, float]:
    """The parameters that an agent was scored with."""
    return _values(read_arrays(scores_path(output, name), ("parameters", "values"), REMEDY))


def read_cost(output: Path, name: str) -> float | None:
    """An agent's CPU time relative to the bare engine's, if it was measured."""
    return _cost(read_arrays(scores_path(output, name), ("cost",), REMEDY))


def _values(stored: Mapping[str, NDArray[Any]]) -> dict[str, float]:
    return dict(zip(stored["parameters"].tolist(), stored["values"].tolist(), strict=True))


def _cost(stored: Mapping[str, NDArray[Any]]) -> float | None:
    return None if np.isnan(stored["cost"]) else float(stored["cost"])
