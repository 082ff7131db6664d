"""Engine tier: the square-root sigma-point filter with the exact Joseph form, fused by Numba."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from math import sqrt
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from kfenv import addresses, kernel_cache
from kfenv.addresses import Addresses, note_addresses
from kfenv.filters import batch_and_lanes, transposed
from kfenv.filters.fingerprint import fingerprint
from kfenv.filters.protocol import Episodes, Knobs, Measurement, elapsed
from kfenv.filters.results import Prediction, Run, Update
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import compiled, lanes
from kfenv.models.namespaces.lanes import LANES

Array = NDArray[np.float64]
Rows = Any  # of lanes, see `lanes.RowsType`
Status = NDArray[np.int64]
FEW = 9  # of so many channels each has a row, heard or not: loops of known length are faster
TABLE = 1 + 15 + 29  # numbers in a kernel's table: of arrays and of their dimensions
ENTRY_POINT = {"cache": True, "nogil": True, "no_cfunc_wrapper": True, **compiled.FLOATING_POINT}
CYCLE, KERNEL = (Path(__file__).with_name(name) for name in ("cycle.py", "kernel.py"))


class Scratch(NamedTuple):
    """The kernel's working rows of lanes: matrices flat, one lane per filter.

    They are parts of one array, since every array costs time when a kernel is called.
    """

    posterior: Rows
    predicted: Rows
    S: Rows  # factor before the step in hand: of the posterior, or the propagated root
    L: Rows  # predicted factor
    Q: Rows  # factor of the process noise
    u: Rows
    s: Rows
    dt: Rows
    scales: Rows  # roots of the knobs fading and process noise
    z: Rows
    sd: Rows
    arrived: Rows  # 1 for a channel that arrived, otherwise 0
    count: Rows
    unsound: Rows  # zero, or NaN where mean or factor are not finite
    order: Rows  # numbers of the channels that any lane heard
    innovation: Rows
    variance: Rows
    whitened: Rows
    X: Rows  # sigma points, a row per state
    Z: Rows  # measured sigma points, a row per channel
    A: Rows  # rows to be triangularised
    U: Rows  # statistical H S (SPEC section 9)
    Re: Rows  # factor of linearisation error and measurement noise
    C: Rows  # innovation factor
    K: Rows  # gain, a row per channel


@dataclass(frozen=True)
class InPlace:
    """Arrays that a filter works on, instant after instant.

    In C's order, and of factors zero above the diagonal.
    """

    mean: Array  # (B, n) from which it predicts
    factor: Array  # (B, n, n)
    prediction: Prediction
    knobs: Knobs
    out: Update  # of an innovation or an update
    status: Status

    @cached_property
    def addresses(self) -> Addresses:
        """For the kernel."""
        return Addresses(
            self.mean, self.factor, *self.prediction, *self.knobs, *self.out, self.status
        )


class Engine:
    """The compiled `kfenv.filters.protocol.Filter`.

    Args:
        motion, sensor: the models.
        kappa: spread of the sigma points, >= 0 so that no weight is negative (SPEC 2.2).
        lanes: 8, or 1 for a filter that is mostly alone: faster then, with the same bits.

    Raises:
        ValueError: if kappa is negative or not finite.
    """

    def __init__(
        self, motion: Motion, sensor: Sensor, kappa: float = 1.0, lanes: int = LANES
    ) -> None:
        if not 0.0 <= kappa < float("inf"):
            raise ValueError(
                f"kappa must be a non-negative number, got {kappa!r}: a negative central "
                "weight has no square root. The reference filters accept it."
            )
        self.motion, self.sensor, self.kappa = motion, sensor, float(kappa)
        self._kernel = _kernel(motion, sensor, self.kappa, lanes)
        n, m = len(motion.states), len(sensor.channels)
        self._n, self._m = n, m
        sizes = _scratch_sizes(n, m, len(motion.inputs), len(sensor.inputs))
        self._scratch = np.zeros((sum(sizes), lanes))

    def __reduce__(self):
        return Engine, (self.motion, self.sensor, self.kappa, self._scratch.shape[1])

    def predict(
        self, mean: Array, factor: Array, inputs: Array, dt: Array, status: Status
    ) -> Prediction:
        """See `Filter.predict`."""
        out = Prediction(np.empty(mean.shape), *np.zeros((2, *factor.shape)))
        mean, factor, inputs, dt = _plain(mean, factor, inputs, dt)
        unused = Knobs(dt, dt), Update(mean, out.root, mean, mean, mean, dt, dt)
        table = _table(mean, factor, out, *unused, status)
        self._advance(True, False, False, table, inputs, dt, inputs, inputs, inputs)
        return out

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.innovate`."""
        return self._look(False, prediction, knobs, measurement, status)

    def update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """See `Filter.update`."""
        return self._look(True, prediction, knobs, measurement, status)

    def _look(self, corrects, prediction, knobs, measurement, status) -> Update:
        mean, root, noise = _plain(*prediction)
        known, value, deviation = _plain(*measurement)
        out, knobs = _new_update(prediction, measurement), Knobs(*_plain(*knobs))
        table = _table(mean, root, Prediction(mean, root, noise), knobs, out, status)
        self._advance(False, True, corrects, table, known, knobs[0], known, value, deviation)
        return out

    def advance_in_place(
        self, place: InPlace, inputs: Array, dt: Array, measurement: Measurement
    ) -> None:
        """`predict`, then `innovate`."""
        self._advance(True, True, False, place.addresses.table, inputs, dt, *measurement)

    def innovate_in_place(self, place: InPlace, measurement: Measurement) -> None:
        """`innovate`, written where `update` writes."""
        unused = measurement.inputs, place.knobs.fading
        self._advance(False, True, False, place.addresses.table, *unused, *measurement)

    def update_in_place(self, place: InPlace, measurement: Measurement) -> None:
        """`update`."""
        unused = measurement.inputs, place.knobs.fading
        self._advance(False, True, True, place.addresses.table, *unused, *measurement)

    def _advance(self, predicts, innovates, corrects, table, *arrived: Array) -> None:
        self._kernel.advance(predicts, innovates, corrects, table, self._scratch, *arrived)

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """See `Filter.run`; no Python per step, and always in eight lanes."""
        batch, steps = episodes.measurement.shape[:2]
        result = Run(
            np.full((batch, steps, self._n), np.nan), np.full((batch, steps), np.nan),
            np.zeros(batch, np.int64), np.full(batch, -1),
        )  # fmt: skip
        mean, factor, *series = _plain(
            episodes.mean, episodes.factor, episodes.motion_inputs, episodes.sensor_inputs,
            episodes.measurement, episodes.noise,
        )  # fmt: skip
        kernel = _kernel(self.motion, self.sensor, self.kappa, LANES)
        kernel.run(
            mean, factor, elapsed(episodes)[..., None].copy(), *series,
            *_plain(*(knobs or Knobs.nominal(batch))), np.zeros((len(self._scratch), LANES)),
            *result,
        )  # fmt: skip
        return result


