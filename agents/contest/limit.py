"""How good any filter could be: the particle filter, run several times over the same episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contestants.particles.bound import ParticleBound
from ..files import clear_partial, is_free, read_arrays, read_json, write_json, written_whole
from ..jobs.carried import carried
from ..jobs.executor import Workers, run_jobs
from .rollout import draw_episodes, rollout, scenario_and_options

Array = NDArray[np.float64]

BLOCK = 10  # episodes of one job


@dataclass(frozen=True)
class Limit:
    """What is run; equal ones give equal numbers, however they are split.

    Attributes:
        env_id, env_kwargs: the environment; kwargs must be plain JSON values.
        episodes, seed: the test episodes, those that `kfenv evaluate` draws.
        particles: for each episode.
        repeats: runs with other random numbers, whose spread is the Monte Carlo error.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    episodes: int = 100
    seed: int = 0
    particles: int = 256
    repeats: int = 3

    def __post_init__(self) -> None:
        for name, least in (("episodes", 2), ("particles", 2), ("repeats", 2)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}.")

    @property
    def jobs(self) -> list[tuple[int, int]]:
        """Repeat and first episode of each block."""
        return [(r, b) for r in range(self.repeats) for b in range(0, self.episodes, BLOCK)]


def measure_limit(
    limit: Limit,
    output: Path,
    processes: Workers = 2,
    resume: bool = False,
    started: Callable[[int], None] = lambda total: None,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Run the particle filter and write ``limit.json``; each finished block is kept.

    Returns:
        For the median, geometric mean and 95th percentile of the RMSE and for lost tracks:
        mean and standard deviation over the repeats, and the Monte Carlo error of the mean.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        ValueError: if it holds another limit, or the scenario's faults are not known.
    """
    scenario, options = scenario_and_options(limit.env_id, limit.env_kwargs)
    first = draw_episodes(limit.env_id, limit.env_kwargs, "test", limit.seed, 1)
    ParticleBound("particle-bound").check(scenario, options, first)
    _admit(limit, output, resume)
    todo = [job for job in limit.jobs if not _path(output, job).exists()]
    started(len(limit.jobs))
    for _ in range(len(limit.jobs) - len(todo)):
        advance()
    work = partial(_run, replace(limit, env_kwargs=carried(limit.env_kwargs)))
    for job, (rmse, lost) in run_jobs(work, todo, processes):
        with written_whole(_path(output, job)) as file:
            np.savez(file, rmse=rmse, lost=lost)
        advance()
    summary = _summary(limit, output)
    write_json(output / "limit.json", summary)
    return summary


def _admit(limit: Limit, output: Path, resume: bool) -> None:
    """Let a run into its folder, or complain."""
    record = output / "particles.json"
    if not is_free(output) and not resume:
        raise FileExistsError(f"The folder {output} is not empty: name another, or use --resume.")
    remedy = "name another folder for the limit"
    if record.exists() and read_json(record, dict, remedy) != asdict(limit):
        raise ValueError(f"{output} holds another run of kfenv limit: name another folder.")
    (output / "blocks").mkdir(parents=True, exist_ok=True)
    clear_partial(output)
    write_json(record, asdict(limit))


def _path(output: Path, job: tuple[int, int]) -> Path:
    return output / "blocks" / f"repeat{job[0]}-episode{job[1]}.npz"


def _run(limit: Limit, job: tuple[int, int]) -> tuple[Any, Any]:
    import kfenv  # noqa: F401  (registers the environments)

    repeat, begin = job
    place = limit.env_id, limit.env_kwargs
    end = min(begin + BLOCK, limit.episodes)
    episodes = draw_episodes(*place, "test", limit.seed, limit.episodes, (begin, end))
    bound = ParticleBound("particle-bound", particles=limit.particles, seed=repeat)
    scores = rollout(bound, *place, episodes)
    return scores.rmse, scores.lost


def _summary(limit: Limit, output: Path) -> dict[str, Any]:
    rmse, lost = (
        np.array([_joined(limit, output, repeat, name) for repeat in range(limit.repeats)])
        for name in ("rmse", "lost")
    )  # (repeats, episodes)
    figures = {
        "rmse_median": np.median(rmse, axis=1),
        "rmse_geometric_mean": np.exp(np.mean(np.log(rmse), axis=1)),
        "rmse_p95": np.quantile(rmse, 0.95, axis=1),
        "track_loss": np.mean(lost, axis=1),
    }
    return asdict(limit) | {
        name: {
            "mean": float(values.mean()),
            "std": float(values.std(ddof=1)),
            "error": float(values.std(ddof=1) / np.sqrt(limit.repeats)),
        }
        for name, values in figures.items()
    }


def _joined(limit: Limit, output: Path, repeat: int, name: str) -> Array:
    """Of all episodes of one repeat."""
    paths = [_path(output, (repeat, begin)) for begin in range(0, limit.episodes, BLOCK)]
    remedy = "delete it, and --resume computes it again"
    rows = [min(BLOCK, limit.episodes - begin) for begin in range(0, limit.episodes, BLOCK)]
    blocks = [
        read_arrays(path, [name], remedy, count)[name]
        for path, count in zip(paths, rows, strict=True)
    ]
    return np.concatenate([block.reshape(-1) for block in blocks])
