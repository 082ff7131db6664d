"""Plots of a radar as a CSV file holds them, checked at the door.

A file has the columns ``t`` (s, or times as `kfenv.scenarios.clock` reads them) and one for each
channel of the sensor, such as ``range_m, azimuth_deg, elevation_deg`` (azimuth clockwise from
north) or ``x_m, y_m, z_m``; an empty cell is a channel that was not detected. It may have the
standard deviation of each, such as ``range_std_m``. Further columns are ignored unless they look
like one of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import gathered
from kfenv.models.model import Component, Sensor
from kfenv.scenarios.columns import CLOCK, column_names, read_columns
from kfenv.scenarios.radar.plot_units import check_units

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WHAT = "plots file"
MIN_PLOTS = 10
MAX_LATE = 43_200.0  # s by which a row may come out of order: a day that began anew falls more
OTHERS = ("std", "sigma", "deviation", "bearing", "slant")  # in names that could be meant
SOONEST = 1e-6  # s: plots closer than this have the same time
FARTHEST = 1e8  # m
DEVIATIONS = (1e-5, 1e6)  # m or degrees, least and greatest that can be meant
LONGEST_NAME = 60  # letters of what is quoted
TURNS = {"azimuth": 360.0, "elevation": 90.0}  # degrees within which an angle lies


@dataclass(frozen=True, eq=False)
class Plots:
    """What a file tells of one target.

    Attributes:
        path: of the file.
        time: (N,) increasing, s of the file's clock.
        value: (N, m) in SI units, NaN where a channel was not detected.
        deviation: (N, m) told standard deviations, NaN in channels without.
        repeated: rows that said the same as another, and were left out.
    """

    path: str
    time: Array
    value: Array
    deviation: Array
    repeated: int = 0

    @property
    def complete(self) -> Mask:
        """Whether all channels were detected (N,)."""
        return ~np.isnan(self.value).any(axis=1)


def column(channel: Component, told: str = "") -> str:
    """The name of a channel's column, or with ``told="_std"`` of its deviation's."""
    return f"{channel.name}{told}_{'deg' if channel.angle else channel.unit}"


def read_plots(path: str | PathLike[str], sensor: Sensor) -> Plots:
    """Read and check a file of plots.

    Rows may come in any order; those that repeat another are left out.

    Args:
        path: of the file.
        sensor: whose channels it tells.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, and of all that is wrong the column, row and remedy.
    """
    channels = sensor.channels
    measured = [column(channel) for channel in channels]
    spread = [column(channel, "_std") for channel in channels]
    header = column_names(path, WHAT)
    gathered(
        *(partial(_complain, f"{path}: {said}") for said in _columns(header, measured, spread))
    )
    told = [name for name in spread if name in header]
    time, *table = read_columns(path, WHAT, (CLOCK, *measured, *told), gaps=True)
    names = [*measured, *told]
    numbers = np.array(table).reshape(len(names), -1).T
    gathered(
        *(partial(_complain, f"{path}: {said}")
          for said in _values(time, numbers, names, len(measured))),
        partial(_check_size, str(path), numbers[:, : len(measured)]),
    )  # fmt: skip
    time, numbers, repeated = _ordered(str(path), time, numbers)
    si = np.array([np.radians(1.0) if channel.angle else 1.0 for channel in channels])
    deviation = np.full((len(time), len(channels)), np.nan)
    deviation[:, [spread.index(name) for name in told]] = numbers[:, len(measured) :]
    deviation[np.isnan(numbers[:, : len(measured)])] = np.nan  # of nothing
    plots = Plots(str(path), time, numbers[:, : len(channels)] * si, deviation * si, repeated)
    check_units(plots.path, sensor, plots.time, plots.value)
    return plots


def _complain(message: str) -> None:
    raise ValueError(message)


def _columns(header: Sequence[str], measured: Sequence[str], spread: Sequence[str]) -> Iterator:
    """What is wrong with a header, a sentence each; a missing one is left to the reader."""
    needed, known = (CLOCK, *measured), (CLOCK, *measured, *spread)
    if not any(name in header for name in needed):
        return
    stems, meant = [name.rsplit("_", 1)[0] for name in measured] + list(OTHERS), []
    for name in header:
        looks_like = any(stem in name.lower() for stem in stems if len(stem) > 1)
        if name not in known and looks_like:
            close = get_close_matches(name.lower(), known, n=1, cutoff=0.3)
            meant += close
            hint = f"; rename it {close[0]!r} and give it in that unit, if it is that" * bool(close)
            yield f"column {_short(name)} is unknown{hint}, or give it a name of another kind."
            break
    missing = [name for name in needed if name not in header and name not in meant]
    if missing:
        yield f"column {', '.join(map(repr, missing))} missing; found {_short(', '.join(header))}."
    for name in (name for name in known if header.count(name) > 1):
        yield f"there are two columns {name!r}; keep one."


def _short(text: str) -> str:
    return repr(text if len(text) <= LONGEST_NAME else f"{text[:LONGEST_NAME]}...")


def _values(time: Array, numbers: Array, names: Sequence[str], channels: int) -> Iterator:
    """What is wrong with single values, a sentence for each kind."""
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        yield f"column {CLOCK!r} in data row {row + 1} is {time[row]}; leave such rows out."
    for name, values in zip(names, numbers.T, strict=True):
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            yield f"column {name!r} in data row {row + 1} is {values[row]}; leave such cells empty."
    for name, values in zip(names[:channels], numbers.T, strict=False):
        stem = name.split("_")[0]
        if stem == "range" and (values <= 0.0).any():
            row = int(np.argmax(values <= 0.0))
            yield f"column {name!r} in data row {row + 1} is {values[row]:g}; ranges are positive."
        most, unit = TURNS.get(stem, FARTHEST), "degrees" if stem in TURNS else "metres"
        beyond = np.isfinite(values) & (np.abs(values) > most)
        if beyond.any():
            row = int(np.argmax(beyond))
            yield (
                f"column {name!r} in data row {row + 1} is {values[row]:g}; {unit} within "
                f"{most:g} of zero are meant."
            )
    for name, values in zip(names[channels:], numbers.T[channels:], strict=True):
        of = numbers[:, list(names).index(name.replace("_std", ""))]
        wrong = ~np.isnan(of) & ~((values >= DEVIATIONS[0]) & (values <= DEVIATIONS[1]))
        if wrong.any():
            row = int(np.argmax(wrong))
            yield (
                f"column {name!r} in data row {row + 1} is {values[row]:g}; it holds standard "
                f"deviations, from {DEVIATIONS[0]:g} to {DEVIATIONS[1]:g} wherever there is a "
                "measurement: fill it, or leave out the column."
            )


def _check_size(path: str, values: Array) -> None:
    complete = int((~np.isnan(values)).all(axis=1).sum())
    if complete < MIN_PLOTS:
        raise ValueError(
            f"{path}: {complete} of its {len(values)} rows tell every channel, and at least "
            f"{MIN_PLOTS} are needed."
        )


def _ordered(path: str, time: Array, numbers: Array) -> tuple[Array, Array, int]:
    """Rows in the order of their times, one for each.

    Raises:
        ValueError: if a day seems to have begun anew, or rows contradict each other.
    """
    late = np.maximum.accumulate(time) - time
    row = int(late.argmax())
    if late[row] > MAX_LATE:
        raise ValueError(
            f"{path}: column {CLOCK!r} decreases by {late[row]:.15g} s in data row {row + 1}; sort "
            "the rows, or add a day's 86400 s to those behind if it began anew there."
        )
    order = np.argsort(time, kind="stable")
    time, numbers = time[order], numbers[order]
    again = np.diff(time) < SOONEST
    same = ((numbers[1:] == numbers[:-1]) | np.isnan(numbers[1:]) & np.isnan(numbers[:-1])).all(1)
    if (again & ~same).any():
        at = int(np.argmax(again & ~same))
        rows = sorted((int(order[at]) + 1, int(order[at + 1]) + 1))
        raise ValueError(
            f"{path}: data rows {rows[0]} and {rows[1]} have the same {CLOCK!r} of {time[at]:.15g} "
            "s and other values; keep the plots of one target and one radar."
        )
    fresh = np.append(True, ~again)
    return time[fresh], numbers[fresh], int(again.sum())
