"""The progress bar of a training run."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


class TrainingProgress:
    """Steps, speed, mean return and reward, and the time left; nothing without a terminal."""

    def __init__(
        self, title: str, total: int, done: int = 0, shown: bool = True, unit: str = "steps"
    ) -> None:
        console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:,} of {task.total:,} " + unit),
            TextColumn("{task.fields[figures]}"),
            TimeRemainingColumn(),
            console=console,
            disable=not (shown and console.is_terminal),
        )
        self._task = self._progress.add_task(title, total=total, completed=done, figures="")
        self._done, self._start = done, time.monotonic()
        self._latest = done

    def __enter__(self) -> TrainingProgress:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def advance(self, steps: int) -> None:
        """Move the bar to `steps`."""
        self._latest = steps
        self._progress.update(self._task, completed=steps)

    def retotal(self, total: int) -> None:
        """Set how much there is to do, once it is known."""
        self._progress.update(self._task, total=total)

    def show(self, mean_return: float | None, mean_reward: float) -> None:
        """Show the latest figures beside the bar."""
        rate = (self._latest - self._done) / (time.monotonic() - self._start)
        shown_return = "" if mean_return is None else f"  return {mean_return:.4g}"
        figures = f"{rate:,.0f} steps/s{shown_return}  reward {mean_reward:.3g}"
        self.note(figures)

    def note(self, figures: str) -> None:
        """Show these beside the bar."""
        self._progress.update(self._task, figures=figures)
