"""Filters of other libraries over kfenv's radar problem; see `kfenv.agents.libraries`.

Run as a program in the environment that holds the library:

    python -m kfenv.agents.library_filters NAME PROBLEM

It tells its `Task`'s steps and error, then for each line that it reads the seconds of processor
time that a run takes: others may be at work on the machine.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.models.namespaces import batch, scalar
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

Array = NDArray[np.float64]

POSITION = slice(0, 9, 3)


class Problem(NamedTuple):
    """B episodes of T measurements, their model's noise held constant.

    Attributes:
        z: (B, T, 3) range, azimuth and elevation; all arrive and no azimuth is near the cut.
        truth: (B, T, 9).
        mean, P: (B, 9) and (9, 9), before the first step.
        Q, R: (9, 9) and (3, 3).
        dt: s.
    """

    z: Array
    truth: Array
    mean: Array
    P: Array
    Q: Array
    R: Array
    dt: float

    @classmethod
    def load(cls, path: str | Path) -> Problem:
        """Read what ``np.savez`` wrote."""
        with np.load(path) as arrays:
            return cls(**{name: arrays[name] for name in cls._fields})._replace(
                dt=float(arrays["dt"])
            )


class Task(NamedTuple):
    """A call that filters episodes and returns the first's posterior means (T, 9); their steps."""

    run: Callable[[], Any]
    steps: int


def engine_alone(problem: Problem) -> Task:
    """kfenv's engine, one filter."""
    return _engine(problem, 1)


def engine_together(problem: Problem) -> Task:
    """kfenv's engine, all filters in lock-step."""
    return _engine(problem, len(problem.z))


def _engine(problem: Problem, episodes: int) -> Task:
    from kfenv.filters.engine import Engine
    from kfenv.scenarios.own import recording_of

    engine = Engine(variable_turn(1.0), radar())
    time = problem.dt * np.arange(problem.z.shape[1])
    recording = recording_of(
        time, problem.z[:episodes], np.diagonal(problem.R), problem.mean[:episodes],
        np.diagonal(problem.P),
    )  # fmt: skip
    return Task(lambda: engine.run(recording).mean[0], episodes * len(time))


def filterpy(problem: Problem) -> Task:
    """FilterPy's UnscentedKalmanFilter, its model in plain floats."""
    from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

    step, measure = _functions(scalar)

    def run() -> Array:
        ukf = UnscentedKalmanFilter(
            9, 3, problem.dt,
            hx=lambda x: np.array(measure(x.tolist(), ())),
            fx=lambda x, dt: np.array(step(x.tolist(), (), dt)),
            points=JulierSigmaPoints(9, 1.0),
        )  # fmt: skip
        ukf.x, ukf.P, ukf.Q, ukf.R = problem.mean[0].copy(), problem.P, problem.Q, problem.R
        return _stepped(problem, ukf.predict, ukf.update, lambda: ukf.x)

    return Task(run, problem.z.shape[1])


def turbo_ckf(problem: Problem) -> Task:
    """turbo-ckf's TurboCKF, its model on arrays of points."""
    from turbo_ckf import TurboCKF

    step, measure = _functions(batch)
    f, h = _on_rows(step, (), problem.dt), _on_rows(measure, ())

    def run() -> Array:
        ckf = TurboCKF(9, 3, problem.dt, hx=lambda x, *_: h(x), fx=lambda x, *_: f(x))
        ckf.x, ckf.P, ckf.Q, ckf.R = problem.mean[0], problem.P, problem.Q, problem.R
        return _stepped(problem, ckf.predict, ckf.update, lambda: ckf.x)

    return Task(run, problem.z.shape[1])


def kalman_py(problem: Problem) -> Task:
    """kalman-py's UnscentedKalmanFilter on NumPy, its model on arrays of points."""
    step, measure = _functions(batch)
    return _kalman_py(
        problem, lambda x, dt: _on_rows(step, (), dt)(x), _on_rows(measure, ()), "numpy"
    )


def kalman_py_jax(problem: Problem) -> Task:
    """The same on JAX, which compiles the loop over time."""
    step, measure = _functions(_jax_namespace())
    import jax.numpy as jnp

    def f(x, dt):
        return jnp.stack(step(tuple(x), (), dt))

    def h(x):
        return jnp.stack(measure(tuple(x), ()))

    return _kalman_py(problem, f, h, "jax")


def _kalman_py(problem: Problem, f: Callable, h: Callable, backend: str) -> Task:
    from kalman_py import UnscentedKalmanFilter

    ukf = UnscentedKalmanFilter(
        f, h, problem.Q, problem.R, problem.mean[0], problem.P, kappa=1.0, beta=0.0,
        vectorized=backend == "numpy",
    )  # fmt: skip
    return Task(
        lambda: np.asarray(ukf.filter(problem.z[0], problem.dt, backend).means), problem.z.shape[1]
    )