def _table(
    mean: Array, factor: Array, prediction: Prediction, knobs: Knobs, out: Update, status: Status
) -> NDArray[np.int64]:
    """That of an `InPlace`, of arrays that are used once."""
    table = np.empty(TABLE, np.int64)
    _tabulate(table, mean, factor, *prediction, *knobs, *out, status)
    return table


@njit(**kernel_cache.KERNEL)
def _tabulate(
    table, mean, factor, predicted, root, noise, fading, process_scale, new_mean, new_factor,
    innovation, variance, whitened, nis, log_likelihood, status,
):  # fmt: skip
    arrays = (
        mean, factor, predicted, root, noise, fading, process_scale, new_mean, new_factor,
        innovation, variance, whitened, nis, log_likelihood, status,
    )  # fmt: skip
    note_addresses(table, arrays)


def _new_update(prediction: Prediction, measurement: Measurement) -> Update:
    shape = measurement.value.shape
    return Update(
        np.empty(prediction.mean.shape), np.zeros(prediction.root.shape), *np.empty((3, *shape)),
        *np.empty((2, shape[0])),
    )  # fmt: skip


def _scratch_sizes(n: int, m: int, p: int, k: int) -> Scratch:
    """Rows of each working array for n states, m channels, p motion and k sensor inputs."""
    points = 2 * n + 1
    return Scratch(
        posterior=n, predicted=n, S=n * n, L=n * n, Q=n * n, u=p, s=k, dt=1, scales=2,
        z=m, sd=m, arrived=m, count=1, unsound=1, order=m, innovation=m, variance=m,
        whitened=m,
        X=n * points, Z=m * points, A=max(n * (n + m), m * (n + 1)),
        U=m * n, Re=m * m, C=m * m, K=m * n,
    )  # fmt: skip


def _plain(*arrays: Array) -> list[Array]:
    """The arrays, or copies of those that are read-only or in another order than C's.

    Numba would compile for each of these anew, which takes ten seconds.
    """
    return [array if array.flags.carray else array.copy() for array in arrays]


