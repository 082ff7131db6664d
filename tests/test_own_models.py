"""Models of a user's own: any size, by namespace or NumPy, and one sentence for each mistake."""

import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pendulum
import pytest
from filterpy.kalman import JulierSigmaPoints, KalmanFilter, UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from kfenv.agents.contest.contest import Contest
from kfenv.agents.contest.evaluation import evaluate
from kfenv.agents.contest.rollout import rollout, scenario_and_options
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.jobs.task import Task, run_packed
from numba import njit
from pairs import PAIRS
from rollouts import OWN, assert_same, play, random_actions, zeros

from kfenv.envs.loop import make_filter
from kfenv.filters.engine import Engine
from kfenv.filters.fingerprint import fingerprint
from kfenv.filters.pointwise import PointwiseFilter
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.replay import replay
from kfenv.filters.results import BAD_PREDICTION, OK
from kfenv.models.model import Component, Sensor
from kfenv.models.namespaces import batch, compiled, dual, lanes, scalar
from kfenv.models.own import own_motion, own_sensor
from kfenv.models.turns import undeclared_angles
from kfenv.models.yardstick import Yardstick
from kfenv.scenarios.faults import Jamming, SignalLoss
from kfenv.scenarios.own import OwnFilter, recording_of, simulate

DT = 0.1
SWING = {"R": (0.01,), "mean": (1.0, 0.0), "P": (0.1, 0.1), "duration": 4.0, "rate": 20.0}


def swing(x, u, dt):
    faster = x[1] - 9.81 * dt * np.sin(x[0])
    return np.array([x[0] + dt * faster, faster])


def numpy_pendulum():
    motion = own_motion((pendulum.ANGLE, pendulum.RATE), swing, Q=(0.0, 1e-3))
    return motion, own_sensor((pendulum.ANGLE,), lambda x, s: x[:1], states=2)


def linear(n, m, seed=0):
    """A stable linear model of n states and m channels, its Q and R, as matrices."""
    rng = np.random.default_rng(seed)
    F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    H = rng.normal(size=(m, n))
    half = rng.normal(size=(n, n))
    return F, H, 0.1 * half @ half.T / n, rng.uniform(0.2, 2.0, m) ** 2


def linear_models(F, H, Q):
    motion = own_motion([f"x{i}" for i in range(len(F))], lambda x, u, dt: F @ x, Q)
    return motion, own_sensor([f"z{i}" for i in range(len(H))], lambda x, s: H @ x, len(F))


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


# ----- the environment ----------------------------------------------------------------


def test_the_vector_environment_has_the_bits_of_the_single_one():
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    vector = gym.make_vec(OWN, num_envs=3, **kwargs)
    actions = random_actions(vector.action_space.shape, 30)
    heard = [vector.reset(seed=7), *(vector.step(a) for a in actions)]
    for i in range(3):
        single = play(gym.make(OWN, **kwargs).unwrapped, [a[i] for a in actions], seed=7 + i)
        for (observation, *_), (together, *_) in zip(single, heard, strict=False):
            np.testing.assert_array_equal(observation, together[i])


def test_a_recording_is_replayed_and_split():
    motion, sensor = numpy_pendulum()
    recording = simulate(motion, sensor, episodes=10, **SWING)
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05}
    env = gym.make(OWN, recording=recording, **kwargs).unwrapped
    heard = play(env, zeros(env, 99), seed=0)
    assert heard[-1][3] and heard[-1][4]["time"] == recording.time[-1]
    np.testing.assert_array_equal(heard[3][4]["truth"], recording.truth[0, 2])
    scenario, _ = scenario_and_options(OWN, kwargs | {"recording": recording})
    parts = [scenario.recorded(split, 99) for split in ("tuning", "validation", "test")]
    assert [len(part) for part in parts] == [4, 2, 4]
    np.testing.assert_array_equal(parts[2].truth, recording.truth[6:])
    drawn = scenario.sample([np.random.default_rng(i) for i in range(5)])
    assert all((t == parts[0].truth).all(axis=(1, 2)).any() for t in drawn.truth)


