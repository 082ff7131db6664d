"""kfenv's engine beside other libraries' filters: one model, one run, one core.

The libraries go into a virtual environment of their own, on top of the one that runs this. Each
filter then waits in a process of its own (`kfenv.agents.library_filters`), and they run in turn,
so that a drift of the machine's speed meets all; what counts is processor time.
"""

from __future__ import annotations

import json
import os
import site
import subprocess
import tempfile
import venv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kfenv.models.namespaces import scalar
from kfenv.scenarios.radar.tracking import RadarTracking

EPISODES, DURATION = 256, 10.0  # s
ROUNDS = 5

# One core for all: JAX and the linear algebra beneath NumPy would else take more
ONE_CORE = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
}  # fmt: skip


class Rival(NamedTuple):
    """A filter of a library: its task's name, what is to be installed, and what it is."""

    task: str
    packages: tuple[str, ...]
    what: str


RIVALS = (
    Rival("engine_together", (), f"kfenv's engine, {EPISODES} filters in lock-step"),
    Rival("engine_alone", (), "kfenv's engine, one filter"),
    Rival("filterpy", ("filterpy",), "FilterPy, UnscentedKalmanFilter"),
    Rival("stone_soup", ("stonesoup",), "Stone Soup, UnscentedKalmanPredictor and Updater"),
    Rival("kalman_py", ("kalman-py",), "kalman-py, UnscentedKalmanFilter on NumPy"),
    Rival("kalman_py_jax", ("kalman-py", "jax"), "kalman-py, the same on JAX"),
    Rival("turbo_ckf", ("turbo-ckf",), "turbo-ckf, TurboCKF"),
    Rival("dynamax_alone", ("dynamax",), "dynamax on JAX, unscented, one filter"),
    Rival("dynamax_together", ("dynamax",), f"dynamax on JAX, {EPISODES} filters (vmap)"),
)


class Row(NamedTuple):
    """A line of the table: what, its version, steps/s, how many times kfenv's, and its error."""

    what: str
    version: str
    speed: str
    ratio: str
    error: str


class Waiting(NamedTuple):
    """A process that runs its filter whenever it is asked to."""

    process: subprocess.Popen
    steps: int
    error: float

    def seconds(self) -> float:
        """Run once."""
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())


def compare(
    advance: Callable[[str], None] = lambda what: None, rivals: Sequence[Rival] = RIVALS
) -> list[Row]:
    """Install what is missing, run all in turn, and tell the best speed of each.

    Args:
        advance: is told what goes on.
        rivals: the first is what the others are compared with.
    """
    with tempfile.TemporaryDirectory() as folder:
        advance("the libraries' environment")
        python = environment(Path(folder) / "environment")
        problem = Path(folder) / "problem.npz"
        np.savez(problem, **radar_problem())
        waiting, told = {}, {}
        for rival in rivals:
            advance(rival.what)
            try:
                install(python, rival.packages)
                waiting[rival.task] = _started(python, rival.task, problem)
            except RuntimeError as error:
                told[rival.task] = str(error)
        speeds = _speeds(waiting, advance)
        versions = {rival.task: _version(python, rival) for rival in rivals}
    first = speeds.get(rivals[0].task)
    return [
        _row(rival, versions[rival.task], speeds.get(rival.task), first, waiting, told)
        for rival in rivals
    ]


def environment(folder: Path) -> Path:
    """Make a virtual environment that sees this one's packages beside its own; its Python."""
    venv.create(folder, with_pip=True, symlinks=os.name != "nt")
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    own = subprocess.run(
        [python, "-c", "import site; print(site.getsitepackages()[0])"],
        check=True, capture_output=True, text=True,
    ).stdout.strip()  # fmt: skip
    beneath = "".join(f"import site; site.addsitedir({p!r})\n" for p in site.getsitepackages())
    (Path(own) / "beneath.pth").write_text(beneath)
    return python


def install(python: Path, packages: Sequence[str]) -> None:
    """Install packages from the package index.

    Raises:
        RuntimeError: telling why it cannot be.
    """
    if not packages:
        return
    command = [python, "-m", "pip", "install", "--quiet", "--upgrade", *packages]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        why = lines[-1].removeprefix("ERROR: ") if lines else "pip failed"
        raise RuntimeError(f"not installed: {why}")


def radar_problem() -> dict[str, np.ndarray]:
    """Flights before the phased array without faults, with the noise of their first instants.

    See `library_filters.Problem`.
    """
    scenario = RadarTracking(duration=DURATION, faults="none")
    recording = scenario.sample([np.random.default_rng(i) for i in range(EPISODES)])
    dt, factor = 1.0 / scenario.rate, np.zeros((9, 9))
    start = recording.mean[0].tolist()
    entries = scenario.motion.build(scalar).noise_factor(start, (), dt)
    for place, entry in zip(scenario.motion.noise_pattern, entries, strict=True):
        factor[place] = entry
    return {
        "z": recording.measurement, "truth": recording.truth, "mean": recording.mean,
        "P": recording.factor[0] @ recording.factor[0].T, "Q": factor @ factor.T,
        "R": np.diag(recording.noise[0, 0] ** 2), "dt": np.array(dt),
    }  # fmt: skip


def _started(python: Path, task: str, problem: Path) -> Waiting:
    """A process that has run its filter once, and so compiled it.

    Raises:
        RuntimeError: telling why it has not.
    """
    process = subprocess.Popen(
        [python, "-m", f"{__package__}.library_filters", task, str(problem)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | ONE_CORE, preexec_fn=_stay_on_one_core,
    )  # fmt: skip
    told = process.stdout.readline()
    if not told:
        lines = process.communicate()[1].strip().splitlines()
        raise RuntimeError(f"does not run: {lines[-1] if lines else 'no word of why'}")
    return Waiting(process, **json.loads(told))


def _stay_on_one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _speeds(waiting: dict[str, Waiting], advance: Callable[[str], None]) -> dict[str, float]:
    """The most steps a second of processor time of each; ends the processes."""
    shortest = dict.fromkeys(waiting, np.inf)
    for number in range(ROUNDS):
        advance(f"round {number + 1} of {ROUNDS}")
        for task, one in waiting.items():
            shortest[task] = min(shortest[task], one.seconds())
    for one in waiting.values():
        one.process.communicate()
    return {task: waiting[task].steps / shortest[task] for task in waiting}


def _version(python: Path, rival: Rival) -> str:
    """What was installed, e.g. ``filterpy 1.4.5``."""
    ask = f"from importlib.metadata import version as v; print(*map(v, {rival.packages!r}))"
    done = subprocess.run([python, "-c", ask], capture_output=True, text=True)
    return ", ".join(done.stdout.split())


def _row(
    rival: Rival, version: str, speed: float | None, first: float | None,
    waiting: dict[str, Waiting], told: dict[str, str],
) -> Row:  # fmt: skip
    if speed is None:
        return Row(rival.what, version, told[rival.task], "", "")
    ratio = f"1/{first / speed:,.0f}" if first and first >= 1.5 * speed else ""
    return Row(rival.what, version, f"{speed:,.0f}", ratio, f"{waiting[rival.task].error:.3f} m")
