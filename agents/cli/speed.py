"""The command that measures speed."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated, NamedTuple

from rich.table import Table
from typer import Option

from .console import console

LIBRARIES = "Beside other libraries' filters, which are installed in an environment of their own."
JSON = "Print the rows as JSON instead of a table."
OWN = "what", "measured", "compared", "promised"
OTHERS = "filter", "version", "steps/s", "of kfenv's", "position RMSE"


def bench(
    libraries: Annotated[bool, Option("--libraries", help=LIBRARIES)] = False,
    as_json: Annotated[bool, Option("--json", help=JSON)] = False,
) -> None:
    """Measure speed; with FilterPy installed, as a ratio to its filter."""
    measure, columns = (_others, OTHERS) if libraries else (_own, OWN)
    if as_json:
        print(json.dumps([row._asdict() for row in measure(lambda what: None)], indent=2))
        return
    table = Table(*columns)
    with console.status("") as status:
        rows = measure(lambda what: status.update(f"Measuring {what} ..."))
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _own(advance: Callable[[str], None]) -> list[NamedTuple]:
    from ..bench import benchmark
    from ..deployment.speed import step_row

    return [*benchmark(advance), step_row()]


def _others(advance: Callable[[str], None]) -> list[NamedTuple]:
    from ..libraries import compare

    return compare(advance)
