"""What a wheeled vehicle cannot do, as measurements of nothing (Groves 2013, ch. 15).

Each constraint is a channel group of its own, and so has a noise knob: an agent can learn when
not to believe it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import ModuleType

from kfenv.models.model import Component, Sensor
from kfenv.models.rotations import build_rotations

NON_HOLONOMIC, ZERO_VELOCITY, ZERO_RATE = "non_holonomic", "zero_velocity", "zero_rate"
CHANNELS = {
    NON_HOLONOMIC: tuple((f"velocity {axis}", "m/s") for axis in ("to the right", "of the floor")),
    ZERO_VELOCITY: tuple((f"v{axis} at rest", "m/s") for axis in "NED"),
    ZERO_RATE: tuple((f"rate {axis} at rest", "rad/s") for axis in "xyz"),
}


def with_constraints(sensor: Sensor, names: Sequence[str]) -> Sensor:
    """A sensor with the channels of constraints behind its own.

    ``non_holonomic``: the velocity along the body's right and down axes is zero: wheels do not
    slide. ``zero_velocity``: the vehicle stands. ``zero_rate``: standing, the gyroscopes
    measure their biases alone; the measured value is their mean.

    Args:
        sensor: measures states of `kfenv.models.strapdown_biases`, or but for the last constraint
            of `kfenv.models.strapdown`.
        names: of the constraints.
    """
    if not names:
        return sensor
    channels = tuple(
        Component(channel, unit, name) for name in names for channel, unit in CHANNELS[name]
    )
    build = partial(_build, first=sensor.build, names=tuple(names))
    return Sensor(sensor.name, (*sensor.channels, *channels), build, sensor.inputs)


def _build(xp: ModuleType, first, names: tuple[str, ...]):
    measure = first(xp)
    for name in names:
        measure = _joined(xp, measure, _MEASURES[name](xp))
    return measure


def _joined(xp: ModuleType, one, other):
    @xp.function
    def measure(x, s):
        return one(x, s) + other(x, s)

    return measure


def _across(xp: ModuleType):
    matrix = build_rotations(xp).matrix

    @xp.function
    def measure(x, s):
        vn, ve, vd = x[3:6]
        roll, pitch, yaw = x[6:9]
        _, c12, c13, _, c22, c23, _, c32, c33 = matrix(roll, pitch, yaw)
        return c12 * vn + c22 * ve + c32 * vd, c13 * vn + c23 * ve + c33 * vd

    return measure


def _velocity(xp: ModuleType):
    @xp.function
    def measure(x, s):
        return x[3:6]

    return measure


def _rate_bias(xp: ModuleType):
    @xp.function
    def measure(x, s):
        return x[12:15]

    return measure


_MEASURES = {NON_HOLONOMIC: _across, ZERO_VELOCITY: _velocity, ZERO_RATE: _rate_bias}
