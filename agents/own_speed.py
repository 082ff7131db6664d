"""Speed of models of a user's own: against built-in models, and against FilterPy's filter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.engine import Engine
from kfenv.filters.pointwise import PointwiseFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import scalar
from kfenv.models.own import own_motion, own_sensor
from kfenv.models.position import position
from kfenv.scenarios.own import simulate
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
Models = tuple[Motion, Sensor]

DT = 0.1  # s
TOGETHER, MANY = 256, 1024  # filters
STATES = ("x", "vx", "y", "vy")
START, SPREAD, NOISE = (50.0, 1.0, 30.0, -1.0), (10.0, 1.0, 10.0, 1.0), (1.0, 0.04)


def built_in() -> Models:
    """Nine states of constant acceleration, of which the position is measured."""
    return constant_acceleration(), position()


def rewritten() -> Models:
    """The same in a user's words, with its Q for steps of `DT`."""
    motion, sensor = built_in()
    factor = np.zeros((9, 9))
    entries = motion.build(scalar).noise_factor((0.0,) * 9, (), DT)
    for place, entry in zip(motion.noise_pattern, entries, strict=True):
        factor[place] = entry
    return (
        own_motion(motion.states, lambda xp: motion.build(xp).step, factor @ factor.T),
        own_sensor(sensor.channels, sensor.build, states=9),
    )


def plane(kind: str) -> Models:
    """A target on a plane whose distance and its rate are measured, by NumPy or the namespace."""
    q = np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])
    f, h = (_move, _see) if kind == "numpy" else (_move_with, _see_with)
    return own_motion(STATES, f, np.kron(np.eye(2), q)), own_sensor(("range", "rate"), h, 4)


def run_of(kind: type, models: Models, filters: int) -> tuple[Callable[[], Any], int]:
    """A call that runs so many filters over ten seconds, and the number of their steps."""
    recording = episodes(models, filters)
    run = partial(kind(*models).run, recording)
    run()
    return run, filters * len(recording.time)


def measured(best: Callable[[int, Callable], float]) -> dict[str, float]:
    """Steps per second, the most of several times: of the engine with a built-in and one's own
    model, of NumPy functions alone and together, and, if it is installed, of FilterPy.

    Args:
        best: the shortest of so many times of a call, s.
    """
    calls = {
        "built-in": run_of(Engine, built_in(), MANY),
        "own": run_of(Engine, rewritten(), MANY),
        "engine": run_of(Engine, plane("namespace"), TOGETHER),
        "alone": run_of(PointwiseFilter, plane("numpy"), 1),
        "together": run_of(PointwiseFilter, plane("numpy"), TOGETHER),
    }
    rival = filterpy_run()
    calls |= {} if rival is None else {"FilterPy": rival}
    speed = dict.fromkeys(calls, 0.0)
    for _ in range(4):  # in turn, so that a drift of the machine's speed meets all
        for name, (run, steps) in calls.items():
            speed[name] = max(speed[name], steps / best(2, run))
    return speed


def episodes(models: Models, count: int) -> Recording:
    """Ten seconds each."""
    size = len(models[0].states)
    start, spread = (START, SPREAD) if size == len(STATES) else (np.zeros(size), np.ones(size))
    noise = NOISE if size == len(STATES) else np.ones(len(models[1].channels))
    return simulate(
        *models, "none", R=noise, mean=start, P=spread, duration=10.0, rate=1.0 / DT,
        episodes=count,
    )  # fmt: skip


def filterpy_run() -> tuple[Callable[[], Any], int] | None:
    """FilterPy's unscented filter with the same functions over one episode, None without it."""
    try:
        from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
    except ImportError:
        return None
    motion, sensor = plane("numpy")
    recording = episodes((motion, sensor), 1)
    q = np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])

    def run() -> None:
        ukf = UnscentedKalmanFilter(
            4, 2, DT, hx=lambda x: _see(x, None), fx=lambda x, dt: _move(x, None, dt),
            points=JulierSigmaPoints(4, 1.0),
        )  # fmt: skip
        ukf.x, ukf.P = np.array(START), np.diag(SPREAD)
        ukf.Q, ukf.R = np.kron(np.eye(2), q), np.diag(NOISE)
        for z in recording.measurement[0]:
            ukf.predict()
            ukf.update(z)

    return run, len(recording.time)


def _move(x: Array, u: Array, dt: float) -> Array:
    return np.array([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]])


def _see(x: Array, s: Array) -> Array:
    distance = np.sqrt(x[0] ** 2 + x[2] ** 2 + 1.0)
    return np.array([distance, (x[0] * x[1] + x[2] * x[3]) / distance])


def _move_with(xp: ModuleType) -> Callable:
    @xp.function
    def step(x, u, dt):
        return x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]

    return step


def _see_with(xp: ModuleType) -> Callable:
    @xp.function
    def measure(x, s):
        distance = xp.sqrt(x[0] * x[0] + x[2] * x[2] + 1.0)
        return distance, (x[0] * x[1] + x[2] * x[3]) / distance

    return measure
