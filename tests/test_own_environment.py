"""A user's own model in the environment: simulated, replayed, scored, contested."""

import pickle

import gymnasium as gym
import numpy as np
import pendulum
import pytest
from kfenv.agents.contest.contest import Contest
from kfenv.agents.contest.evaluation import evaluate
from kfenv.agents.contest.rollout import rollout, scenario_and_options
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.jobs.task import Task, run_packed
from numpy_models import DT, SWING, linear, numpy_pendulum, swing
from rollouts import OWN, assert_same, play, random_actions, zeros

from kfenv.models.model import Component, Sensor
from kfenv.models.namespaces import scalar
from kfenv.models.own import own_motion, own_sensor
from kfenv.models.yardstick import Yardstick
from kfenv.scenarios.faults import Jamming
from kfenv.scenarios.own import OwnFilter, recording_of, simulate


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
