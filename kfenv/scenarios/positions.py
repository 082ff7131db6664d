"""Where a receiver was, as a CSV file or RTKLIB's solution file (.pos) tells."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from math import inf
from os import PathLike
from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray

from kfenv.checks import LARGEST
from kfenv.names import excerpt
from kfenv.scenarios.columns import column_names, read_columns

Array = NDArray[np.float64]

PLACE = ("lat", "lon", "height")
WEEK_AND_SECONDS = ("week", "seconds")
WEEK = 604_800.0  # s
GPS_EPOCH = datetime(1980, 1, 6)
MIN_POSITIONS = 4
LLH, XYZ = "latitude(deg) longitude(deg) height(m)", "x-ecef(m) y-ecef(m) z-ecef(m)"
DEVIATIONS = ("sdn(m)", "sde(m)", "sdu(m)")


@dataclass(frozen=True, eq=False)
class Positions:
    """Attributes:
    path: of the file.
    time: (N,) increasing: GPS seconds since 1980-01-06, or of a week, or since any instant.
    position: (N, 3) earth-fixed, m.
    deviation: (N, 3) north, east and up, m; None where the file tells none.
    quality: (N,) RTKLIB's Q (1 fixed, 2 float, 5 single ...), None in a CSV file.
    """

    path: str
    time: Array
    position: Array
    deviation: Array | None = None
    quality: NDArray[np.int64] | None = None


def read_positions(path: str | PathLike[str]) -> Positions:
    """Read positions: a file that ends in .pos is RTKLIB's, another CSV.

    A CSV file has the columns lat, lon (degrees), height (m) and either t (s) or week and
    seconds of GPS.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none of both, or times do not increase; the message names it.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no positions file {path}.")
    found = _read_pos(path) if Path(path).suffix.lower() == ".pos" else _read_csv(path)
    if found.time.size < MIN_POSITIONS:
        raise ValueError(f"{path} holds {found.time.size} positions, {MIN_POSITIONS} are needed.")
    steps = np.diff(found.time)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0))
        raise ValueError(
            f"{path}: the time of position {row + 2} is not later than that of the one before; "
            "sort them and keep one per time."
        )
    return found


def _read_csv(path: str | PathLike[str]) -> Positions:
    clock = ("t",) if "t" in column_names(path, "positions file") else WEEK_AND_SECONDS
    *clock, latitude, longitude, height = read_columns(path, "positions file", (*clock, *PLACE))
    time = clock[0] if len(clock) == 1 else WEEK * clock[0] + clock[1]
    _check_finite(path, np.stack((time, latitude, longitude, height), axis=-1))
    if np.abs(latitude).max(initial=0.0) > 90.0:
        raise ValueError(f"{path}: lat must be within 90 deg of zero; are lat and lon exchanged?")
    return Positions(str(path), time, _earth_fixed(latitude, longitude, height))


def _read_pos(path: str | PathLike[str]) -> Positions:
    columns, values = read_solution(path)
    _check_finite(path, values[:, :4])
    llh = columns[1:4] == LLH.split()
    deviation = None
    if llh and all(name in columns for name in DEVIATIONS):
        deviation = values[:, [columns.index(name) for name in DEVIATIONS]]
    quality = None
    if "Q" in columns:
        told = values[:, columns.index("Q")]
        quality = np.where(np.abs(told) < 100.0, told, 0.0).astype(np.int64)
    position = _earth_fixed(*values[:, 1:4].T) if llh else values[:, 1:4]
    return Positions(str(path), values[:, 0], position, deviation, quality)


def read_solution(path: str | PathLike[str]) -> tuple[list[str], Array]:
    """The columns of an RTKLIB solution file and their values (N, k), the time in GPS seconds.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none, or of another clock; the message names it.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no solution file {path}.")
    lines = Path(path).read_bytes().decode("latin-1").splitlines()
    names = next((line for line in reversed(lines) if line.startswith("%") and "(" in line), "")
    columns = names.removeprefix("%").split()
    for wrong, remedy in (("UTC", "GPST"), ("JST", "GPST")):
        if columns[:1] == [wrong]:
            raise ValueError(f"{path} has {wrong} times; have RTKLIB write {remedy} ones.")
    if columns[:1] != ["GPST"] or columns[1:4] not in (LLH.split(), XYZ.split()):
        told = excerpt(" ".join(columns)) if columns else "not told"
        raise ValueError(
            f"{path} is no RTKLIB solution file of GPST times with latitude, longitude and height "
            f"in degrees, or x, y and z: its columns are {told}."
        )
    rows = [
        (n, line.split()) for n, line in enumerate(lines, 1) if line.strip(" %") and line[0] != "%"
    ]
    values = np.array([_pos_row(path, n, fields, len(columns) + 1) for n, fields in rows])
    return columns, values.reshape(-1, len(columns))


def _pos_row(path: str | PathLike[str], number: int, fields: list[str], count: int) -> list[float]:
    """One line's values, the first two of which, a date or week and a time, become one."""
    try:
        if len(fields) != count:
            raise ValueError
        values = [_instant(*fields[:2]), *map(float, fields[2:])]
        if any(LARGEST < abs(value) < inf for value in values):
            raise ValueError
        return values
    except (ValueError, OverflowError):
        raise ValueError(f"{path}, line {number}: {count} fields of numbers are wanted.") from None


def _instant(day: str, time: str) -> float:
    """GPS seconds of a date and a time of day, or of a week and its second."""
    if "/" not in day:
        return WEEK * int(day) + float(time)
    hour, minute, second = time.split(":")
    start = datetime.strptime(day, "%Y/%m/%d") - GPS_EPOCH
    return start / timedelta(seconds=1) + 3600.0 * int(hour) + 60.0 * int(minute) + float(second)


def _check_finite(path: str | PathLike[str], rows: Array) -> None:
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ValueError(f"{path}: position {row + 1} is no number; leave such rows out.")


def _earth_fixed(latitude: Array, longitude: Array, height: Array) -> Array:
    return np.stack(pymap3d.geodetic2ecef(latitude, longitude, height), axis=-1)
