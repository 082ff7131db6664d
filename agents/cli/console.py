"""Where commands print: tables, a progress bar, and complaints in one sentence."""

from __future__ import annotations

import re
import sys
import traceback
import warnings
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
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            yield
    except KeyboardInterrupt as interrupt:
        message = str(interrupt) or "Interrupted: what was finished is kept; go on with --resume."
        Console(stderr=True).print(message, soft_wrap=True)
        raise typer.Exit(130) from None
    except Exception as error:
        mendable = isinstance(error, (ValueError, TypeError, OSError, RuntimeError, GymnasiumError))
        message = _about_the_cache(error) or (str(error) if mendable else None)
        if message is None:
            raise
        Console(stderr=True).print(f"[red]Error:[/red] {escape(message)}", soft_wrap=True)
        raise typer.Exit(2) from None


def _about_the_cache(error: Exception) -> str | None:
    """What to do if Numba cannot read or write compiled code; None if the error is another."""
    told = "".join(traceback.format_exception(error))  # that of a worker process included
    if not re.search(r"numba[/\\]core[/\\]caching\.py", told):
        return None
    return (
        f"Numba cannot read or write its cache of compiled code ({type(error).__name__}: {error}): "
        "set NUMBA_CACHE_DIR to a new folder that can be written, or, if a file there is damaged, "
        "delete all *.nbi files beside the program."
    )


def _show_warning(message: Warning | str, category: type[Warning], *where: object) -> None:
    """What the user should know of the files given, without the line of ours that says so."""
    if category is UserWarning:
        Console(stderr=True).print(f"[yellow]Note:[/yellow] {escape(str(message))}", soft_wrap=True)
    else:
        sys.stderr.write(warnings.formatwarning(message, category, *where[:2]))
