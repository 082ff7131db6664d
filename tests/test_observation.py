"""The observation: bounded, finite, fresh, as documented, and nothing in it needs the truth."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from rollouts import (
    VALIDATION,
    change,
    draw,
    error_name,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    zeros,
)

from kfenv.envs.statistics import BOUND, COMMON, PER_GROUP, WINDOWS

SETTINGS = [
    {"duration": 12.0, "faults": "random"},
    {"rate": 1.0, "duration": 30.0, "noise": 30.0},
    {"actions": ["fading"], "decision_interval": 4},
    {"reward": "improvement"},
]


def settings_of(env_id, setting):
    setting = dict(setting)
    noise = setting.pop("noise", None)
    if noise and env_id == VALIDATION:
        setting["noise_deviation"] = (noise, 1.0, 1.0)
    return setting


@every_environment
@pytest.mark.parametrize("setting", SETTINGS)
def test_bounded_finite_and_float32(env_id, setting):
    env = make_vec(env_id, 8, **settings_of(env_id, setting))
    space = env.single_observation_space
    assert space.dtype == np.float32 and space.is_bounded()
    rng = np.random.default_rng(0)
    observations = [env.reset(seed=0)[0]]
    for _ in range(130):  # wild: some tracks are lost, most filters mistuned
        observations.append(env.step(rng.choice([-1.0, 1.0, 0.0], env.action_space.shape))[0])
    for observation in observations:
        assert observation.dtype == np.float32 and np.isfinite(observation).all()
        assert env.observation_space.contains(observation)
    everything = np.concatenate(observations)
    assert (everything.min(0) < everything.max(0)).all()  # no feature is dead


@every_environment
def test_bounded_and_finite_where_the_world_goes_mad(env_id):
    def spoil(measurement):
        measurement[:, 5:8] = np.resize([1e9, 3.0, -3.0], measurement.shape[2])
        measurement[:, 10:20, 1] = np.nan
        measurement[:, 20:] = np.nan

    recording = change(draw(env_id, range(2)), measurement=spoil)
    env = make(env_id, recording=recording)
    for action in (0.0, -1.0, 1.0):
        for observation, *_ in play(env, zeros(env, 60) + action):
            assert env.observation_space.contains(observation) and np.isfinite(observation).all()


@every_environment
def test_the_truth_is_not_in_it(env_id):
    recording = draw(env_id, range(2))
    actions = random_actions(make_vec(env_id, 2).action_space.shape, 12)
    away = min(123.0, 0.1 * make(env_id).scenario.lost_distance)
    untrue = change(
        recording, truth=recording.truth + away, true_noise=recording.true_noise * 3,
        true_bias=recording.true_bias + 1.0,
    )  # fmt: skip
    unknown = change(recording, truth=None, true_noise=None, true_bias=None, faults=())
    heard = []
    for told in (recording, untrue, unknown):
        env = make_vec(env_id, 2, recording=told)
        steps = [env.reset(seed=0), *(env.step(a) for a in actions)]
        heard.append(np.stack([step[0] for step in steps]))
        assert ("truth" in steps[-1][-1]) == ("nees" in steps[-1][-1]) == (told is not unknown)
    np.testing.assert_array_equal(heard[0], heard[1])
    np.testing.assert_array_equal(heard[0], heard[2])


@every_environment
def test_without_truth_an_episode_runs_to_its_end_unrewarded(env_id):
    recording = change(draw(env_id, [0]), truth=None)
    env = make(env_id, recording=recording)
    heard = play(env, zeros(env, 99))
    assert len(heard) == 1 + len(recording.time) and heard[-1][3] and not heard[-1][2]
    assert all(step[1] == 0.0 and error_name(env_id) not in step[4] for step in heard[1:])


@every_environment
@pytest.mark.parametrize("num_envs", [None, 3])
def test_what_is_handed_out_is_never_written_again(env_id, num_envs):
    env = make(env_id) if num_envs is None else make_vec(env_id, num_envs)
    kept = [env.reset(seed=0)]
    copies = [[np.copy(array) for array in arrays(kept[0])]]
    for action in random_actions(env.action_space.shape, 50):  # and over the episode's end
        step = env.step(action)
        if num_envs is None and (step[2] or step[3]):
            step = env.reset()
        kept.append(step)
        copies.append([np.copy(array) for array in arrays(step)])
    for step, copy in zip(kept, copies, strict=True):
        for array, value in zip(arrays(step), copy, strict=True):
            np.testing.assert_array_equal(array, value)
    for one, other in pairwise(kept):
        assert not any(np.shares_memory(a, b) for a in arrays(one) for b in arrays(other))


def arrays(step) -> list[np.ndarray]:
    """Every array in what reset or step returned."""
    if isinstance(step, dict):
        return [array for value in step.values() for array in arrays(value)]
    if isinstance(step, tuple):
        return [array for value in step for array in arrays(value)]
    return [step] if isinstance(step, np.ndarray) and step.dtype != object else []


@every_environment
def test_writing_into_what_was_handed_out_harms_nobody(env_id):
    one, other = make(env_id), make(env_id)
    heard, echo = one.reset(seed=0), other.reset(seed=0)
    for action in random_actions(one.action_space.shape, 20):
        for array in arrays(heard):
            array[...] = 7
        heard, echo = one.step(action), other.step(action)
        np.testing.assert_array_equal(heard[0], echo[0])
        np.testing.assert_array_equal(heard[4]["estimate"], echo[4]["estimate"])


@every_environment
def test_it_ends_with_the_previous_action(env_id):
    env = make(env_id)
    (knobs,) = env.action_space.shape
    assert not env.reset(seed=0)[0][-knobs:].any()
    for action in random_actions((knobs,), 10):
        observation = env.step(action)[0]
        np.testing.assert_array_equal(observation[-knobs:], action)
    assert not env.reset()[0][-knobs:].any()
    assert (env.observation_space.high[-knobs:] == 1.0).all()
    assert (env.observation_space.high[:-knobs] == BOUND).all()


@every_environment
@pytest.mark.parametrize(("actions", "others", "noise"), [
    (None, 2, True), (["fading"], 1, False), (["measurement_noise", "fading"], 1, True),
])  # fmt: skip
def test_every_component_has_a_name_of_its_own(env_id, actions, others, noise):
    env = make(env_id, actions=actions)
    groups = len(env.scenario.sensor.groups)
    common = COMMON - (not env.scenario.yardstick.rates)
    size = groups * PER_GROUP + common + others + groups * noise
    names = env.core.feature_names()
    assert len(names) == len(set(names)) == size
    assert env.observation_space.shape == env.reset(seed=0)[0].shape == (size,)
    assert make_vec(env_id, 2, actions=actions).single_observation_space.shape == (size,)


@every_environment
def test_the_features_are_what_their_page_says(env_id):
    """Against the pending innovations that info tells."""
    env = make(env_id, duration=12.0)
    sensor, yardstick = env.scenario.sensor, env.scenario.yardstick
    groups = [np.flatnonzero(np.array(sensor.group_of_channel) == g)
              for g in range(len(sensor.groups))]  # fmt: skip
    observation, info = env.reset(seed=4)
    squares, (lag, last) = np.ones((len(groups), 3)), np.zeros((2, len(groups)))
    since, time, step = 0.0, 0.0, 0.1
    scale = env.scenario.error_scale
    while True:
        arrived = np.isfinite(info["innovation_variance"])
        scaled = info["innovation"] / np.sqrt(info["innovation_variance"])
        whitened = env.core._pending.whitened[0]
        if arrived.any():  # of the channels present the first is whitened by itself
            first = np.argmax(arrived)
            np.testing.assert_allclose(whitened[first], scaled[first], rtol=1e-9)
        since = 0.0 if arrived.any() else since + (step if time > 0.0 else 0.0)
        for g, channels in enumerate(groups):
            here = channels[arrived[channels]]
            part = observation[7 * g : 7 * g + 7]
            value = share = 0.0
            if len(here):
                value = whitened[here].sum() / np.sqrt(len(here))
                squares[g] += (np.mean(whitened[here] ** 2) - squares[g]) / np.array(WINDOWS)
                lag[g] += (value * last[g] - lag[g]) / WINDOWS[-1]
                last[g] = value
                share = np.mean((info["noise"] ** 2 / info["innovation_variance"])[here])
            assert part[0] == pytest.approx(np.sign(value) * np.log1p(abs(value)), abs=1e-5)
            np.testing.assert_allclose(part[1:4], 0.5 * np.log(squares[g] + 1e-4), atol=1e-5)
            correlation = np.clip(lag[g] / (squares[g, -1] + 1e-4), -1.0, 1.0)
            assert part[4] == pytest.approx(correlation, abs=1e-5)
            assert part[5] == pytest.approx(len(here) / len(channels), abs=1e-6)
            assert part[6] == pytest.approx(share, abs=1e-5) and part[6] <= 1.0
        common = observation[7 * len(groups) :]
        assert common[0] == pytest.approx(np.log1p(since), abs=1e-5)
        predicted = env.core._pending.factor[0]
        variance = np.diag(predicted @ predicted.T)
        for feature, rows, unit in zip(
            common[1:], (yardstick.states, yardstick.rates), (scale, 0.1 * scale), strict=False
        ):
            spread = np.sqrt(variance[list(rows)].sum())
            if not rows:  # the next feature is another
                continue
            assert feature == pytest.approx(np.log(spread / unit), abs=1e-5)
        observation, _, terminated, truncated, info = env.step(zeros(env))
        time += step
        if terminated or truncated:
            break
    present = 7 * np.arange(len(groups))[:, None] + [0, 5, 6]
    assert time > 5.0 and not observation[present].any()  # nothing is pending


@every_environment
def test_the_measurement_is_pending_when_the_agent_decides(env_id):
    """An outlier shows before the step that would take it in."""

    def outlier(measurement):
        measurement[:, 20, 0] += 1e4

    recording = draw(env_id, [0], faults="none")
    spoilt = change(recording, measurement=outlier)
    plain, warned = make(env_id, recording=recording), make(env_id, recording=spoilt)
    plain.reset(), warned.reset()
    for k in range(1, 21):
        one, other = plain.step(zeros(plain)), warned.step(zeros(warned))
        np.testing.assert_array_equal(one[4]["estimate"], other[4]["estimate"])
        assert (one[0][0] == other[0][0]) == (k < 20)
    assert other[0][0] > 2.0
    assert isinstance(plain, gym.Env)
