"""Fixes as RTKLIB writes them (.pos), with the deviations that its solution's quality sets."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.positions import WEEK, read_solution

Array = NDArray[np.float64]

COLUMNS = (
    "latitude(deg)", "longitude(deg)", "height(m)", "vn(m/s)", "ve(m/s)", "vu(m/s)",
    "sdn(m)", "sde(m)", "sdu(m)", "sdvn", "sdve", "sdvu",
)  # fmt: skip


def read_fix_columns(path: str | PathLike[str]) -> Array:
    """The columns (13, N) of `kfenv.scenarios.inertial.files.GNSS_COLUMNS`.

    Times are seconds of the GPS week in which the file begins, and go on after its end.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no solution file, or lacks velocities.
    """
    names, values = read_solution(path)
    for name in COLUMNS:
        if name not in names:
            raise ValueError(
                f"{path}: column {name!r} is missing: have RTKLIB write latitude, longitude and "
                "velocity with deviations (out-solformat=llh, out-outvel=on)."
            )
    time = values[:, 0] - WEEK * np.floor(values[:1, 0] / WEEK)
    table = values[:, [names.index(name) for name in COLUMNS]].T.copy()
    table[5] *= -1.0  # up to down
    return np.vstack([time, table])
