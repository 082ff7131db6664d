"""Rewards without truth: the likelihood of the next innovation, and its consistency."""

import gymnasium as gym
import numpy as np
import pytest
from rollouts import (
    BISTATIC,
    GNSS,
    INERTIAL,
    TRACKING,
    change,
    draw,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    zeros,
)

from kfenv.envs.rewards import LABEL_FREE
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs, measured

every_reward = pytest.mark.parametrize("reward", LABEL_FREE)


def log_likelihoods(env, recording, process_noise, noise, steps):
    """Of every instant's innovation, of the first episode under constant factors."""
    scenario = env.scenario
    engine = Engine(scenario.motion, scenario.sensor)
    knobs = Knobs(np.ones(1), np.full(1, process_noise))
    mean, factor, status, told = recording.mean, recording.factor, np.zeros(1, np.int64), []
    dt = np.diff(recording.time, prepend=recording.time[0])
    for t in range(steps):
        inputs = recording.motion_inputs[:, t].copy()
        predicted = engine.predict(mean, factor, inputs, dt[t : t + 1], status)
        if t == 0:
            predicted = predicted._replace(mean=mean, root=factor, noise=np.zeros_like(factor))
        arrived = measured(recording, t)
        arrived = arrived._replace(noise=noise * arrived.noise)
        update = engine.update(predicted, knobs, arrived, status)
        mean, factor = update.mean, update.factor
        told.append(update.log_likelihood[0])
    return np.array(told)


@pytest.mark.parametrize("env_id", [TRACKING, GNSS])  # a noise told anew each time; satellites
def test_for_constant_knobs_it_is_the_filters_own_likelihood(env_id):
    """Over the nominal filter's, per channel; but for the first, which all know alike."""
    recording = draw(env_id, [0], faults="none")
    groups = make(env_id).scenario.sensor.groups
    factors = {"process_noise": 1.1, **{f"{group}_noise": 1.2 for group in groups}}
    env = make(env_id, recording=recording, reward="likelihood", actions=list(factors))
    high = {"process_noise": 1e4}
    action = [np.log(f) / np.log(high.get(name, 500.0)) for name, f in factors.items()]
    earned = [step[1] for step in play(env, [action] * 41)[1:]]
    channels = np.isfinite(recording.measurement[0]).sum(axis=1)[1:]
    tuned = log_likelihoods(env, recording, 1.1, 1.2, 41)[1:]
    nominal = log_likelihoods(env, recording, 1.0, 1.0, 41)[1:]
    gain = np.append((tuned - nominal) / np.maximum(channels, 1), 0.0)
    interval = env.core.interval
    wanted = [gain[k : k + interval].sum() for k in range(0, 41, interval)]
    assert np.abs(wanted).max() < 3.0 and np.abs(wanted).sum() > 0.1
    np.testing.assert_allclose(earned, wanted, rtol=1e-6, atol=1e-9)


@every_environment
@every_reward
def test_no_truth_is_needed(env_id, reward):
    recording = draw(env_id, [0])
    heard = []
    for told in (recording, change(recording, truth=None, scored=None)):
        env = make(env_id, recording=told, reward=reward)
        actions = random_actions(env.action_space.shape, 41)
        heard.append([step[1] for step in play(env, actions)[1:]])
    assert heard[0] == heard[1] and np.ptp(heard[0]) > 1e-3


@every_environment
@every_reward
def test_alone_or_in_a_batch_the_same_bits(env_id, reward):
    many = make_vec(env_id, 3, reward=reward)
    actions = random_actions(many.single_action_space.shape, 20)
    many.reset(seed=5)
    together = np.array([many.step(np.tile(action, (3, 1)))[1] for action in actions])
    for i in range(3):
        alone = [step[1] for step in play(make(env_id, reward=reward), actions, seed=5 + i)[1:]]
        np.testing.assert_array_equal(alone, together[: len(alone), i])


@every_environment
def test_the_nominal_filter_gains_no_likelihood_on_itself(env_id):
    env = make(env_id, reward="likelihood")
    assert all(step[1] == 0.0 for step in play(env, zeros(env, 41), seed=0)[1:])


def test_the_innovation_that_is_decided_on_buys_nothing():
    """Only the next one counts: a wild pending one may be believed or not, the rest deaf."""
    recording = draw(BISTATIC, [0], faults="none")

    def wild(measurement):
        measurement[:, 10] += 1e3
        measurement[:, 11:] = np.nan

    env = make(BISTATIC, recording=change(recording, measurement=wild), reward="likelihood")
    env.reset()
    earned = [env.step(zeros(env) + 0.5 * (k >= 9))[1] for k in range(15)]
    assert earned[9] == 3.0 and not any(earned[:9]) and not any(earned[10:])


def test_consistency_is_best_where_the_noise_is_as_told():
    """Of a linear filter whose truth moves as it believes: the noise, then the process noise."""
    env_id, kept = "kfenv/BistaticTracking-v0", {"faults": "none", "duration": 20.0}
    env = make_vec(env_id, 16, reward="consistency", **kept)

    def mean_reward(knob, action):
        actions = zeros(env)
        actions[:, knob] = action
        env.reset(seed=0)
        return np.mean([env.step(actions)[1] for _ in range(150)][50:])

    best = mean_reward(2, 0.0)
    assert -0.5 < best < 0.0
    assert mean_reward(2, 0.2) < best - 0.2 and mean_reward(2, -0.4) < best - 0.2


@every_reward
def test_a_gaussian_sum_foresees_by_its_nominal_component(reward):
    env = make(INERTIAL, reward=reward, filter="gsckf")
    heard = play(env, random_actions(env.action_space.shape, 4), seed=0)
    assert np.isfinite([step[1] for step in heard[1:]]).all()


def test_an_unknown_reward_names_them_all():
    with pytest.raises(ValueError, match=r"likelihood.*consistency"):
        gym.make(BISTATIC, reward="truth")
