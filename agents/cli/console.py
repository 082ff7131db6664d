"""Where commands print: tables, a progress bar, and complaints in one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

# The table of results needs 132 columns; a narrower terminal wraps it, but loses nothing.
console = Console(width=max(Console().width, 132), soft_wrap=True)


@contextmanager
def progress() -> Iterator[Progress]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar


@contextmanager
def complaints() -> Iterator[None]:
    """One sentence instead of a traceback for what the user can mend."""
    from gymnasium.error import Error as GymnasiumError

    try:
        yield
    except KeyboardInterrupt as interrupt:
        message = str(interrupt) or "Interrupted: what was finished is kept; go on with --resume."
        Console(stderr=True).print(message, soft_wrap=True)
        raise typer.Exit(130) from None
    except (ValueError, TypeError, OSError, RuntimeError, GymnasiumError) as error:
        Console(stderr=True).print(f"[red]Error:[/red] {escape(str(error))}", soft_wrap=True)
        raise typer.Exit(2) from None
