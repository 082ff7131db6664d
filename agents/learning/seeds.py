"""Training with several seeds: independent runs, a folder for each, and what they came to."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..files import clear_partial, goes_on, read_json, write_json, written_whole
from ..jobs.executor import Workers, run_jobs

FIGURES = ("rmse_median", "rmse_geometric_mean", "track_loss", "improvement_over_fixed")
TOLD = "training-seeds.json"

Train = Callable[[int, Path], Any]
Files = dict[str, bytes]


def train_seeds(
    train: Train,
    told: dict[str, Any],
    seeds: Sequence[int],
    output: Path,
    workers: Workers,
    resume: bool,
    advance: Callable[[int], None],
) -> dict[str, Any]:
    """Train with each seed, and write ``seeds.json`` beside the folders ``seed-N``.

    A run works in a folder of its own machine, and its folder appears here when it is done:
    one that was interrupted begins anew.

    Args:
        train: trains with a seed into a new folder, whose ``results.json`` then holds the scores
            on validation episodes, the trained agent's last.
        told: what is trained, in plain JSON; a folder that resumes must hold the same.
        advance: called with each seed that is done.

    Returns:
        For each figure its value for each seed, their median, the least and the greatest.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        ValueError: if it holds other runs, or a seed is given twice.
    """
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"Each seed once, got {', '.join(map(str, seeds))}.")
    _admit(told, output, resume)
    todo = [seed for seed in seeds if not (output / f"seed-{seed}").exists()]
    for seed in seeds:
        if seed not in todo:
            advance(seed)
    for seed, files in run_jobs(partial(_train_away, train), todo, workers):
        _unpack(files, output / f"seed-{seed}")
        advance(seed)
    summary = _summary(seeds, output)
    write_json(output / "seeds.json", summary)
    return summary


def _admit(told: dict[str, Any], output: Path, resume: bool) -> None:
    path = output / TOLD
    if goes_on(output, resume):
        if not path.exists() or read_json(path, dict, "name another folder") != told:
            raise ValueError(f"The folder {output} holds other runs: name another folder.")
    output.mkdir(parents=True, exist_ok=True)
    clear_partial(output)
    write_json(path, told)


def _train_away(train: Train, seed: int) -> Files:
    """Train in a folder that is then deleted, and return what it held."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / f"seed-{seed}"
        try:
            train(seed, folder)
        except KeyboardInterrupt:  # a message of where its checkpoint is would lead nowhere
            raise KeyboardInterrupt from None
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def _unpack(files: Files, folder: Path) -> None:
    """Make the folder with these files, whole or not at all."""
    new = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(new, ignore_errors=True)
    for name, content in files.items():
        path = new / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as file:
            file.write(content)
    new.replace(folder)


def _summary(seeds: Sequence[int], output: Path) -> dict[str, Any]:
    remedy = "delete its folder, and --resume trains it again"
    folders = [output / f"seed-{seed}" for seed in seeds]
    trained = [read_json(folder / "results.json", list, remedy)[-1] for folder in folders]
    summary: dict[str, Any] = {"seeds": list(seeds)}
    for figure in FIGURES:
        values = [float(result[figure]) for result in trained]
        median, least, greatest = (float(f(values)) for f in (np.median, min, max))
        told = {"each": values, "median": median, "least": least, "greatest": greatest}
        summary[figure] = told
    return summary