def test_a_recording_is_made_of_plain_arrays():
    recording = recording_of(
        DT * np.arange(5), np.arange(10.0).reshape(5, 2), R=(1.0, 4.0), mean=(0.0, 0.0, 0.0),
        P=np.eye(3), truth=np.zeros((5, 3)),
    )  # fmt: skip
    assert len(recording) == 1 and recording.noise[0, 0].tolist() == [1.0, 2.0]
    np.testing.assert_array_equal(recording.factor[0], np.eye(3))
    assert len(recording_of(DT * np.arange(5), np.zeros((4, 5, 1)), (1.0,), (0.0,), (1.0,))) == 4


def test_what_is_scored_may_be_a_function_with_scales_of_their_own():
    """A tip's place, of a pendulum: error and NEES by hand."""

    def tip(x, s):
        return np.array([np.sin(x[0]), -np.cos(x[0])])

    motion, sensor = numpy_pendulum()
    where = own_sensor((Component("across", "m"), Component("up", "m")), tip, 2)
    kwargs = {"motion": motion, "sensor": sensor, "scored": where, "scale": (0.1, 0.2)} | SWING
    env = gym.make(OWN, **kwargs).unwrapped
    *_, info = play(env, zeros(env, 20), seed=3)[-1]
    off = (tip(info["estimate"], None) - tip(info["truth"], None)) / (0.1, 0.2)
    assert info["scored_error"] == pytest.approx(np.hypot(*off), rel=1e-9)
    L, x = env.core._update.factor[0], info["estimate"]
    rows = [0.5 * (tip(x + column, None) - tip(x - column, None)) / (0.1, 0.2) for column in L.T]
    S = np.array(rows).T @ np.array(rows)
    with np.errstate(all="ignore"):
        assert np.isfinite(info.get("nees", 0.0))
        if np.linalg.cond(S) < 1e8:
            assert info["nees"] == pytest.approx(off @ np.linalg.solve(S, off), rel=1e-6)
    agents = [rollout(make_agent(name), OWN, kwargs, simulate(motion, sensor, episodes=3, **SWING))
              for name in ("fixed", "srukf-joseph-exact")]  # fmt: skip
    np.testing.assert_allclose(agents[0].rmse, agents[1].rmse, rtol=1e-6)


def test_a_scored_angle_is_wrapped():
    yardstick = Yardstick("scored", (pendulum.ANGLE,), (0,))
    estimate, truth = np.array([[3.1, 0.0]]), np.array([[-3.1, 0.0]])
    assert yardstick.off(estimate, truth)[0, 0] == pytest.approx(6.2 - 2.0 * np.pi)
    motion, sensor = numpy_pendulum()
    start = SWING | {"mean": (3.1, 4.0), "P": (1e-3, 1e-3)}
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | start
    env = gym.make(OWN, faults="none", **kwargs).unwrapped
    errors = [step[4]["scored_error"] for step in play(env, zeros(env, 40), seed=1)[1:]]
    assert max(errors) < 1.0


def test_simulation_is_what_it_says():
    """Process noise, measurement noise and start have the told covariances; inputs are kept."""
    F, H, Q, R = linear(2, 1)
    motion = own_motion(("a", "b"), lambda x, u, dt: F @ x + u[:1], Q, inputs=("push",))
    sensor = own_sensor(("z",), lambda x, s: H @ x, 2)
    push = np.sin(np.arange(201.0))[:, None]
    recording = simulate(
        motion, sensor, "none", episodes=40, R=R, mean=(5.0, -5.0), P=np.diag([4.0, 1.0]),
        duration=20.0, rate=10.0, inputs=push,
    )  # fmt: skip
    np.testing.assert_array_equal(recording.motion_inputs[3], push)
    driven = recording.truth[:, 1:] - recording.truth[:, :-1] @ F.T - push[1:]
    np.testing.assert_allclose(np.cov(driven.reshape(-1, 2).T), Q, atol=0.05 * Q.max())
    off = recording.measurement - recording.truth @ H.T
    assert np.var(off) == pytest.approx(R[0], rel=0.05)
    assert np.std(recording.truth[:, 0, 0] - 5.0) == pytest.approx(2.0, rel=0.4)
    again = simulate(motion, sensor, "none", episodes=2, R=R, mean=(5.0, -5.0),
                     P=np.diag([4.0, 1.0]), duration=20.0, rate=10.0, inputs=push)  # fmt: skip
    np.testing.assert_array_equal(again.measurement, recording.measurement[:2])


