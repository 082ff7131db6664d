"""An hour of a real GPS station, read once: beside the repository, see `rinex_files`."""

from functools import cache

import numpy as np
import pymap3d
from rinex_files import BROADCAST, OBSERVED

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT
from kfenv.scenarios.gnss.ephemeris import read_navigation
from kfenv.scenarios.gnss.fix import fix, signals
from kfenv.scenarios.gnss.reading import read_log
from kfenv.scenarios.gnss.rinex import L1, read_observations

POSITION = [0, 3, 6]


@cache
def observed():
    return read_observations(OBSERVED)


@cache
def broadcast():
    return read_navigation(BROADCAST)


@cache
def log():
    return read_log(OBSERVED, BROADCAST)


@cache
def fixes():
    return fix(signals(observed(), broadcast()))


def east_north_up(position):
    """Errors of positions (..., 3) about the station's, m."""
    latitude, longitude, _ = pymap3d.ecef2geodetic(*observed().position)
    error = np.moveaxis(position - observed().position, -1, 0)
    return np.stack(pymap3d.uvw2enu(*error, latitude, longitude), axis=-1)


def doppler():
    """What the real pseudoranges' change says, Hz: positive when approaching."""
    rate = (observed().pseudorange[2:] - observed().pseudorange[:-2]) / (
        observed().time[2:] - observed().time[:-2]
    )[:, None]
    return np.pad(-rate * L1 / SPEED_OF_LIGHT, ((1, 1), (0, 0)), constant_values=np.nan)
