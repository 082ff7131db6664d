"""A robot with two driven wheels on a plane, that sees two beacons: the example of a model."""

from __future__ import annotations

from kfenv.models.model import Component, Motion, Sensor
from kfenv.models.own import own_motion, own_sensor

BEACONS = ((0.0, 0.0), (8.0, 0.0))  # east and north, m
SLIP = (1e-4, 1e-4, 1e-5)  # variances of a step's process noise: m^2, m^2, rad^2
NOISE = (0.01, 0.01, 0.001, 0.001)  # variances, m^2 and rad^2: 0.1 m and 1.8 deg


def robot() -> Motion:
    """East, north and heading, driven by what odometry tells: speed and turn rate."""
    states = (Component("x", "m"), Component("y", "m"), Component("heading", "rad", angle=True))
    return own_motion(states, _drive, SLIP, inputs=("speed", "turn rate"), name="robot")


def beacons() -> Sensor:
    """Distances and bearings of the two beacons, a noise knob for either kind."""
    channels = (
        *(Component(f"distance {i}", "m", "distance") for i in (1, 2)),
        *(Component(f"bearing {i}", "rad", "bearing", angle=True) for i in (1, 2)),
    )
    return own_sensor(channels, _see, states=3, name="beacons")


def _drive(xp):
    @xp.function
    def step(x, u, dt):
        east, north, heading = x
        speed, turn_rate = u
        middle = heading + 0.5 * dt * turn_rate
        return (
            east + dt * speed * xp.sin(middle),
            north + dt * speed * xp.cos(middle),
            heading + dt * turn_rate,
        )

    return step


def _see(xp):
    (x1, y1), (x2, y2) = BEACONS

    @xp.function
    def measure(x, s):
        east, north, heading = x
        e1, n1, e2, n2 = x1 - east, y1 - north, x2 - east, y2 - north
        return (
            xp.sqrt(e1 * e1 + n1 * n1), xp.sqrt(e2 * e2 + n2 * n2),
            xp.atan2(e1, n1) - heading, xp.atan2(e2, n2) - heading,
        )  # fmt: skip

    return measure
