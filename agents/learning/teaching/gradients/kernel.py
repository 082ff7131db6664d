"""The sweep for a pair of models: what is common to all and what is compiled for the pair."""

from __future__ import annotations

import sys
from functools import lru_cache
from math import sqrt
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.filters.fingerprint import fingerprint
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import compiled, lanes
from kfenv.models.namespaces.lanes import LANES

from . import pullback, sweep, traced
from .pullback import Rows

Array = NDArray[np.float64]
PARTS = ("step", "pull_step", "measure", "pull_measure", "pull_noise")
ENTRY_POINT = {"cache": True, "nogil": True, "no_cfunc_wrapper": True, **compiled.FLOATING_POINT}


class Layout(NamedTuple):
    """Sizes, weights, and the row of a block of `sweep` at which each part begins."""

    n: int  # states
    m: int  # channels
    p: int  # sigma points
    spacing: float  # of the points, in columns of the factor
    weight: float  # of all points but the central one
    root_weight: float
    root_centre_weight: float
    mean: int  # of the predicted state, or of the posterior before
    factor: int
    noise: int  # lower factor of the process noise
    propagated: int  # the two parts of the predicted covariance
    added: int
    knobs: int
    sensor_inputs: int
    motion_inputs: int
    told: int
    innovation: int
    here: int  # 1 for a channel that arrived, otherwise 0
    order: int  # numbers of the channels that any lane heard
    points: int  # sigma points, a row per state
    values: int  # what becomes of them, a row per value; then the deviations
    of_values: int
    of_points: int
    spread: int  # innovation covariance S, then its slope
    root: int  # its factor
    gain: int
    weighted: int  # S^-1 innovation
    room: int
    of_innovation: int
    of_cross: int  # slope of C
    of_factor: int
    of_entries: int  # of the process noise
    of_state: int  # by them
    of_mean: int  # the slopes from here on end with a filter's failure
    of_covariance: int
    of_noise: int
    of_knobs: int
    of_told: int
    end: int


class Given(NamedTuple):
    """What filters were given and what they found at T instants, (T, B, K) with matrices flat."""

    mean: Array  # predicted
    root: Array  # lower factor of the predicted covariance without process noise
    noise: Array  # lower factor of the process noise as the knobs have turned it
    posterior: Array
    factor: Array  # lower factor of the posterior covariance
    innovation: Array  # NaN where nothing arrived
    knobs: Array  # see `filtering.FilterWithGradient`
    told: Array
    motion_inputs: Array  # dt last
    sensor_inputs: Array
    of_posterior: Array  # slopes of the posteriors
    of_covariance: Array  # symmetric


