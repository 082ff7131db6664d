"""What the rules for single satellites share: their channels, and their innovations beside the
others' whatever the receiver's clock does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kfenv.envs.channels import beside_others
from kfenv.envs.options import Options
from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.scenarios.recording import Recording

from ..agent import Agent, Array

RANGES, RATES = slice(CHANNELS), slice(CHANNELS, None)
CLOCK = (1e3, 30.0)  # m, m/s: deviation of an error common to all, wider than any clock's
CAUTION = 30.0  # factor of the prediction's covariance, for tracks that have strayed


class SatelliteRule(Agent):
    """Base of the agents that turn each satellite's own knobs."""

    single_channels = True

    def check(self, scenario: Any, options: Options, recording: Recording | None) -> None:
        """See also `Contestant.check`.

        Raises:
            ValueError: if the sensor has no satellites.
        """
        if scenario.sensor.name != "pseudoranges":
            raise ValueError(
                f"The agent {self.name!r} leaves out satellites, and {scenario.name} has none: "
                "enter it in kfenv/GnssTracking-v0."
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
