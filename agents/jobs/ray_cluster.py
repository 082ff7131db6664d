"""Jobs on a Ray cluster, by the tasks of Ray, which know when a worker or its machine dies.

Ray's `multiprocessing.Pool` would look more alike, but its actors stay dead once they die, and
what they were at is lost without a word of which job that was.
"""

from __future__ import annotations

import importlib.util
import logging
import os
from collections import deque
from collections.abc import Iterator, MutableSequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from kfenv.kernel_cache import keep_on_this_machine

from .task import THREADS, Task, run_packed

AHEAD = 2  # jobs in hand for each processor: so none waits for the driver, and a cluster may grow


@dataclass(frozen=True)
class RayCluster:
    """Where to run.

    Attributes:
        address: "ray://HOST:PORT", "HOST:PORT" or "auto"; None for RAY_ADDRESS, or else a Ray of
            this command alone on this machine.
        processors: of that one; None for all that the machine has.

    Raises:
        ValueError: if Ray is not installed.
    """

    address: str | None = None
    processors: int | None = None

    def __post_init__(self) -> None:
        if importlib.util.find_spec("ray") is None:
            raise ValueError("Ray is not installed: pip install -e '.[ray]'.")

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Be connected with the cluster; a Ray of this command's own ends with the block.

        Raises:
            ConnectionError: if there is no cluster at the address.
        """
        import ray

        ours = not ray.is_initialized()
        if ours:
            given = self.address or os.environ.get("RAY_ADDRESS")
            alone = {} if given else {"num_cpus": self.processors, "include_dashboard": False}
            ray.init(
                given or "local", logging_level=logging.ERROR, log_to_driver=False,
                runtime_env={"env_vars": dict.fromkeys(THREADS, "1")}, **alone,
            )  # fmt: skip
        try:
            yield
        finally:
            if ours:
                ray.shutdown()


def work_off(
    task: Task, waiting: deque[Any], interrupted: MutableSequence[Any], at_once: int | None
) -> Iterator[tuple[Any, Any]]:
    """Use up the waiting jobs; those whose worker or machine dies become interrupted.

    Args:
        at_once: how many jobs may be in hand; None for as many as suit the cluster's size.
    """
    import ray
    from ray.exceptions import RayError, RayTaskError

    remote = ray.remote(num_cpus=1, max_retries=0)(run_on_node)
    packed, running = ray.put(task.packed()), {}
    try:
        while waiting or running:
            while waiting and len(running) < (at_once or _suitable()):
                job = waiting.popleft()
                running[remote.remote(packed, job)] = job
            [done], _ = ray.wait(list(running), num_returns=1)
            job = running.pop(done)
            try:
                result = ray.get(done)
            except RayTaskError as error:  # the function's own
                raise error.cause or error from None
            except RayError:  # a worker's, a machine's or the network's
                interrupted.append(job)
                continue
            yield job, result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)


def _suitable() -> int:
    """Jobs to have in hand, as large as the cluster is now."""
    import ray

    return max(1, AHEAD * int(ray.cluster_resources().get("CPU", 1)))


def run_on_node(packed: bytes, job: Any) -> Any:
    """What a worker of the cluster does: see `run_packed`."""
    keep_on_this_machine()
    return run_packed(packed, job)
