"""The position reports of a flight as a file holds them, and what of them is no report.

Stamps of whole seconds repeat, reports arrive late and out of order, and a recorder writes
an old position again where it has no new one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.columns import column_names, read_columns

Array = NDArray[np.float64]
Site = tuple[float, float, float]  # latitude and longitude in degrees, height in m

COLUMNS = ("t", "lat", "lon", "alt_m")
FEET, FOOT = "alt_ft", 0.3048
MIN_REPORTS = 10
MAX_LATE = 43_200.0  # s by which a row may come out of order: a day that began anew falls more
HIGHEST, FEW_HIGHER = 20_000.0, 0.1  # m, and the share of reports that may be wrong about it
QUANTUM, MANY = 25.0, 20  # ft, of a transponder's altitudes; so many different ones are no chance
UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
SLOWEST, FASTEST = 10.0, 1000.0  # m/s, of an aircraft whose times are right
CREEPING, RARE = 0.5, 50.0  # m/s and s: slower and rarer, times may be no seconds
FLYING = 15.0  # m/s: what moves faster and repeats its position does not report


@dataclass(frozen=True, eq=False)
class Track:
    """The position reports of one flight, as they are in its file.

    Attributes:
        time: (N,) increasing, s.
        latitude, longitude: (N,) degrees.
        altitude: (N,) taken as height above the WGS 84 ellipsoid, m.
        path: of the file.

    Raises:
        ValueError: if the columns differ in length, hold a value that is no number or
            no place on Earth, have fewer than 10 rows, times fall by half a day, or
            times or altitudes are in other units.
    """

    time: Array
    latitude: Array
    longitude: Array
    altitude: Array
    path: str = "the flight"

    def __post_init__(self) -> None:
        for column, field in zip(COLUMNS, fields(self)[:-1], strict=True):
            value = np.asarray(getattr(self, field.name), dtype=float)
            object.__setattr__(self, field.name, value)
            _check_column(column, value, self.time.size)
        check_degrees("lat", self.latitude, 90.0)
        check_degrees("lon", self.longitude, 360.0)
        self._check_order()
        self._check_feet()
        self._check_seconds()

    def _check_order(self) -> None:
        late = np.maximum.accumulate(self.time) - self.time
        row = int(late.argmax())
        if late[row] > MAX_LATE:
            raise ValueError(
                f"column 't' decreases by {late[row]:.15g} s in data row {row + 1}; sort the rows, "
                "or add a day's 86400 s (a week's 604800 s) to those behind if it began anew there."
            )

    def _check_feet(self) -> None:
        highest = float(np.quantile(self.altitude, 1.0 - FEW_HIGHER))
        stepped = (self.altitude % QUANTUM == 0.0).all() and np.unique(self.altitude).size >= MANY
        if stepped or highest > HIGHEST:
            why = "is always a multiple of 25" if stepped else f"reaches {highest:g} m"
            raise ValueError(
                f"column 'alt_m' {why}: altitudes in feet, it seems; name the column "
                f"{FEET!r}, and it is taken as such."
            )

    def _check_seconds(self) -> None:
        """Complain of times in smaller units, in which everything creeps."""
        order = np.argsort(self.time, kind="stable")
        passed = np.diff(self.time[order])
        east = np.diff(self.longitude[order]) * np.cos(np.radians(self.latitude[order][:-1]))
        metres = 111e3 * np.hypot((east + 180.0) % 360.0 - 180.0, np.diff(self.latitude[order]))
        speed = metres.sum() / max(passed.sum(), 1e-9)
        for name, factor in UNITS.items():
            creeps = speed < CREEPING and np.median(passed) >= RARE
            if creeps and SLOWEST <= factor * speed < FASTEST:
                raise ValueError(
                    f"column 't' is in {name}, it seems: taken as seconds the aircraft flies at "
                    f"{speed:.2g} m/s; divide the column by {factor:.0e}."
                )


def load_track(path: str | Path) -> Track:
    """Read a flight from a CSV file with the columns t (s), lat, lon (degrees) and alt_m (m).

    In place of alt_m there may be alt_ft, in feet. Other columns are ignored.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no CSV file, or as in `Track`; the message names the file.
    """
    names = column_names(path, "track")
    in_feet = FEET in names and COLUMNS[-1] not in names
    *place, altitude = read_columns(path, "track", (*COLUMNS[:-1], FEET) if in_feet else COLUMNS)
    try:
        return Track(*place, altitude * FOOT if in_feet else altitude, str(path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def tidied(track: Track, origin: Site) -> tuple[Array, Array, int]:
    """Put reports in order, one for each time: the mean of those that share it.

    Where an aircraft in flight repeats its position, only the first report of it stays.

    Args:
        track: the reports.
        origin: of the frame in which positions are given.

    Returns:
        Times (N,) increasing, s; positions (N, 3) east, north and up of the origin, m; and
        how many repeated positions were left out.
    """
    import pymap3d

    order = np.argsort(track.time, kind="stable")
    time, latitude, longitude, altitude = (
        column[order] for column in (track.time, track.latitude, track.longitude, track.altitude)
    )
    position = np.stack(pymap3d.geodetic2enu(latitude, longitude, altitude, *origin), axis=-1)
    fresh = ~_repeated(time, position, (np.diff(latitude) == 0.0) & (np.diff(longitude) == 0.0))
    time, place = np.unique(time[fresh], return_inverse=True)
    total = np.zeros((time.size, 3))
    np.add.at(total, place, position[fresh])
    return time, total / np.bincount(place)[:, None], int((~fresh).sum())


def _repeated(time: Array, position: Array, same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Reports that repeat (`same` (N - 1,) tells) the one before while the aircraft flies."""
    first = np.flatnonzero(np.append(True, ~same))
    moved = np.linalg.norm(np.diff(position[first, :2], axis=0), axis=1)
    flies = moved > FLYING * np.diff(time[first])
    both = np.append(True, flies) & np.append(flies, True)  # before and after
    run = np.cumsum(np.append(True, ~same)) - 1
    return np.append(False, same) & both[run]


def _check_column(column: str, value: Array, rows: int) -> None:
    if value.shape != (rows,):
        raise ValueError(f"column {column!r} has shape {value.shape}, column 't' {rows} rows.")
    if rows < MIN_REPORTS:
        raise ValueError(f"a track needs at least {MIN_REPORTS} rows, got {rows}.")
    bad = ~np.isfinite(value)
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"column {column!r} in data row {row + 1} is {value[row]}; leave such rows out."
        )


def check_degrees(what: str, degrees: Array, most: float) -> None:
    """Complain of an angle beyond these degrees from zero."""
    outside = ~(np.abs(degrees) <= most)
    if outside.any():
        raise ValueError(
            f"{what} must be within {most:g} deg of zero, got {degrees[np.argmax(outside)]:g}."
        )
