"""Pairs of motion and sensor that the filter tests share, each with a recording to filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.matrices import tria
from kfenv.filters.protocol import Knobs
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Component, Motion, MotionFunctions, Sensor
from kfenv.models.namespaces import batch as namespace
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.position import position
from kfenv.models.radar import radar
from kfenv.models.strapdown import mechanise
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.inertial.ins_gnss import PAPER_NOISE
from kfenv.scenarios.inertial.motion import motion_of

Array = NDArray[np.float64]


class Case(NamedTuple):
    """Episodes as `Filter.run` takes them, and the knobs to go with them."""

    mean: Array
    factor: Array
    time: Array
    motion_inputs: Array
    sensor_inputs: Array
    measurement: Array
    noise: Array
    knobs: Knobs

    def only(self, filters) -> Case:
        """The same recording for some of the filters."""
        *episodes, knobs = self
        arrays = (a if a is self.time else a[filters] for a in episodes)
        return Case(*arrays, Knobs(*(knob[filters] for knob in knobs)))


# A robot on a plane with odometry as known input: a state that is an angle, inputs of
# both kinds, four channels of which two are angles, a full lower noise factor.

_ROBOT_STATES = (
    Component("x", "m"), Component("y", "m"), Component("heading", "rad", angle=True),
    Component("speed", "m/s"),
)  # fmt: skip
_ROBOT_NOISE = tuple((i, j) for i in range(4) for j in range(i + 1))


def robot() -> Motion:
    return Motion(
        "robot", _ROBOT_STATES, (0, 1, 1), (3, 3, 3), _ROBOT_NOISE, _build_robot,
        inputs=("turn rate", "acceleration"),
    )  # fmt: skip


def _build_robot(xp) -> MotionFunctions:
    @xp.function
    def step(x, u, dt):
        east, north, heading, speed = x
        turn_rate, acceleration = u
        middle = heading + 0.5 * dt * turn_rate
        return (
            east + dt * speed * xp.sin(middle),
            north + dt * speed * xp.cos(middle),
            heading + dt * turn_rate,
            speed + dt * acceleration,
        )

    @xp.function
    def noise_factor(x, u, dt):
        s = 0.02 * xp.sqrt(dt * (1.0 + x[3] * x[3]) + 0.0 * x[0])
        h = 0.05 * xp.sqrt(dt * (1.0 + u[0] * u[0]) + 0.0 * x[0])
        return s, 0.3 * s, s, 0.1 * h, -0.2 * h, h, 0.5 * s, 0.1 * s, 0.2 * h, 2.0 * s

    return MotionFunctions(step, noise_factor)


def beacon() -> Sensor:
    channels = (
        Component("range", "m", "range"),
        Component("bearing", "rad", "bearing", angle=True),
        Component("compass", "rad", "compass", angle=True),
        Component("closing speed", "m/s", "rate"),
    )
    return Sensor("beacon", channels, _build_beacon, inputs=("beacon x", "beacon y"))


def _build_beacon(xp):
    @xp.function
    def measure(x, s):
        east, north = s[0] - x[0], s[1] - x[1]
        distance = xp.sqrt(east * east + north * north + 1.0)
        closing = x[3] * (east * xp.sin(x[2]) + north * xp.cos(x[2])) / distance
        return distance, xp.atan2(east, north) - x[2], x[2], closing

    return measure


def position_sensor() -> Sensor:
    """A linear sensor of an aircraft."""
    channels = tuple(Component(axis, "m", "position") for axis in "xyz")
    return Sensor("position", channels, _build_position)


def _build_position(xp):
    @xp.function
    def measure(x, s):
        return x[0], x[3] + 0.5 * x[4], x[6]

    return measure


def wrap(angle):
    return angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)


def _knobs(batch: int) -> Knobs:
    return Knobs(1.0 + 0.01 * np.arange(batch), 1.0 + 0.3 * np.arange(batch))


def _correlated_factor(rng, deviations, batch: int) -> Array:
    """Lower factors of covariances with every correlation filled."""
    deviations = np.asarray(deviations, float)
    n = len(deviations)
    mixing = 0.6 * rng.normal(size=(batch, n, n)) + np.eye(n)
    return tria(deviations[:, None] * mixing)


def radar_case(
    batch: int = 4, steps: int = 300, missing: float = 0.2, seed: int = 0, dt: float = 0.2
) -> Case:
    """Gently turning aircraft, some crossing azimuth 180 deg, seen by a radar."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(steps)
    start = np.array([-4e3, -5e3, 1.5e3]) + 500.0 * rng.normal(size=(batch, 3))
    velocity = np.array([150.0, 20.0, 3.0]) + 10.0 * rng.normal(size=(batch, 3))
    bend = rng.normal(size=(batch, 3)) * [3.0, 3.0, 0.3]
    angle = 0.05 * t
    offset = np.stack([np.sin(angle), 1.0 - np.cos(angle), 0.1 * np.sin(angle)], axis=1) * 60.0
    path = start[:, None] + velocity[:, None] * t[:, None] + bend[:, None] * offset
    east, north, up = np.moveaxis(path, 2, 0)
    distance, horizontal = np.linalg.norm(path, axis=2), np.hypot(east, north)
    z = np.stack([distance, np.arctan2(east, north), np.arctan2(up, horizontal)], axis=2)
    sd = np.broadcast_to([20.0, 0.02, 0.02], z.shape) * rng.uniform(0.5, 2.0, size=z.shape)
    z = z + sd * rng.normal(size=z.shape)
    z[:, :, 1] = wrap(z[:, :, 1])
    z[rng.random(z.shape) < missing] = np.nan
    factor = _correlated_factor(rng, [200.0, 20.0, 2.0] * 3, batch)
    mean = np.zeros((batch, 9))
    mean[:, 0::3], mean[:, 1::3] = start, velocity
    mean += (factor @ rng.normal(size=(batch, 9, 1)))[:, :, 0]
    nothing = np.zeros((batch, steps, 0))
    return Case(mean, factor, t, nothing, nothing, z, sd, _knobs(batch))


