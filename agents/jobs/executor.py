"""Independent jobs: here, in worker processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from .ray_cluster import RayCluster, work_off
from .task import THREADS, Task, run_packed

Job = TypeVar("Job")
Result = TypeVar("Result")
Workers = int | RayCluster  # so many processes of this machine, or those of a cluster


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: Workers,
    prepare: Callable[[], Any] | None = None,
) -> Iterator[tuple[Job, Result]]:
    """Yield each job with its result as they come, from worker processes if more than one.

    Function, jobs and results must survive pickling. Where a worker dies (killed, out of
    memory, or with its machine), what was running is run again, one job at a time. The workers
    end with this process.

    Args:
        jobs: a deque is used up, and what is added to it meanwhile is run as well.
        workers: how many processes, or a cluster.
        prepare: called in each worker before its first job, in one at a time on each machine:
            what it compiles is compiled once.

    Raises:
        RuntimeError: if a worker dies of a job again; the others are done by then.
    """
    growing = isinstance(jobs, deque)
    waiting = jobs if growing else deque(jobs)
    if workers == 1 or (isinstance(workers, int) and not growing and len(jobs) < 2):
        while waiting:
            job = waiting.popleft()
            yield job, function(job)
        return
    task = Task(function, prepare)
    if isinstance(workers, RayCluster):
        with workers.connected():
            yield from _run(work_off, task, waiting, None)
    else:
        yield from _run(_until_one_dies, task, waiting, workers)


def _run(
    rounds: Callable[..., Iterator[tuple[Job, Result]]],
    task: Task,
    waiting: deque[Job],
    at_once: int | None,
) -> Iterator[tuple[Job, Result]]:
    """Work off what waits; then what was interrupted, each alone; both again while there is any."""
    interrupted: list[Job] = []
    lost: list[Job] = []
    while waiting or interrupted:
        if waiting:
            yield from rounds(task, waiting, interrupted, at_once)
        else:
            yield from rounds(task, deque([interrupted.pop(0)]), lost, 1)
    if lost:
        raise RuntimeError(
            f"The worker process of {', '.join(map(str, lost))} died twice: something killed it, "
            "most likely for want of memory. Take fewer processes or fewer episodes."
        )


def _until_one_dies(
    task: Task, waiting: deque[Job], interrupted: MutableSequence[Job], processes: int
) -> Iterator[tuple[Job, Result]]:
    """Use up the waiting jobs; if a worker dies, those that were running become interrupted."""
    running: dict[Future[Result], Job] = {}
    with _workers(task.packed(), processes) as pool:
        try:
            while waiting or running:
                while waiting and len(running) < processes:  # so that each of them is running
                    future = pool.submit(_run_job, waiting[0])
                    running[future] = waiting.popleft()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
        except BrokenProcessPool:
            interrupted += running.values()


@contextmanager
def _workers(packed: bytes, processes: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that end at once when they are left, or when this process ends.

    Fresh ones: a forked one would inherit threads of the progress display. Each keeps to one
    core, so that they do not crowd each other and CPU time counts no idle threads.
    """
    context = get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    with (
        _told_to_children(dict.fromkeys(THREADS, "1")),
        theirs,
        ProcessPoolExecutor(processes, context, _begin, (theirs, packed)) as pool,
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


_packed = b""  # in a worker process its task


def _begin(parent: Connection, packed: bytes) -> None:
    """Leave Ctrl-C to the parent, and end when its end of the pipe is closed."""
    global _packed
    _packed = packed
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _run_job(job: Any) -> Any:
    return run_packed(_packed, job)


def _end_with(parent: Connection) -> None:
    parent.poll(None)  # nothing is ever sent: the end alone wakes it
    os._exit(1)