def test_rare_measurements():
    motion, sensor = numpy_pendulum()
    recording = simulate(motion, sensor, "none", measure_every=4, **SWING)
    arrived = ~np.isnan(recording.measurement[0, :, 0])
    assert arrived[::4].all() and arrived.sum() == len(arrived[::4])


@pytest.mark.parametrize("agent", ["huber-gate", "vb-noise", "sage-husa", "hmm-noise", "random",
                                   "clairvoyant-rq", "ckf", "gsackf", "ekf-joseph"])  # fmt: skip
def test_agents_play_on_numpy_models(agent):
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    recording = simulate(motion, sensor, (Jamming(bursts=(1, 1)),), episodes=2, **SWING)
    scores = rollout(make_agent(agent), OWN, kwargs, recording)
    assert np.isfinite(scores.rmse).all() and not scores.lost.any()


def test_models_and_scenarios_travel_to_other_processes():
    motion, sensor = pendulum.MODEL["motion"], pendulum.MODEL["sensor"]
    scenario = OwnFilter(motion=motion, sensor=sensor, scored=("angle",), scale=0.05, **SWING)
    copy = pickle.loads(pickle.dumps(scenario))
    one, other = (s.sample([np.random.default_rng(4)]) for s in (scenario, copy))
    assert_same(one.measurement, other.measurement)


def test_a_contest_takes_objects_and_knows_them_again(tmp_path):
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    contest = Contest(OWN, kwargs, ("huber-gate",), 6, 1, tuning_trials=0)
    results = evaluate(contest, tmp_path / "out", processes=1)
    assert {r["agent"] for r in results} == {"fixed", "huber-gate"}
    assert all(r["unit"] == "rad" and r["scored"] == "angle" for r in results)
    assert evaluate(contest, tmp_path / "out", processes=1, resume=True) == results
    other = own_motion((pendulum.ANGLE, pendulum.RATE), swing, Q=(0.0, 2e-3))
    with pytest.raises(ValueError, match="holds another contest"):
        changed = Contest(OWN, kwargs | {"motion": other}, ("huber-gate",), 6, 1, tuning_trials=0)
        evaluate(changed, tmp_path / "out", processes=1, resume=True)


def test_what_has_no_name_travels_to_workers():
    def slope(job):
        motion = own_motion(("a",), lambda x, u, dt: job * x, (1.0,))
        return motion.build(scalar).step((2.0,), (), 0.1)

    assert run_packed(Task(slope, None).packed(), 3.0) == (6.0,)


def test_the_command_line_finds_a_model_by_its_module():
    scenario = OwnFilter(
        motion="kfenv.models.robot:robot", sensor="kfenv.models.robot:beacons", scored=("x", "y"),
        scale=0.1, R=(0.01,) * 4, mean=(1.0, 1.0, 0.0), P=(0.1,) * 3,
        inputs=lambda rng, time: np.zeros((len(time), 2)),
    )  # fmt: skip
    assert scenario.motion.name == "robot" and isinstance(scenario.sensor, Sensor)


# ----- one sentence for each mistake --------------------------------------------------


def a_branch(xp):
    @xp.function
    def step(x, u, dt):
        return (x[0] if x[0] > 0.0 else -x[0], x[1])

    return step


def a_math_function(xp):
    from math import sin

    @xp.function
    def step(x, u, dt):
        return sin(x[0]), x[1]

    return step


def a_numpy_function(xp):
    @xp.function
    def step(x, u, dt):
        return np.sin(x[0]), x[1]

    return step


def a_missing_function(xp):
    @xp.function
    def step(x, u, dt):
        return xp.tanh(x[0]), x[1]

    return step


def too_few(xp):
    @xp.function
    def step(x, u, dt):
        return (x[0],)

    return step


def a_list(xp):
    @xp.function
    def step(x, u, dt):
        return [x[0], x[1]]

    return step


def undecorated(xp):
    def step(x, u, dt):
        return x[0], x[1]

    return step


def other_states(xp):
    @xp.function
    def step(x, u, dt):
        a, b, c = x
        return a, b + c

    return step


def an_input_too_many(xp):
    @xp.function
    def step(x, u, dt):
        return x[0] + u[0], x[1]

    return step


