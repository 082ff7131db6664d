"""What a contestant achieved, in memory and on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..contestants.registry import make_agent
from ..files import blamed_on, read_arrays, written_whole

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
    return _stored(scores_path(output, name), episodes)


def joined(paths: Sequence[Path]) -> tuple[Scores, dict[str, float], float | None]:
    """The scores in the files of an agent's blocks, one after the other; parameters; cost.

    Raises:
        ValueError: if a file is damaged.
    """
    blocks = [_stored(path) for path in paths]
    arrays = [np.concatenate([getattr(one, field) for one in blocks]) for field in STORED[:-1]]
    seconds = sum(block.seconds for block in blocks)
    return Scores(*arrays, seconds), _values(paths[0]), _cost(paths[0])


def _stored(path: Path, episodes: int | None = None) -> Scores:
    """The scores in a file, which must be numbers of the kind and shape that they have."""
    fields = STORED[:-1]
    arrays = read_arrays(path, fields, REMEDY, episodes)
    with blamed_on(path, REMEDY):
        rows = len(arrays["rmse"])
    arrays = read_arrays(path, fields, REMEDY, rows)
    with blamed_on(path, REMEDY):
        for field, array in arrays.items():
            kind = bool if field == "lost" else float
            arrays[field] = array.reshape((rows, -1) if field == "nis" else rows).astype(kind)
        return Scores(**arrays, seconds=float(read_arrays(path, STORED[-1:], REMEDY)["seconds"]))


def read_values(output: Path, name: str) -> dict[str, float]:
    """The parameters that an agent was scored with."""
    return _values(scores_path(output, name))


def read_cost(output: Path, name: str) -> float | None:
    """An agent's CPU time relative to the bare engine's, if it was measured."""
    return _cost(scores_path(output, name))


def _values(path: Path) -> dict[str, float]:
    names, values = read_arrays(path, ("parameters", "values"), REMEDY).values()
    with blamed_on(path, REMEDY):
        pairs = zip(names.tolist(), values.tolist(), strict=True)
        return {str(name): float(value) for name, value in pairs}


def _cost(path: Path) -> float | None:
    [cost] = read_arrays(path, ("cost",), REMEDY).values()
    with blamed_on(path, REMEDY):
        return None if np.isnan(float(cost)) else float(cost)
