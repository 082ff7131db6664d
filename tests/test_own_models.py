"""Models of a user's own: any size, by namespace or NumPy, and against FilterPy."""

from pathlib import Path

import numpy as np
import pendulum
import pytest
from filterpy.kalman import JulierSigmaPoints, KalmanFilter, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numpy_models import DT, SWING, linear, linear_models, numpy_pendulum

from kfenv.filters.engine import Engine
from kfenv.filters.fingerprint import fingerprint
from kfenv.filters.pointwise import PointwiseFilter
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.replay import replay
from kfenv.filters.results import BAD_PREDICTION, OK
from kfenv.models.namespaces import batch, compiled, dual, lanes, scalar
from kfenv.models.own import own_motion, own_sensor
from kfenv.scenarios.faults import SignalLoss
from kfenv.scenarios.own import recording_of, simulate

# ----- what a user writes -------------------------------------------------------------


def test_a_pendulum_takes_fewer_than_60_lines_and_finds_a_better_rule():
    lines = Path(pendulum.__file__).read_text().splitlines()
    assert len([line for line in lines if line.strip() and not line.strip().startswith("#")]) < 60
    rmse = pendulum.contest(("fixed", "hmm-noise", "clairvoyant"), 24)
    assert rmse["clairvoyant"] < rmse["hmm-noise"] < rmse["fixed"]


def test_numpy_and_namespace_are_the_same_filter():
    motion, sensor = numpy_pendulum()
    recording = simulate(motion, sensor, episodes=3, **SWING)
    same = simulate(pendulum.MODEL["motion"], pendulum.MODEL["sensor"], episodes=3, **SWING)
    np.testing.assert_allclose(recording.truth, same.truth, atol=1e-12)
    engine = Engine(pendulum.MODEL["motion"], pendulum.MODEL["sensor"])
    engine = replay(engine, None, recording)
    for filter in (PointwiseFilter(motion, sensor), ReferenceFilter(motion, sensor)):
        run = filter.run(recording)
        np.testing.assert_allclose(run.mean, engine.mean, atol=1e-9)
        np.testing.assert_allclose(run.nis, engine.nis, atol=1e-8)


def test_exponential_logarithm_and_powers_are_those_of_every_backend():
    x = np.linspace(0.5, 4.0, lanes.LANES)

    def build(xp):
        @xp.function
        def function(a):
            return xp.exp(-a) + xp.log(a), a**3, a**-2

        return function

    expected = np.exp(-x) + np.log(x), x**3, x**-2.0
    duals = build(dual)(dual.Dual(x, np.ones((len(x), 1))))
    slopes = -np.exp(-x) + 1.0 / x, 3.0 * x**2, -2.0 * x**-3.0
    in_lanes, out = build(compiled), np.zeros((3, len(x)))

    @njit(**compiled.FLOATING_POINT)
    def run(given, out):
        values = in_lanes(lanes.load(given, 0))
        for i in range(3):
            lanes.store(out, i, values[i])

    run(x[None].copy(), out)
    for i in range(3):
        np.testing.assert_allclose(build(batch)(x)[i], expected[i], rtol=1e-14)
        np.testing.assert_allclose(out[i], expected[i], rtol=1e-13)
        np.testing.assert_allclose(duals[i].value, expected[i], rtol=1e-14)
        np.testing.assert_allclose(duals[i].gradient[:, 0], slopes[i], rtol=1e-13)
        assert build(scalar)(float(x[3]))[i] == pytest.approx(expected[i][3], rel=1e-14)


def test_a_constant_that_an_inner_function_uses_is_part_of_the_fingerprint():
    """Otherwise the engine would go on with what it once compiled."""

    def build(gravity, table):
        scope = {"GRAVITY": gravity, "TABLE": np.array([table])}
        exec("def f(xp):\n def step(x): return GRAVITY * x + TABLE[0]\n return step", scope)
        return fingerprint(scope["f"])

    assert build(9.81, 1.0) == build(9.81, 1.0)
    assert len({build(9.81, 1.0), build(9.8, 1.0), build(9.81, 1.0 + 1e-12)}) == 3


def test_a_function_of_one_state_is_called_for_each_and_says_so():
    def bounce(x, u, dt):
        speed = -x[1] if x[0] < 0.0 else x[1]
        return [x[0] + dt * speed, speed]

    with pytest.warns(UserWarning, match="f takes one state alone.*np.where in place of `if`"):
        motion = own_motion(("height", "speed"), bounce, (0.0, 0.01))
    sensor = own_sensor(("height",), lambda x, s: x[:1], 2)
    world = SWING | {"mean": (-1.0, -0.5)}
    run = PointwiseFilter(motion, sensor).run(simulate(motion, sensor, "none", **world))
    assert np.isfinite(run.mean).all()


