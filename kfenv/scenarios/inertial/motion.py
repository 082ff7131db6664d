"""The motion model of the inertial scenario, one object for equal parameters."""

from __future__ import annotations

from functools import lru_cache
from math import radians

from kfenv.models.model import Motion
from kfenv.models.strapdown import strapdown
from kfenv.models.strapdown_biases import strapdown_with_biases


@lru_cache(maxsize=16)
def motion_of(
    process_noise: tuple[float, float, float],
    drift: tuple[float, float] | None = None,
    time: tuple[float, float] | None = None,
    earth: bool = False,
) -> Motion:
    """One object for equal parameters, so that what is made for it is found again."""
    position, velocity, attitude = process_noise
    process = position, velocity, radians(attitude)
    if drift is None or time is None:
        return strapdown(process)
    return strapdown_with_biases(process, (drift[0], radians(drift[1])), time, earth)
