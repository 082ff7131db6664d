"""Range, azimuth and elevation seen from the origin (SPEC 4.1)."""

from __future__ import annotations

from types import ModuleType

from kfenv.models.model import Component, Sensor

HORIZONTAL_FLOOR_SQUARED = 1.0  # of x^2 + y^2, m^2: elevation has no slope overhead


def radar() -> Sensor:
    """A radar at the origin of an east-north-up frame.

    Azimuth is clockwise from north, atan2(x, y); elevation is above the horizon.
    Expects the axis-major state of `kfenv.models.kinematics`.
    """
    channels = (
        Component("range", "m", "range"),
        Component("azimuth", "rad", "azimuth", angle=True),
        Component("elevation", "rad", "elevation", angle=True),
    )
    return Sensor("radar", channels, _build)


def _build(xp: ModuleType):
    @xp.function
    def measure(x, s):
        east, north, up = x[0], x[3], x[6]
        horizontal_squared = east * east + north * north
        distance = xp.sqrt(horizontal_squared + up * up)
        horizontal = xp.sqrt(xp.maximum(horizontal_squared, HORIZONTAL_FLOOR_SQUARED))
        return distance, xp.atan2(east, north), xp.atan2(up, horizontal)

    return measure