@pytest.mark.parametrize(("f", "words"), [
    (a_branch, r"f \(line \d+ of test_own_models.py\) branches on a component.*xp.maximum"),
    (a_math_function, r"f \(line \d+.*gives a component to a function for single numbers.*`math`"),
    (a_numpy_function, r"f .*gives a component to NumPy.*namespace's functions"),
    (a_missing_function, r"f .*asks the namespace for tanh, and it has .*sqrt"),
    (too_few, r"f returns 1 components for 2 states \(a, b\): return one for each"),
    (a_list, r"f returns a list, expected a tuple of 2 components \(a, b\)"),
    (undecorated, r"f\(xp\) gives a function without a decorator.*@xp.function"),
    (other_states, r"f .*other components than it is given, which are 2 states and 0 inputs"),
    (an_input_too_many, r"f .*other components than it is given, which are 2 states and 0 inputs"),
    (lambda x, u, dt: x[:1], r"f gives an array of shape \(1,\).*there are 2 states"),
    (lambda x, u, dt: np.array([x[0], x[2]]), r"f fails for a state of shape \(2,\).*IndexError"),
    (lambda x, u: x, r"f\(xp\) or f\(x, u, dt\)"),
    (3, r"f\(xp\) or f\(x, u, dt\), got 3"),
])  # fmt: skip
def test_a_mistake_in_a_function_is_one_sentence(f, words):
    with pytest.raises(ValueError, match=words) as caught, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        own_motion(("a", "b"), f, (1.0, 1.0))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("h", [lambda x: x[:1], lambda x: np.array([x[0] + 1.0]), lambda x: 2 * x])
def test_a_sensor_as_other_libraries_have_it_is_told_its_form(h):
    with pytest.raises(ValueError, match=r"h .*of one argument is given the namespace.*h\(x, s\)"):
        own_sensor(("a",), h, 2)


def test_what_only_the_compiler_refuses_is_one_sentence_too():
    def f(xp):
        def half(value):  # lacks its decorator
            return 0.5 * value

        @xp.function
        def step(x, u, dt):
            return (half(x[0]),)

        return step

    engine = Engine(own_motion(("a",), f, (1.0,)), own_sensor(("a",), a_copy, 1))
    still, sound = np.zeros((1, 1)), np.zeros(1, np.int64)
    words = r"cannot compile the model: 'half' .*@xp\.function"
    with pytest.raises(ValueError, match=words) as told:
        engine.predict(still, np.ones((1, 1, 1)), np.zeros((1, 0)), np.full(1, DT), sound)
    assert "\n" not in str(told.value)


def a_copy(xp):
    @xp.function
    def measure(x, s):
        return (x[0],)

    return measure


@pytest.mark.parametrize(("Q", "words"), [
    ([[1.0, 2.0], [2.0, 1.0]], r"Q must not have a negative eigenvalue.*smallest.* is -1"),
    ((1.0, 2.0, 3.0), r"Q has shape \(3,\), expected \(2, 2\)"),
    ([[1.0, 0.5], [0.0, 1.0]], r"Q is not symmetric"),
    ((1.0, np.nan), r"Q holds NaN"),
    ("big", r"Q must be an array of numbers"),
])  # fmt: skip
def test_a_covariance_that_is_none_is_refused(Q, words):
    with pytest.raises(ValueError, match=words):
        own_motion(("a", "b"), lambda x, u, dt: x, Q)


