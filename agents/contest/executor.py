"""Independent jobs, here or in worker processes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from multiprocessing import get_context
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    function: Callable[[Job], Result], jobs: Sequence[Job], processes: int
) -> Iterator[tuple[Job, Result]]:
    """Yield each job with its result as they come, from worker processes if more than one.

    Function, jobs and results must survive pickling.
    """
    if processes < 2 or len(jobs) < 2:
        for job in jobs:
            yield job, function(job)
        return
    # Fresh processes: a forked one would inherit threads of the progress display. They
    # leave Ctrl-C to this one, which ends them on its way out.
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with get_context("spawn").Pool(processes, signal.signal, ignore) as pool:
        yield from pool.imap_unordered(partial(_with_job, function), jobs)


def _with_job(function: Callable[[Job], Result], job: Job) -> tuple[Job, Result]:
    return job, function(job)