@lru_cache(maxsize=64)
def _kernel(motion: Motion, sensor: Sensor, kappa: float, width: int) -> ModuleType:
    """The kernel's two templates bound to a pair of models."""
    n, m = len(motion.states), len(sensor.channels)
    constants = {
        "N": n,
        "M": m,
        "P": 2 * n + 1,
        "SPREAD": sqrt(n + kappa),
        "WEIGHT": 0.5 / (n + kappa),
        "ROOT_WEIGHT": sqrt(0.5 / (n + kappa)),
        "ROOT_CENTRE_WEIGHT": sqrt(kappa / (n + kappa)),
        "ODD": 0.5 / sqrt(n + kappa),
        "EVEN": sqrt(0.25 / (n + kappa)),
        "STATE_IS_ANGLE": tuple(state.angle for state in motion.states),
        "CHANNEL_IS_ANGLE": tuple(channel.angle for channel in sensor.channels),
        "NOISE_PATTERN": motion.noise_pattern,
        "SKIPS": m > FEW,
        "LANES": width,
    }
    # Numba asks the kernel's file alone whether it changed, so the others are part of the name.
    modules = addresses, compiled, lanes, transposed, batch_and_lanes
    arithmetic = [Path(part).read_text() for part in (*(m.__file__ for m in modules), CYCLE)]
    identity = fingerprint(motion.build, sensor.build, sorted(constants.items()), arithmetic)
    name = f"{__package__}.kernel_{identity}"
    if name in sys.modules:  # made for models that do the same
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(KERNEL)
    functions = motion.build(compiled)
    rows = {
        "rows_of": lanes.rows_of(width),
        "spread": lanes.spread_over(width),
        "lift": lanes.lift_to(width),
    }
    module.__dict__.update(
        constants,
        step=functions.step,
        noise_factor=functions.noise_factor,
        measure=sensor.build(compiled),
        **rows,
        entry_point=partial(_entry_point, identity=identity),
        **_accessors(n, m, len(motion.inputs), len(sensor.inputs), rows),
    )
    sys.modules[name] = module  # where the cache looks for the functions it restores
    for template in (CYCLE, KERNEL):
        exec(compile(template.read_text(), str(template), "exec"), module.__dict__)
    return module


def _entry_point(function: FunctionType, identity: str):
    """Compile a kernel function, cached on disk under a name of its own for each pair."""
    function.__qualname__ = f"{function.__name__}_{identity}"
    kernel = njit(**ENTRY_POINT)(function)

    def call(*arguments):
        try:
            return kernel(*arguments)
        except NumbaError as error:
            raise ValueError(_untypable(str(error))) from error

    return call


def _untypable(told: str) -> str:
    """A sentence on a model that cannot be compiled, from what Numba says of it."""
    culprit = re.search(r"global name '?(\w+)|freevar '?(\w+)|name '?(\w+)'? is not defined", told)
    name = culprit and next(filter(None, culprit.groups()))
    where = re.search(r'File "([^"]+)", line (\d+)', told)
    place = f" (line {where[2]} of {Path(where[1]).name})" if where else ""
    what = f"{name!r}{place} is nothing that it knows" if name else told.strip().split("\n")[0]
    return (
        f"The engine cannot compile the model: {what}. Write @xp.function above every function "
        "inside, and take + - * / ** and the namespace's functions alone."
    )


def _accessors(n: int, m: int, p: int, k: int, rows: dict) -> dict:
    """Functions between rows and tuples: Numba has no tuple of computed length."""
    points = 2 * n + 1
    names = {"load": lanes.load, "store": lanes.store, "Scratch": Scratch, **rows}

    def gather(count: int, stride: int, offset: str) -> str:
        return "(" + "".join(f"load(v, {i * stride}{offset})," for i in range(count)) + ")"

    def scatter(count: int) -> str:
        return "; ".join(f"store(v, {i * points} + j, lift(y[{i}]))" for i in range(count))

    source = (
        f"def state_components(v, j): return {gather(n, points, ' + j')}\n"
        f"def input_components(v): return {gather(p, 1, '')}\n"
        f"def sensor_components(v): return {gather(k, 1, '')}\n"
        f"def store_state(v, j, y): {scatter(n)}\n"
        f"def store_channels(v, j, y): {scatter(m)}\n"
    )
    ends = np.cumsum(_scratch_sizes(n, m, p, k)).tolist()
    parts = (f"rows_of(v, {start})" for start in [0, *ends[:-1]])
    source += f"def scratch_of(v): return Scratch({', '.join(parts)})\n"
    functions: dict = {}
    exec(source, names, functions)
    return {name: compiled.function(f) for name, f in functions.items()}