@pytest.mark.parametrize(("changes", "words"), [
    ({"scored": ("angel",)}, "Unknown state to be scored 'angel'. Did you mean 'angle'"),
    ({"scored": "angle"}, "scored must name the states.*as a tuple"),
    ({"scored": None}, "scored must name the states"),
    ({"scale": None}, "scale must be the error that is just good enough"),
    ({"scored": ("angle", "rate")}, r"one number for each of angle \(rad\), rate \(rad/s\)"),
    ({"scale": (0.1, 0.2)}, "scale has 2 numbers for 1 scored"),
    ({"lost": 0.5}, "lost must be a number of scales above 1"),
    ({"R": (0.0,)}, "R must be positive definite"),
    ({"P": ((1.0, 2.0), (2.0, 1.0))}, "P must be positive definite"),
    ({"mean": (1.0,)}, "mean must hold a number for each of angle, rate"),
    ({"R": None}, "R must be given to simulate the model"),
    ({"motion": "no_such_module:it"}, "motion='no_such_module:it' leads nowhere"),
    ({"motion": 3}, "motion must be a Motion"),
    ({"sensor": None}, "sensor must be a Sensor"),
    ({"recording": 3}, "recording must be a kfenv Recording"),
    ({"measure_every": 0}, "measure_every must be a whole number"),
    ({"scored_rates": ("angle", "rate")}, "scored_rates must name a state for each of the 1"),
])  # fmt: skip
def test_a_wrong_argument_is_one_sentence(changes, words):
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    with pytest.raises(ValueError, match=words):
        gym.make(OWN, **(kwargs | changes))


def test_an_angle_that_is_not_declared_is_found():
    motion, _ = numpy_pendulum()
    plain = own_sensor((Component("angle", "rad"),), lambda x, s: x[:1], 2)
    with pytest.raises(ValueError, match="'angle' jumps by a turn and is not declared an angle"):
        simulate(motion, plain, "none", **(SWING | {"mean": (3.1, 4.0)}))


@pytest.mark.parametrize(("angles", "found"), [
    ((False, False), ["state 'angle'", "channel 'angle'"]),
    ((True, False), ["channel 'angle'"]),
    ((True, True), []),
])  # fmt: skip
def test_an_angle_declared_nowhere_is_found_by_a_turn_more_of_it(angles, found):
    state, channel = (Component("angle", "rad", angle=angle) for angle in angles)
    motion = own_motion((state, "rate"), swing, Q=(0.0, 1e-3))
    sensor = own_sensor((channel,), lambda x, s: x[:1], states=2)
    assert undeclared_angles(motion, sensor) == found
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        OwnFilter(motion=motion, sensor=sensor, scored=("angle",), scale=0.05, **SWING)
    assert [str(warning.message).partition(" is")[0].partition(" are")[0] for warning in told] == (
        [f"The {', the '.join(found)}"] if found else []
    )


@pytest.mark.parametrize("name", PAIRS)
def test_what_is_no_angle_or_declared_one_is_not_taken_for_one(name):
    motion, sensor, _ = PAIRS[name]
    assert undeclared_angles(motion, sensor) == []
    bare = [replace(part, angle=False) for part in motion.states]
    angles = [f"state {state.name!r}" for state in motion.states if state.angle]
    found = undeclared_angles(replace(motion, states=tuple(bare)), sensor)
    assert [one for one in found if "state" in one] == angles


def test_correlated_noise_has_a_remedy():
    motion, sensor = linear_models(*linear(2, 2)[:3])
    with pytest.raises(ValueError, match=r"R must be diagonal.*inverse of its Cholesky factor"):
        simulate(motion, sensor, R=[[1.0, 0.5], [0.5, 1.0]], mean=(0.0, 0.0), P=(1.0, 1.0))


def test_missing_inputs_are_asked_for():
    motion = own_motion(("a",), lambda x, u, dt: x + u, (1.0,), inputs=("push",))
    sensor = own_sensor(("a",), lambda x, s: x, 1)
    with pytest.raises(ValueError, match=r"inputs must be an array of shape \(41, 1\) \(push at"):
        simulate(motion, sensor, R=(1.0,), mean=(0.0,), P=(1.0,), duration=4.0, rate=10.0)
    told = {"R": (1.0,), "mean": (0.0,), "P": (1.0,), "duration": 4.0, "rate": 10.0}
    with pytest.raises(ValueError, match=r"inputs must be an array of shape \(41, 1\)"):
        simulate(motion, sensor, inputs={"push": 1}, **told)


def test_who_needs_the_engine_refuses_numpy_models():
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    scenario, options = scenario_and_options(OWN, kwargs)
    assert isinstance(make_filter(scenario, options), PointwiseFilter)
    with pytest.raises(ValueError, match="okf works with the compiled filter, which cannot run"):
        make_agent("okf").check(scenario, options, simulate(motion, sensor, **SWING))
    with pytest.raises(ValueError, match=r"the compiled engine cannot run.*f\(xp\)"):
        Engine(motion, sensor)
