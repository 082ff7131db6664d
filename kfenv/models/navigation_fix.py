"""Position, velocity and attitude measured as a whole (SPEC 4.4)."""

from __future__ import annotations

from functools import partial
from types import ModuleType

from kfenv.models.model import Component, Sensor


def navigation_fix(attitude: bool = True) -> Sensor:
    """A receiver that tells the state itself: the loosely coupled measurement h(x) = x.

    Nine channels of the state of `kfenv.models.strapdown`, attitude from several antennas
    with wrapped angles; or six, of position and velocity alone. States beyond, such as those
    of `kfenv.models.strapdown_biases`, are not measured.

    Args:
        attitude: whether attitude is measured.
    """
    channels = (
        *(Component(f"p{axis}", "m", "position") for axis in "NED"),
        *(Component(f"v{axis}", "m/s", "velocity") for axis in "NED"),
    )
    if attitude:
        angles = ("roll", "pitch", "yaw")
        channels += tuple(Component(angle, "rad", "attitude", angle=True) for angle in angles)
    return Sensor("navigation fix", channels, partial(_build, attitude=attitude))


def _build(xp: ModuleType, attitude: bool):
    if attitude:

        @xp.function
        def measure(x, s):
            return x[:9]

    else:

        @xp.function
        def measure(x, s):
            return x[:6]

    return measure
