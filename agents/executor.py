"""Independent jobs, here or in worker processes."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TypeVar

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # of linear algebra

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_jobs(
    function: Callable[[Job], Result], jobs: Sequence[Job], processes: int
) -> Iterator[tuple[Job, Result]]:
    """Yield each job with its result as they come, from worker processes if more than one.

    Function, jobs and results must survive pickling. Where a worker dies (killed, or out of
    memory), what was running is run again, one job at a time. The workers end with this process.

    Raises:
        RuntimeError: if a worker dies of a job again; the others are done by then.
    """
    if processes < 2 or len(jobs) < 2:
        for job in jobs:
            yield job, function(job)
        return
    waiting, interrupted = list(jobs), []
    while waiting:
        yield from _until_one_dies(function, waiting, interrupted, processes)
    lost = []
    for job in interrupted:
        again: list[Job] = []
        yield from _until_one_dies(function, [job], again, 1)
        lost += again
    if lost:
        raise RuntimeError(
            f"The worker process of {', '.join(map(str, lost))} died twice: something killed it, "
            "most likely for want of memory. Take fewer processes or fewer episodes."
        )


def _until_one_dies(
    function: Callable[[Job], Result], waiting: list[Job], interrupted: list[Job], processes: int
) -> Iterator[tuple[Job, Result]]:
    """Use up the waiting jobs; if a worker dies, those that were running become interrupted."""
    running: dict[Future[Result], Job] = {}
    with _workers(processes) as pool:
        try:
            while waiting or running:
                while waiting and len(running) < processes:  # so that each of them is running
                    future = pool.submit(function, waiting[0])
                    running[future] = waiting.pop(0)
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        except BrokenProcessPool:
            interrupted += running.values()


@contextmanager
def _workers(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that end at once when they are left, or when this process ends.

    Fresh ones: a forked one would inherit threads of the progress display. Each keeps to one
    core, so that they do not crowd each other and CPU time counts no idle threads.
    """
    context = get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    with (
        _told_to_children(dict.fromkeys(THREADS, "1")),
        theirs,
        ProcessPoolExecutor(processes, context, _follow, (theirs,)) as pool,
        ours,
    ):
        yield pool


@contextmanager
def _told_to_children(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for the processes that begin meanwhile."""
    former = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in former.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _follow(parent: Connection) -> None:
    """Leave Ctrl-C to the parent, and end when its end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    parent.poll(None)  # nothing is ever sent: the end alone wakes it
    os._exit(1)
