"""What a worker process does: a function of jobs, which travels to it once."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import cloudpickle

from kfenv.kernel_cache import alone_on_this_machine

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # of linear algebra


class Task:
    """A function of a job, and what is to be done in a process before its first job.

    Args:
        function: of a job.
        prepare: compiles what the function needs; in one process at a time of a machine, so that
            the others find it compiled.
    """

    def __init__(self, function: Callable[[Any], Any], prepare: Callable[[], Any] | None) -> None:
        self.function, self.prepare = function, prepare

    def __call__(self, job: Any) -> Any:
        """The function's result."""
        if self.prepare is not None:
            with alone_on_this_machine():
                self.prepare()
            self.prepare = None
        return self.function(job)

    def packed(self) -> bytes:
        """The task as it travels."""
        return cloudpickle.dumps(self)  # a notebook's functions are not found by their names


def run_packed(packed: bytes, job: Any) -> Any:
    """The result of a packed task, which is unpacked once in a process."""
    return _unpacked(packed)(job)


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> Task:
    return pickle.loads(packed)