class Sweep:
    """The backward sweep of a pair of models.

    Args:
        motion, sensor: the models.
        kappa: spread of the sigma points.
    """

    def __init__(self, motion: Motion, sensor: Sensor, kappa: float) -> None:
        self.layout = layout(motion, sensor, kappa)
        self._functions = _functions(motion, sensor, self.layout)
        self._states, self._channels = (
            np.array([part.angle for part in parts]) for parts in (motion.states, sensor.channels)
        )
        self._entries = np.array(motion.noise_pattern).T.copy()

    def __call__(self, given: Given, sound: NDArray[np.int64]) -> tuple[Array, Array]:
        """The slopes of the knobs and of the noise told, shaped as these.

        Args:
            sound: (B,) how many steps each filter made before it failed.
        """
        at, model = self.layout, self._functions
        slopes = np.empty_like(given.knobs), np.empty_like(given.told)
        blocks = -(-len(sound) // LANES)
        w, heard = np.zeros((blocks, at.end, LANES)), np.zeros(blocks, np.int64)
        for t in range(len(given.mean) - 1, -1, -1):
            sweep.begin(at, w, t, given, heard)
            if heard.any():
                model.measure(w)
                sweep.pull_update(at, w, heard, self._channels)
                model.pull_measure(w)
            sweep.end(at, w, t, heard, sound, *slopes)
            if t > 0:
                sweep.begin_prediction(at, w, t, given, *self._entries)
                model.pull_noise(w)
                model.step(w)
                sweep.pull_prediction(at, w, self._states)
                model.pull_step(w)
                sweep.end_prediction(at, w)
        return slopes


def layout(motion: Motion, sensor: Sensor, kappa: float) -> Layout:
    """Of a block of eight filters."""
    n, m, entries = len(motion.states), len(sensor.channels), len(motion.noise_pattern)
    p = 2 * n + 1
    sizes = {
        "mean": n, "factor": n * n, "noise": n * n, "propagated": n * n, "added": n * n,
        "knobs": 2 + n, "sensor_inputs": len(sensor.inputs),
        "motion_inputs": len(motion.inputs) + 1, "told": m, "innovation": m, "here": m, "order": m,
        "points": n * p, "values": max(n, m) * p, "of_values": max(n, m) * p, "of_points": n * p,
        "spread": m * m, "root": m * m, "gain": n * m, "weighted": m, "room": n * n,
        "of_innovation": m, "of_cross": n * m, "of_factor": n * n, "of_entries": entries,
        "of_state": n, "of_mean": n, "of_covariance": n * n, "of_noise": n * n, "of_knobs": 2 + n,
        "of_told": m,
    }  # fmt: skip
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return Layout(
        n, m, p, sqrt(n + kappa), 0.5 / (n + kappa), sqrt(0.5 / (n + kappa)),
        sqrt(kappa / (n + kappa)), **dict(zip((*sizes, "end"), ends, strict=True)),
    )  # fmt: skip


@lru_cache(maxsize=64)
def _functions(motion: Motion, sensor: Sensor, at: Layout) -> ModuleType:
    """What depends on the models, compiled and kept on disk under a name of its own."""
    parts = [Path(part.__file__) for part in (compiled, lanes, pullback, traced)]
    arithmetic = [part.read_text() for part in parts]
    identity = fingerprint(motion.build, sensor.build, tuple(at), arithmetic)
    name = f"{__package__}.model_{identity}"
    if name in sys.modules:  # made for models that do the same
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = pullback.__file__
    sys.modules[name] = module  # where the cache looks for the functions it restores
    source = source_of(motion, sensor, at, identity)
    names = {name: getattr(compiled, name) for name in compiled.__all__} | source.tables
    names |= {name: getattr(lanes, name) for name in ("load", "store", "where_greater")}
    names |= {"lift": lanes.lift_to(LANES), "polynomial": _polynomial, "plain": _plain}
    module.__dict__.update(names)
    exec(compile("\n".join(source.lines), module.__file__, "exec"), module.__dict__)
    for part in PARTS:
        function = module.__dict__[f"{part}_{identity}"]
        setattr(module, part, njit(**ENTRY_POINT)(function))
    return module


def source_of(motion: Motion, sensor: Sensor, at: Layout, identity: str) -> pullback.Source:
    """The text of all `PARTS`, whose names end in the identity."""
    functions, states = motion.build(traced), len(motion.states)
    known = len(motion.inputs) + 1, True
    step = pullback.record(functions.step, states, *known)
    noise = pullback.record(functions.noise_factor, states, *known)
    measure = pullback.record(sensor.build(traced), states, len(sensor.inputs), False)
    motion_inputs, sensor_inputs = Rows(at.motion_inputs), Rows(at.sensor_inputs)
    points, values, of_values, of_points = (
        Rows(first, at.p, True) for first in (at.points, at.values, at.of_values, at.of_points)
    )
    source, ends = pullback.Source(), (of_values, of_points)
    for part, told, inputs in (("step", step, motion_inputs), ("measure", measure, sensor_inputs)):
        given = told, at.p, points, inputs
        pullback.write_values(source, f"{part}_{identity}", *given, values)
        pullback.write_pullback(source, f"pull_{part}_{identity}", *given, *ends)
    pullback.write_pullback(
        source, f"pull_noise_{identity}", noise, 1, Rows(at.mean), motion_inputs,
        Rows(at.of_entries), Rows(at.of_state),
    )  # fmt: skip
    return source


@compiled.function
def _plain(number):
    """The number as a variable: Numba compiles a function anew for every literal argument."""
    return number + 0


@njit(**compiled.INNER)
def _polynomial(table, node, row, x, y):
    """Value and slopes of a polynomial by its coefficients (powers of x, powers of y)."""
    value = by_x = by_y = 0.0 * x
    for i in range(table.shape[2] - 1, -1, -1):
        inner = slope = 0.0 * y
        for j in range(table.shape[3] - 1, -1, -1):
            slope = slope * y + inner
            inner = inner * y + table[node, row, i, j]
        by_x = by_x * x + value
        by_y = by_y * x + slope
        value = value * x + inner
    return value, by_x, by_y