def position_case(batch: int = 4, steps: int = 150, missing: float = 0.2, seed: int = 2) -> Case:
    """The same aircraft at two measurements of position per second."""
    case = radar_case(batch, steps, 0.0, seed, dt=0.5)
    rng = np.random.default_rng(seed)
    distance, azimuth, elevation = np.moveaxis(case.measurement, 2, 0)
    ground = distance * np.cos(elevation)
    z = np.stack([ground * np.sin(azimuth), ground * np.cos(azimuth),
                  distance * np.sin(elevation)], axis=2)  # fmt: skip
    z[rng.random(z.shape) < missing] = np.nan
    z[:, 50:60] = np.nan
    sd = 100.0 * rng.uniform(0.5, 2.0, size=z.shape)
    return case._replace(measurement=z, noise=sd)


def robot_case(batch: int = 4, steps: int = 300, missing: float = 0.3, seed: int = 1) -> Case:
    """Robots driving circles through heading 180 deg, hearing a different beacon each time."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 0.2, size=steps))
    dt = np.diff(time, prepend=time[:1])
    u = [0.4, 0.0] + [0.2, 0.1] * rng.normal(size=(batch, steps, 2))
    s = 30.0 * rng.normal(size=(batch, steps, 2))
    factor = _correlated_factor(rng, [1.0, 1.0, 0.1, 0.3], batch)
    truth = np.array([0.0, 0.0, 3.0, 2.0]) + 0.1 * rng.normal(size=(batch, 4))
    mean = truth + (factor @ rng.normal(size=(batch, 4, 1)))[:, :, 0]
    step, measure = _build_robot(namespace).step, _build_beacon(namespace)
    z = np.empty((batch, steps, 4))
    for t in range(steps):
        if t > 0:
            truth = np.stack(step(tuple(truth.T), tuple(u[:, t].T), dt[t]), axis=1)
        z[:, t] = np.stack(measure(tuple(truth.T), tuple(s[:, t].T)), axis=1)
    sd = np.broadcast_to([0.5, 0.05, 0.1, 0.1], z.shape)
    z = z + sd * rng.normal(size=z.shape)
    z[:, :, 1:3] = wrap(z[:, :, 1:3])
    z[rng.random(z.shape) < missing] = np.nan
    return Case(mean, factor, time, u, s, z, sd.copy(), _knobs(batch))


def strapdown_case(
    batch: int = 4, steps: int = 300, missing: float = 0.3, seed: int = 2, dt: float = 0.02
) -> Case:
    """Banked turns through yaw 180 deg, inertial samples and fixes with noise."""
    rng = np.random.default_rng(seed)
    time = dt * np.arange(steps)
    turning = [1.0, 0.5, -11.0, 0.05, 0.02, 0.3] + rng.normal(size=(batch, 1, 6)) * 0.05
    u = turning + rng.normal(size=(batch, steps, 6)) * [0.3, 0.3, 0.3, 0.02, 0.02, 0.02]
    deviation = np.array([20.0] * 3 + [2.0] * 3 + [0.03] * 3)
    factor = _correlated_factor(rng, deviation, batch)
    start = [0.0, 0.0, -1000.0, 80.0, 30.0, 2.0, 0.4, 0.1, 2.5] + deviation * rng.normal(
        size=(batch, 9)
    )
    mean = start + (factor @ rng.normal(size=(batch, 9, 1)))[:, :, 0]
    z = np.stack([mechanise(x, samples, time) for x, samples in zip(start, u, strict=True)])
    sd = np.broadcast_to([5.0] * 3 + [0.5] * 3 + [0.01] * 3, z.shape).copy()
    z = z + sd * rng.normal(size=z.shape)
    z[:, :, 6:] = wrap(z[:, :, 6:])
    z[rng.random(z.shape) < missing] = np.nan
    z[:, 1::2] = np.nan  # fixes at half the samples' rate
    return Case(mean, factor, time, u, np.zeros((batch, steps, 0)), z, sd, _knobs(batch))


def drawn_case(
    motion: Motion, sensor: Sensor, mean: Array, factor: Array, sd: Array, dt: float, seed: int = 0
) -> tuple[Array, Case]:
    """Truth (B, T, n) drawn from the models themselves, and its recording with knobs at one.

    Args:
        mean: (n,), and factor (n, n): of the initial state.
        sd: (B, T, m) deviations of the measurements' noise, NaN where nothing arrives.
    """
    rng = np.random.default_rng(seed)
    batch, steps = sd.shape[:2]
    functions, n, step = motion.build(namespace), len(mean), np.full(batch, dt)
    truth, L = np.empty((batch, steps, n)), np.zeros((batch, n, n))
    truth[:, 0] = mean + rng.normal(size=(batch, n)) @ factor.T
    for t in range(1, steps):
        x = tuple(truth[:, t - 1].T)
        for place, entry in zip(
            motion.noise_pattern, functions.noise_factor(x, (), step), strict=True
        ):
            L[:, *place] = entry
        noise = (L @ rng.normal(size=(batch, n, 1)))[:, :, 0]
        truth[:, t] = np.stack(functions.step(x, (), step), axis=1) + noise
    z = np.stack(sensor.build(namespace)(tuple(np.moveaxis(truth, 2, 0)), ()), axis=2)
    z = z + sd * rng.normal(size=sd.shape)
    angles = [channel.angle for channel in sensor.channels]
    z[:, :, angles] = wrap(z[:, :, angles])
    told, nothing = np.nan_to_num(sd, nan=1.0), np.zeros((batch, steps, 0))
    means, factors = np.tile(mean, (batch, 1)), np.tile(factor, (batch, 1, 1))
    time = dt * np.arange(steps)
    return truth, Case(means, factors, time, nothing, nothing, z, told, Knobs.nominal(batch))


# Where an environment has the like, its own models: their kernels are then compiled but once.
PAIRS = {
    "variable turn, radar": (variable_turn(), radar(), radar_case),
    "constant acceleration, radar": (constant_acceleration(), radar(), radar_case),
    "constant acceleration, position": (constant_acceleration(0.2), position(), position_case),
    "robot, beacon": (robot(), beacon(), robot_case),
    "strapdown, navigation fix": (motion_of(PAPER_NOISE), navigation_fix(), strapdown_case),
}
