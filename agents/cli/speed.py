"""The command that measures speed."""

from __future__ import annotations

from rich.table import Table

from .console import console


def bench() -> None:
    """Measure speed; with FilterPy installed, as a ratio to its filter."""
    from ..bench import benchmark
    from ..deployment.speed import step_row

    table = Table("what", "measured", "compared", "promised")
    with console.status("") as status:
        rows = benchmark(lambda what: status.update(f"Measuring {what} ..."))
        rows.append(step_row())
    for row in rows:
        table.add_row(*row)
    console.print(table)
