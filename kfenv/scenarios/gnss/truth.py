"""The truth of a receiver that moved, laid beside its log."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT, WEEK
from kfenv.scenarios.positions import read_positions

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

WIDEST = 2.5  # of the usual spacing: wider stretches between two positions tell nothing
EDGE = 0.01  # s, by which clocks let the first and last position miss the log's
FAR = 50.0  # m: the median fix is nearer to a truth that is right
LITTLE = 0.1  # share of the log's epochs that the truth should cover
LEAP_SECONDS = 18  # of GPS against UTC since 2017


@dataclass(frozen=True, eq=False)
class Truth:
    """Attributes:
    time: (N,) of the file's positions, GPS seconds.
    position: (E, 3) at the log's epochs, m; that of the fix where the file tells none.
    """

    time: Array
    position: Array
    _spline: CubicSpline

    def at(self, time: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Positions (N, 3) at GPS times (N,), m, and whether the file tells them."""
        return _told(self._spline, self.time, time)


def true_path(path: str | PathLike[str], log: str, time: Array, fixed: Array) -> Truth:
    """Read where a receiver was.

    Args:
        path: of the file, see `kfenv.scenarios.positions`. Its times may be GPS seconds since
            1980, of the week, or since the log's first epoch.
        log: the observation file's path, for complaints.
        time: (E,) of the log's epochs by the receiver's clock, GPS seconds.
        fixed: (E, 4) least-squares position and clock bias, m.

    Raises:
        ValueError: if it covers little of the log, or lies far from its fixes.
    """
    from scipy.interpolate import CubicSpline

    found = read_positions(path)
    true_time = time - fixed[:, 3] / SPEED_OF_LIGHT
    starts = (0.0, WEEK * np.floor(time[0] / WEEK), time[0])
    spline = CubicSpline(found.time, found.position)
    covered = [_told(spline, found.time, true_time - start)[1].mean() for start in starts]
    start = starts[int(np.argmax(covered))]
    if max(covered) < LITTLE:
        raise ValueError(
            f"{path}: its times, {found.time[0]:.15g} to {found.time[-1]:.15g} s, cover "
            f"{100.0 * max(covered):.0f} % of {log} ({time[0]:.15g} to {time[-1]:.15g} s since "
            "1980-01-06); give GPS seconds since then, of the week, or since the log began."
        )
    position, known = _told(spline, found.time, true_time - start)
    away = float(np.median(np.linalg.norm(position - fixed[:, :3], axis=1)[known]))
    if away > FAR:
        raise ValueError(
            f"{path} lies {away:.0f} m from the fixes of {log} in the median; are its times GPS "
            f"time (UTC is {LEAP_SECONDS} s behind), and its heights above the ellipsoid?"
        )
    position[~known] = fixed[~known, :3]
    spline = CubicSpline(found.time + start, found.position)
    return Truth(found.time + start, position, spline)


def _told(spline: CubicSpline, told: Array, time: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Positions at these times, those of the nearest end beyond it, and whether they are told."""
    right = np.clip(np.searchsorted(told, time, side="right"), 1, len(told) - 1)
    spacing = told[right] - told[right - 1]
    inside = (time >= told[0] - EDGE) & (time <= told[-1] + EDGE)
    known = inside & (spacing <= WIDEST * np.median(np.diff(told)))
    return spline(np.clip(time, told[0], told[-1])), known
