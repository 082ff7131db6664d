"""The decision process on several cores of the machine: a part of the filters for each thread.

Compiled code leaves Python to the other threads, and no filter sees another: the bits are those
of one `Core` for all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.models.namespaces.lanes import LANES
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SHARED = (
    "scenario", "options", "knobs", "knob_place", "yardstick", "interval", "observation_size",
    "feature_names",
)  # fmt: skip


class ThreadedCore:
    """What a vector environment needs of a `Core`, from one for each thread.

    Args:
        make: a core of so many filters.
        batch: B.
        threads: at most so many, and none with less than a block of the engine.
    """

    def __init__(self, make: Callable[[int], Core], batch: int, threads: int) -> None:
        blocks = -(-batch // LANES)
        parts = min(threads, blocks)
        ends = [min(batch, LANES * (blocks * (i + 1) // parts)) for i in range(parts)]
        self._parts = [slice(*pair) for pair in zip([0, *ends[:-1]], ends, strict=True)]
        self._cores = [make(part.stop - part.start) for part in self._parts]
        self.batch = batch
        for name in SHARED:
            setattr(self, name, getattr(self._cores[0], name))

    def place(self, chosen: NDArray[np.int64], recording: Recording) -> None:
        """See `Core.place`."""
        for core, begin, own in self._own(chosen):
            core.place(chosen[own] - begin, recording[own])

    def open(self, chosen: NDArray[np.int64]) -> None:
        """See `Core.open`."""
        for core, begin, own in self._own(chosen):
            core.open(chosen[own] - begin)

    def _own(self, chosen: NDArray[np.int64]) -> Iterator[tuple[Core, int, NDArray[np.int64]]]:
        """Each core that has some of the chosen, its first place, and which of them they are."""
        for core, part in zip(self._cores, self._parts, strict=True):
            own = np.flatnonzero((part.start <= chosen) & (chosen < part.stop))
            if len(own):
                yield core, part.start, own

    def step(self, action: Array, running: Mask) -> tuple[Array, Mask, Mask]:
        """See `Core.step`."""
        told = self._together(lambda core, part: core.step(action[part], running[part]))
        return tuple(map(np.concatenate, zip(*told, strict=True)))

    def observation(self) -> NDArray[np.float32]:
        """See `Core.observation`."""
        return np.concatenate(self._together(lambda core, part: core.observation()))

    def _together(self, work: Callable[[Core, slice], Any]) -> list[Any]:
        """What each core's work gives: the first one's in this thread, the others' beside it."""
        first, *others = zip(self._cores, self._parts, strict=True)
        waiting = [self._pool.submit(work, *other) for other in others]
        return [work(*first), *(future.result() for future in waiting)]

    def information(self) -> dict[str, Any]:
        """See `Core.information`."""
        told = [core.information() for core in self._cores]
        return {key: np.concatenate([part[key] for part in told]) for key in told[0]}

    @property
    def factors(self) -> Array:
        """See `Core.factors`; a copy."""
        return np.concatenate([core.factors for core in self._cores])

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(max(1, len(self._cores) - 1), "kfenv")

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_pool"}