def test_numpy_models_have_slopes_too():
    """By central differences, for the extended filters."""
    motion, sensor = numpy_pendulum()
    recording = simulate(motion, sensor, "none", **SWING)
    exact = ReferenceFilter(pendulum.MODEL["motion"], pendulum.MODEL["sensor"], "ekf-joseph")
    about = ReferenceFilter(motion, sensor, "ekf-joseph").run(recording)
    np.testing.assert_allclose(about.mean, exact.run(recording).mean, atol=1e-7)


# ----- against another library --------------------------------------------------------


@settings(max_examples=12, deadline=None)
@given(st.integers(1, 6), st.integers(1, 4), st.integers(0, 99))
def test_any_size_is_the_kalman_filter_of_a_linear_model(n, m, seed):
    F, H, Q, R = linear(n, m, seed)
    motion, sensor = linear_models(F, H, Q)
    mean, P = np.zeros(n), np.eye(n)
    faults = (SignalLoss(duration=(0.5, 1.0)),)
    recording = simulate(
        motion, sensor, faults, R=R, mean=mean, P=P, duration=3.0, rate=10.0, seed=seed
    )
    run = PointwiseFilter(motion, sensor).run(recording)
    kf = KalmanFilter(n, m)
    kf.x, kf.P, kf.F, kf.H, kf.Q, kf.R = mean[:, None], P, F, H, Q, np.diag(R)
    for t, z in enumerate(recording.measurement[0]):
        if t > 0:
            kf.predict()
        if not np.isnan(z).any():
            kf.update(z[:, None])
        np.testing.assert_allclose(run.mean[0, t], kf.x[:, 0], atol=1e-8)


def test_a_nonlinear_model_is_filterpys_unscented_filter():
    def f(x, u, dt):
        return np.array([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3] - dt * 0.1 * x[2]])

    def h(x, s):
        distance = np.sqrt(x[0] ** 2 + x[2] ** 2 + 1.0)
        return np.array([distance, (x[0] * x[1] + x[2] * x[3]) / distance])

    Q, R, mean, P = np.diag([1e-4, 0.01, 1e-4, 0.01]), (1.0, 0.04), [50.0, 1, 30, -1], np.eye(4)
    motion, sensor = own_motion("a b c d".split(), f, Q), own_sensor(("r", "v"), h, 4)
    recording = simulate(motion, sensor, "none", R=R, mean=mean, P=P, duration=10.0, rate=1 / DT)
    run = PointwiseFilter(motion, sensor).run(recording)
    ukf = UnscentedKalmanFilter(
        4, 2, DT, hx=lambda x: h(x, None), fx=lambda x, dt: f(x, None, dt),
        points=JulierSigmaPoints(4, 1.0),
    )  # fmt: skip
    ukf.x, ukf.P, ukf.Q, ukf.R = np.array(mean), P.copy(), Q, np.diag(R)
    for t, z in enumerate(recording.measurement[0]):
        if t > 0:
            ukf.predict()
        else:
            ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        # our points are drawn anew from the prediction, FilterPy's are those that were propagated
        ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        ukf.update(z)
        np.testing.assert_allclose(run.mean[0, t], ukf.x, atol=1e-8)


def test_a_filter_that_fails_says_why_and_its_neighbours_do_not_notice():
    def f(x, u, dt):
        with np.errstate(invalid="ignore"):
            return np.sqrt(4.0 - x) + x - np.sqrt(4.0 - x)

    motion = own_motion(("a",), f, (1e-4,))
    sensor = own_sensor(("a",), lambda x, s: x, 1)
    z = np.ones((3, 20, 1)) * [[[1.0]], [[9.0]], [[1.5]]]
    z[2, 5] = np.nan
    recording = recording_of(DT * np.arange(20), z, (0.01,), np.ones((3, 1)), (0.5,))
    run = PointwiseFilter(motion, sensor).run(recording)
    assert run.status.tolist() == [OK, BAD_PREDICTION, OK] and run.failed_at[1] == 1
    assert np.isnan(run.mean[1, 1:]).all()
    alone = PointwiseFilter(motion, sensor).run(recording[[0, 2]])
    np.testing.assert_array_equal(run.mean[[0, 2]], alone.mean)
    np.testing.assert_array_equal(run.nis[[0, 2]], alone.nis)
