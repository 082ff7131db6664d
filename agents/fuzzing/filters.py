"""Filters on valid recordings: whatever happens is told, and no estimate holds a silent NaN."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, AdaptiveFilter
from kfenv.filters.bank import Bank, Mode, markov
from kfenv.filters.designs import DESIGNS
from kfenv.filters.engine import Engine
from kfenv.filters.gaussian_sum import Mixture
from kfenv.filters.protocol import Knobs, measured
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.results import FAILURES, History, Prediction, Run
from kfenv.scenarios.recording import Recording

from .recordings import as_case, draw_knobs, draw_recording, from_case, models
from .subject import Case, Wrong

Array = NDArray[np.float64]

BATCH, STEPS = 256, 400  # of the engine's cases
RUNS = 6  # of each recording, with other knobs
FEW, SHORT = 12, 16  # of those of slower filters
STEPWISE = 8  # instants that the engine is asked for one by one
REFERENCE = (*DESIGNS, *ADAPTIVE_DESIGNS)


class Engines:
    """The engine over whole recordings, and then step by step with other knobs in each."""

    name = "engine"

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        env_id, recording = draw_recording(rng, BATCH, STEPS)
        case = as_case(recording, draw_knobs(rng, RUNS * BATCH))
        return case | {"env_id": env_id, "alone": int(rng.integers(BATCH))}

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        recording, all_knobs = from_case(case)
        engine = _engine(case["env_id"])
        batch, steps = recording.measurement.shape[:2]
        for begin in range(0, len(all_knobs.fading), batch):
            knobs = Knobs(*(knob[begin : begin + batch].copy() for knob in all_knobs))
            run = engine.run(recording, knobs)
            check_run(run, recording)
        one = [case["alone"]]
        alone = engine.run(recording[one], Knobs(*(knob[one] for knob in knobs)))
        if not np.array_equal(run.mean[one], alone.mean, equal_nan=True):
            raise Wrong(f"filter {one[0]} alone gives other means than in its batch")
        filters = len(all_knobs.fading) + 1
        return filters * steps + self._stepwise(engine, recording, knobs)

    def _stepwise(self, engine: Engine, recording: Recording, knobs: Knobs) -> int:
        """Updates and predictions of some filters, whose factors are looked at."""
        part = recording[: 2 * FEW]
        batch, inputs = len(part), part.motion_inputs
        knobs = Knobs(*(knob[:batch].copy() for knob in knobs))
        status = np.zeros(batch, np.int64)
        prediction = engine.predict(
            part.mean, part.factor, inputs[:, 0], np.full(batch, 1e-3), status
        )
        check_factor(prediction.root, status, "propagated")
        prediction = Prediction(part.mean.copy(), part.factor.copy(), np.zeros_like(part.factor))
        steps = min(STEPWISE, len(part.time) - 1)
        for t in range(steps):
            update = engine.update(prediction, knobs, measured(part, t), status)
            check_factor(update.factor, status, "updated")
            if not np.isfinite(update.mean[status == 0]).all():
                raise Wrong("an updated mean is not finite where the status says OK")
            knobs = Knobs(*(knob[::-1].copy() for knob in knobs))
            dt = np.full(batch, part.time[t + 1] - part.time[t])
            prediction = engine.predict(
                update.mean, update.factor, np.ascontiguousarray(inputs[:, t + 1]), dt, status
            )
        return batch * (steps + 1)


class Designs:
    """Every reference design, fading and Gaussian sums included."""

    name = "designs"

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        env_id, recording = draw_recording(rng, FEW, SHORT)
        design = REFERENCE[rng.integers(len(REFERENCE))]
        return as_case(recording, draw_knobs(rng, FEW)) | {"env_id": env_id, "design": design}

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        recording, knobs = from_case(case)
        history = _reference(case["env_id"], case["design"]).history(recording, knobs)
        check_history(history, recording)
        return recording.measurement.shape[0] * recording.measurement.shape[1]


class Banks:
    """Interacting filters over the engine, with and without outliers."""

    name = "banks"

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        env_id, recording = draw_recording(rng, FEW, SHORT)
        count, most = int(rng.integers(1, 6)), rng.choice((1.0, 6.0))
        modes = 10.0 ** rng.uniform(-most, most, (count, 3))
        rates = 10.0 ** rng.uniform(-12.0, 4.0, (count, count)) * (rng.random(2 * [count]) < 0.8)
        mixture = [float(rng.uniform(0.001, 0.5)), float(10.0 ** rng.uniform(0.1, 6.0))]
        case = as_case(recording, Knobs.nominal(FEW)) | {"modes": modes, "rates": rates}
        return case | {"env_id": env_id, "mixture": mixture if rng.random() < 0.4 else None}

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        recording, _ = from_case(case)
        modes = [Mode(*map(float, mode)) for mode in case["modes"]]
        mixture = None if case["mixture"] is None else Mixture(*case["mixture"])
        bank = Bank(_engine(case["env_id"]), modes, markov(case["rates"]), mixture)
        check_history(bank.history(recording), recording)
        return int(np.prod(recording.measurement.shape[:2])) * len(modes)


@cache
def _engine(env_id: str) -> Engine:
    return Engine(*models(env_id))


@cache
def _reference(env_id: str, design: str) -> ReferenceFilter | AdaptiveFilter:
    kind = ReferenceFilter if design in DESIGNS else AdaptiveFilter
    return kind(*models(env_id), design)


# ----- what every filter promises ---------------------------------------------------------


def check_run(run: Run | History, recording: Recording) -> None:
    """Complain of a NaN that the status does not tell of.

    Raises:
        Wrong: saying what is not as `kfenv.filters.results` says.
    """
    steps = len(recording.time)
    if not np.all((run.status >= 0) & (run.status < len(FAILURES))):
        raise Wrong("a status is none of those that there are")
    if not np.array_equal(run.status == 0, run.failed_at == -1):
        raise Wrong("status and failed_at do not tell of the same failures")
    end = np.where(run.failed_at < 0, steps, run.failed_at)
    before = np.arange(steps) < end[:, None]
    finite = np.isfinite(run.mean).all(axis=2)
    if not finite[before].all():
        raise Wrong("a mean is not finite before any failure")
    if not np.isnan(run.mean[~before]).all():
        raise Wrong("a mean is told after the failure")
    arrived = np.isfinite(recording.measurement).any(axis=2)
    if np.isnan(run.nis[before & arrived]).any():
        raise Wrong("a NIS is NaN though a measurement arrived")
    if not np.isnan(run.nis[before & ~arrived]).all():
        raise Wrong("a NIS is told though nothing arrived")


def check_history(history: History, recording: Recording) -> None:
    """`check_run`, and the factors, or the covariances where a filter carries these.

    Raises:
        Wrong: likewise.
    """
    check_run(history, recording)
    spread = history.covariance if history.factor is None else history.factor
    for b in range(len(recording)):
        end = len(recording.time) if history.failed_at[b] < 0 else history.failed_at[b]
        if not np.isfinite(spread[b, :end]).all():
            raise Wrong("a covariance is not finite before any failure")


def check_factor(factor: Array, status: NDArray[np.int64], what: str) -> None:
    """Complain of factors of sound filters that are none.

    Raises:
        Wrong: if they are not lower triangular of finite numbers with a diagonal from zero up.
    """
    factor = factor[status == 0]
    if not np.isfinite(factor).all():
        raise Wrong(f"a factor ({what}) is not finite where the status says OK")
    if np.triu(factor, 1).any():
        raise Wrong(f"a factor ({what}) is not lower triangular")
    if (np.diagonal(factor, axis1=1, axis2=2) < 0.0).any():
        raise Wrong(f"a factor ({what}) has a negative diagonal")
