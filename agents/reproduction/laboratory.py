"""Where an experiment works: its folder, its number of runs, its progress bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.progress import Progress

from ..jobs.executor import Workers
from ..plotting import save
from .monte_carlo import Method, Outcome, Study, run_study


@dataclass(frozen=True)
class Laboratory:
    """What an experiment is given.

    Attributes:
        folder: of this experiment alone; figures go into it, finished runs below it.
        runs: the number that the experiment's main study should make.
        seed: of all recordings.
        processes: so many of this machine, or a cluster's.
        progress: shows a bar for each study.
        almanac: path of a YUMA file for E4, in place of the baseline constellation.
    """

    folder: Path
    runs: int
    seed: int
    processes: Workers
    progress: Progress
    almanac: str | None = None

    def study(
        self,
        key: str,
        scenario: Any,
        methods: Sequence[Method],
        runs: int | None = None,
        **more: Any,
    ) -> tuple[Study, dict[str, Outcome]]:
        """Run a study (or take it from the folder) and return it with its outcomes by label.

        Args:
            key: the study's name.
            runs: by default all of the laboratory's; never more than these.
            more: further fields of `Study`.
        """
        runs = self.runs if runs is None else max(2, min(runs, self.runs))
        study = Study(key, scenario, tuple(methods), runs, self.seed, **more)
        title = f"{self.folder.name}: {key}, {len(methods)} filters"
        task = self.progress.add_task(title, total=runs)
        outcomes = run_study(
            study,
            self.folder / "runs",
            self.processes,
            lambda done: self.progress.update(task, advance=done),
        )
        return study, outcomes

    def save(self, figure: Figure, name: str) -> None:
        """Write a figure into the experiment's folder."""
        save(figure, self.folder / f"{name}.png")
