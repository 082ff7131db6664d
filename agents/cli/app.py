"""The command line: `kfenv --help`."""

from __future__ import annotations

import typer

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS
from kfenv.filters.designs import DESIGNS

from .contest import evaluate
from .dataset import dataset
from .demo import demo
from .environments import envs
from .export import export
from .fuzz import fuzz
from .inspect import inspect
from .limit import limit
from .outages import outages
from .reproduction import claims, reproduce
from .run import run
from .soak import soak
from .speed import bench
from .suites import leaderboard, suite, suites
from .training import train
from .tune import tune

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Learn to tune an adaptive Kalman filter, and contest the classical ways of doing so.",
)
FAMILY = f"Fixed filters of the family: {', '.join((*DESIGNS, *ADAPTIVE_DESIGNS))}."

app.command()(envs)
app.command()(train)
app.command(epilog=FAMILY)(evaluate)
app.command()(run)
app.command()(dataset)
app.command()(limit)
app.command()(inspect)
app.command()(outages)
app.command()(export)
app.command()(tune)
app.command()(suites)
app.command()(suite)
app.command()(leaderboard)
app.command()(reproduce)
app.command()(claims)
app.command()(bench)
app.command()(fuzz)
app.command()(soak)
app.command()(demo)