def dynamax_alone(problem: Problem) -> Task:
    """dynamax's unscented filter on JAX, compiled, one filter."""
    run = _dynamax(problem)
    return Task(lambda: np.asarray(run(problem.z[:1], problem.mean[:1]))[0], problem.z.shape[1])


def dynamax_together(problem: Problem) -> Task:
    """The same over all filters at once (``jax.vmap``)."""
    run = _dynamax(problem)
    steps = problem.z.shape[0] * problem.z.shape[1]
    return Task(lambda: np.asarray(run(problem.z, problem.mean))[0], steps)


def _dynamax(problem: Problem) -> Callable:
    xp = _jax_namespace()
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import (
        ParamsNLGSSM,
        UKFHyperParams,
        unscented_kalman_filter,
    )

    step, measure = _functions(xp)

    def means(z, mean):
        parameters = ParamsNLGSSM(
            initial_mean=mean, initial_covariance=problem.P,
            dynamics_function=lambda x: jnp.stack(step(tuple(x), (), problem.dt)),
            dynamics_covariance=problem.Q,
            emission_function=lambda x: jnp.stack(measure(tuple(x), ())),
            emission_covariance=problem.R,
        )  # fmt: skip
        spread = UKFHyperParams(alpha=1.0, beta=0.0, kappa=1.0)
        return unscented_kalman_filter(parameters, z, spread).filtered_means

    return jax.jit(jax.vmap(means))


def stone_soup(problem: Problem) -> Task:
    """Stone Soup's unscented predictor and updater, its model in plain floats."""
    from datetime import datetime, timedelta

    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.nonlinear import GaussianTransitionModel
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    step, measure = _functions(batch)

    def called(function: Callable, state: Any, *more: Any) -> StateVector | StateVectors:
        points = np.asarray(state.state_vector, float)
        return state.state_vector.__class__(np.array(function(tuple(points), *more)))

    class Turn(GaussianTransitionModel):
        ndim_state = 9

        def function(self, state, noise=False, **more):
            return called(step, state, (), problem.dt)

        def covar(self, **more):
            return CovarianceMatrix(problem.Q)

    class Radar(NonLinearGaussianMeasurement):
        ndim_meas = 3

        def function(self, state, noise=False, **more):
            return called(measure, state, ())

    seen = Radar(ndim_state=9, mapping=(0, 3, 6), noise_covar=CovarianceMatrix(problem.R))
    predictor = UnscentedKalmanPredictor(Turn(), alpha=1.0, beta=0.0, kappa=1.0)
    updater = UnscentedKalmanUpdater(seen, alpha=1.0, beta=0.0, kappa=1.0)
    begin = datetime(2000, 1, 1)

    def run() -> Array:
        state = GaussianState(StateVector(problem.mean[0]), problem.P, timestamp=begin)
        means = []
        for k, z in enumerate(problem.z[0]):
            now = begin + timedelta(seconds=problem.dt * (k + 1))
            detection = Detection(StateVector(z), timestamp=now, measurement_model=seen)
            predicted = predictor.predict(state, timestamp=now)
            state = updater.update(SingleHypothesis(predicted, detection))
            means.append(np.asarray(state.state_vector, float)[:, 0])
        return np.array(means)

    return Task(run, problem.z.shape[1])


def _functions(xp: Any) -> tuple[Callable, Callable]:
    """The step of the motion, and the measurement, in a namespace."""
    return variable_turn(1.0).build(xp).step, radar().build(xp)


def _on_rows(function: Callable, *more: Any) -> Callable[[Array], Array]:
    """A function of components, for points (..., d)."""
    return lambda x: np.stack(function(tuple(np.moveaxis(x, -1, 0)), *more), axis=-1)


def _stepped(problem: Problem, predict: Callable, update: Callable, mean: Callable) -> Array:
    means = []
    for z in problem.z[0]:
        predict()
        update(z)
        means.append(np.array(mean()).ravel())
    return np.array(means)


def _jax_namespace() -> SimpleNamespace:
    """The models' namespace on JAX, in double precision."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from jax import numpy as jnp

    names = ("cos", "exp", "log", "maximum", "minimum", "sin", "sqrt")
    functions = {name: getattr(jnp, name) for name in names}
    return SimpleNamespace(atan2=jnp.arctan2, function=lambda f: f, **functions)


TASKS: dict[str, Callable[[Problem], Task]] = {
    function.__name__: function
    for function in (
        engine_alone, engine_together, filterpy, stone_soup, dynamax_alone, dynamax_together,
        kalman_py, kalman_py_jax, turbo_ckf,
    )
}  # fmt: skip


def main(name: str, path: str) -> None:
    """Answer as the head of this module says."""
    problem = Problem.load(path)
    task = TASKS[name](problem)
    off = task.run()[:, POSITION] - problem.truth[0][:, POSITION]
    error = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    print(json.dumps({"steps": task.steps, "error": error}), flush=True)
    for _ in sys.stdin:
        start = time.process_time()
        task.run()
        print(time.process_time() - start, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
