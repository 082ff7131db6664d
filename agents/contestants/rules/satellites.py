"""What the rules for single satellites share: their channels, and their innovations beside the
others' whatever the receiver's clock does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.channels import beside_others
from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.models.model import Sensor

Array = NDArray[np.float64]

RANGES, RATES = slice(CHANNELS), slice(CHANNELS, None)
CLOCK = (1e3, 30.0)  # m, m/s: deviation of an error common to all, wider than any clock's
CAUTION = 30.0  # factor of the prediction's covariance, for tracks that have strayed


def check_satellites(name: str, sensor: Sensor) -> None:
    """Complain of a sensor whose channels are not satellites' ranges and rates.

    Raises:
        ValueError: naming the agent.
    """
    if sensor.name != "pseudoranges":
        raise ValueError(
            f"The agent {name!r} excludes satellites, and the sensor {sensor.name!r} has none: "
            "enter it where there are pseudoranges (kfenv/GnssTracking-v0)."
        )


def unexplained(info: Mapping[str, Any], factor: Array) -> tuple[Array, Array]:
    """What of each innovation the other satellites do not explain, and its deviation, (B, 24).

    With the told noise times `factor` (B, 24), a prediction that may have strayed, and any error
    that is common to all ranges or all rates taken for the clock's, whose jitter blames nobody.
    NaN in missing channels.
    """
    arrived, told = ~np.isnan(info["innovation"]), info["noise"] ** 2
    covariance = CAUTION * info["innovation_covariance"]
    places = np.arange(covariance.shape[1])
    covariance[:, places, places] += np.where(arrived, (factor**2 - CAUTION) * told, 0.0)
    for part, deviation in zip((RANGES, RATES), CLOCK, strict=True):
        here = arrived[:, part]
        covariance[:, part, part] += deviation**2 * (here[:, :, None] & here[:, None, :])
    return beside_others(info["innovation"], covariance)
