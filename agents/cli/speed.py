"""The command that measures speed."""

from __future__ import annotations

from typing import Annotated

from rich.table import Table
from typer import Option

from .console import console

LIBRARIES = "Beside other libraries' filters, which are installed in an environment of their own."


def bench(libraries: Annotated[bool, Option("--libraries", help=LIBRARIES)] = False) -> None:
    """Measure speed; with FilterPy installed, as a ratio to its filter."""
    if libraries:
        return _compare()
    from ..bench import benchmark
    from ..deployment.speed import step_row

    table = Table("what", "measured", "compared", "promised")
    with console.status("") as status:
        rows = benchmark(lambda what: status.update(f"Measuring {what} ..."))
        rows.append(step_row())
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _compare() -> None:
    from ..libraries import compare

    table = Table("filter", "version", "steps/s", "of kfenv's", "position RMSE")
    with console.status("") as status:
        rows = compare(lambda what: status.update(f"Measuring {what} ..."))
    for row in rows:
        table.add_row(*row)
    console.print(table)
