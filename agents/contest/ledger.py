"""What is finished of some contests, on disk: tunings and blocks of episodes beside the scores."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..files import read_json, write_json
from .scores import REMEDY, Scores, joined, read_values, scores_path, store, write_scores

BLOCK = 100  # episodes: fewer in lock-step cost more time each

Values = dict[str, float]


class Ledger:
    """Keeps the books of contests of the same agents, the first of which tunes them.

    Args:
        sizes: number of episodes of each contest.
        folders: of each.
        names: of the agents, by the name or path that the contests know them by.
    """

    def __init__(
        self, sizes: Sequence[int], folders: Sequence[Path], names: Mapping[str, str]
    ) -> None:
        self._sizes, self._folders, self._names = sizes, folders, names
        self._left: dict[tuple[int, str], int] = {}  # blocks of a contest and agent

    def open_contests(self, agent: str) -> list[int]:
        """Contests without scores of the agent."""
        folders = enumerate(self._folders)
        return [i for i, folder in folders if not scores_path(folder, agent).exists()]

    def values(self, agent: str) -> Values | None:
        """What tuning found for the agent that has been scored; None if it has not."""
        if scores_path(self._folders[0], agent).exists():
            return read_values(self._folders[0], agent)
        return None

    def costs(self, agent: str) -> list[float]:
        """What tuning has been told of the agent's settings so far."""
        path = self._place(0, agent) / "costs.json"
        told = read_json(path, list, REMEDY) if path.exists() else []
        return [np.nan if cost is None else cost for cost in told]

    def keep_costs(self, agent: str, costs: Sequence[float]) -> None:
        """Store what tuning has been told, from which it takes the same course again."""
        self._place(0, agent).mkdir(parents=True, exist_ok=True)
        write_json(self._place(0, agent) / "costs.json", list(costs))

    def missing(self, contest: int, agent: str) -> list[tuple[int, int]]:
        """Begin and end of the blocks that are not there yet."""
        paths = self._paths(contest, agent)
        found = [block for block, path in paths.items() if not path.exists()]
        self._left[contest, agent] = len(found)
        return found

    def keep(
        self, contest: int, agent: str, block: tuple[int, int], values: Values, scores: Scores,
        cost: float | None,
    ) -> bool:  # fmt: skip
        """Store a block; whether it was the last of its contest and agent."""
        store(self._path(contest, agent, block), scores, values, cost)
        self._left[contest, agent] -= 1
        return self._left[contest, agent] == 0

    def close(self, contest: int, agent: str) -> None:
        """Make the scores out of all blocks."""
        paths = list(self._paths(contest, agent).values())
        write_scores(self._folders[contest], agent, *joined(paths))
        self._remove_blocks(contest, agent)

    def tidy(self, agent: str) -> None:
        """Remove blocks of which there are scores: a run died before it could."""
        for contest in set(range(len(self._folders))) - set(self.open_contests(agent)):
            self._remove_blocks(contest, agent)

    def _remove_blocks(self, contest: int, agent: str) -> None:
        place = self._place(contest, agent)
        shutil.rmtree(place, ignore_errors=not place.exists())
        with suppress(OSError):  # of other agents there are blocks
            place.parent.rmdir()

    def _place(self, contest: int, agent: str) -> Path:
        return self._folders[contest] / "blocks" / self._names[agent]

    def _paths(self, contest: int, agent: str) -> dict[tuple[int, int], Path]:
        """The file of each block."""
        size = self._sizes[contest]
        blocks = [(begin, min(begin + BLOCK, size)) for begin in range(0, size, BLOCK)]
        return {block: self._path(contest, agent, block) for block in blocks}

    def _path(self, contest: int, agent: str, block: tuple[int, int]) -> Path:
        return self._place(contest, agent) / f"{block[0]}-{block[1]}.npz"
