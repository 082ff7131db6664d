"""Knobs of single channels: nominal at zero, one channel each, and what they let the agent see."""

import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from rollouts import (
    GNSS,
    TRACKING,
    assert_same,
    change,
    draw,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    zeros,
)

from kfenv.envs.channels import PER_CHANNEL, WINDOWS, beside_others
from kfenv.envs.knobs import NOISE_RANGE
from kfenv.envs.statistics import BOUND

ALL = ["fading", "process_noise", "measurement_noise", "channel_noise"]


def run(env_id, action, seeds=2, **keywords):
    """Estimates (T, B, n) under a constant action."""
    env = make_vec(env_id, seeds, **keywords)
    env.reset(seed=0)
    return np.stack([env.step(zeros(env) + action)[-1]["estimate"] for _ in range(41)])


@every_environment
def test_zero_is_the_nominal_filter_to_the_last_bit(env_id):
    np.testing.assert_array_equal(run(env_id, 0.0, actions=ALL), run(env_id, 0.0))


@every_environment
def test_a_knob_turns_its_channel_alone(env_id):
    channels = make(env_id).scenario.sensor.channels
    recording = draw(env_id, range(2))
    arrived = np.flatnonzero(np.isfinite(recording.measurement[0]).any(axis=0))
    for i in (arrived[0], arrived[-1]):
        noise = recording.noise.copy()
        noise[..., i] *= NOISE_RANGE[1] ** 0.3
        louder = run(env_id, 0.0, recording=change(recording, noise=noise))
        turned = run(env_id, 0.3, recording=recording, actions=[channels[i].name])
        rounding = 10.0 * np.spacing(np.abs(louder).max())  # of places of thousands of kilometres
        np.testing.assert_allclose(turned, louder, rtol=1e-9, atol=max(1e-9, rounding))
        assert np.abs(turned - run(env_id, 0.0, recording=recording)).max() > 1e-6


def test_it_multiplies_what_its_group_does():
    both = run(TRACKING, [0.2, -0.1], actions=["range_noise", "range"])
    factor = NOISE_RANGE[1] ** 0.2 * NOISE_RANGE[0] ** 0.1
    alone = run(TRACKING, np.log(factor) / np.log(NOISE_RANGE[1]), actions=["range_noise"])
    np.testing.assert_allclose(both, alone, rtol=1e-9, atol=1e-9)


@every_environment
def test_the_default_knobs_are_without_them(env_id):
    env = make(env_id)
    names = {channel.name for channel in env.scenario.sensor.channels}
    assert not names & {knob.name for knob in env.core.knobs}
    assert "innovation_covariance" not in env.reset(seed=0)[1]


@every_environment
def test_one_alone_and_many_together_see_the_same_bits(env_id):
    many = make_vec(env_id, 3, actions=ALL)
    seen, info = many.reset(seed=7)
    alone = [make(env_id, actions=ALL) for _ in range(3)]
    first = [env.reset(seed=7 + i) for i, env in enumerate(alone)]
    for i in range(3):
        assert_same(seen[i], first[i][0])
    for action in random_actions(many.action_space.shape, 20):
        seen, _, terminated, _, info = many.step(action)
        if terminated.any():
            break
        for i, env in enumerate(alone):
            one = env.step(action[i])
            assert_same(seen[i], one[0])
            assert_same(info["innovation_covariance"][i], one[4]["innovation_covariance"])


@every_environment
def test_gymnasium_finds_nothing_to_complain_of(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*not within the.*|.*render.*")
        check_env(make(env_id, actions=["channel_noise"]), skip_render_check=True)


@every_environment
def test_the_observation_has_features_for_each(env_id):
    env = make(env_id, actions=ALL)
    channels, plain = len(env.scenario.sensor.channels), make(env_id)
    names = env.core.feature_names()
    size = plain.observation_space.shape[0] + channels * (PER_CHANNEL + 1)
    assert env.observation_space.shape == (size,) and len(set(names)) == len(names) == size
    heard = play(env, random_actions(env.action_space.shape, 41), seed=3)
    seen = np.stack([step[0] for step in heard])
    assert np.isfinite(seen).all() and all(map(env.observation_space.contains, seen))
    common = plain.observation_space.shape[0] - plain.action_space.shape[0]
    np.testing.assert_array_equal(plain.reset(seed=3)[0][:common], seen[0][:common])
    one = make(env_id, actions=[env.scenario.sensor.channels[1].name])
    assert one.observation_space.shape == (common + PER_CHANNEL + 1,)


@every_environment
def test_the_features_are_what_their_page_says(env_id):
    """By regression of each channel on the others, from what info tells."""
    env = make(env_id, actions=["channel_noise"])
    channels = len(env.scenario.sensor.channels)
    mean, square = np.zeros((channels, len(WINDOWS))), np.ones(channels)
    observation, info = env.reset(seed=1)
    for _ in range(30):
        here = np.flatnonzero(np.isfinite(info["innovation_variance"]))
        S, nu = info["innovation_covariance"], info["innovation"]
        if len(here):
            part = S[np.ix_(here, here)]
            nis = env.core._pending.nis[0]
            squared = nu[here] @ np.linalg.solve(part, nu[here])
            assert squared == pytest.approx(nis, rel=2e-3)  # channels share their curvature
        features = observation[-channels * (PER_CHANNEL + 1) : -channels].reshape(channels, -1)
        for c in range(channels):
            v = 0.0
            if c in here:
                others = here[here != c]
                weights = np.linalg.solve(S[np.ix_(others, others)], S[others, c])
                left = S[c, c] - weights @ S[others, c]
                v = (nu[c] - weights @ nu[others]) / np.sqrt(left)
                mean[c] += (v - mean[c]) / np.array(WINDOWS)
                square[c] += (v * v - square[c]) / WINDOWS[0]
            signed = np.array([v, *mean[c]])
            wanted = [*np.sign(signed) * np.log1p(np.abs(signed)),
                      0.5 * np.log(square[c] + 1e-4), c in here]  # fmt: skip
            np.testing.assert_allclose(features[c], np.clip(wanted, -BOUND, BOUND), atol=1e-4)
        observation, *_, info = env.step(zeros(env))


def test_the_covariance_is_positive_definite_after_a_loss_with_much_process_noise():
    """Where the prediction is so wide that the measurement bends within it."""
    faults = {"pll_failure": {"start": 5.0, "duration": [10.0, 10.0]}}
    env = make_vec(
        GNSS, 8, rate=1.0, duration=20.0, faults=faults, actions=["process_noise", "channel_noise"]
    )
    _, info = env.reset(seed=0)
    action = zeros(env)
    action[:, 0] = 0.75  # a thousand times
    checked = 0
    for _ in range(20):
        for S, variance in zip(
            info["innovation_covariance"], info["innovation_variance"], strict=True
        ):
            here = np.isfinite(variance)
            scale = np.sqrt(np.diag(S)[here])
            if here.any():
                part = S[np.ix_(here, here)] / np.outer(scale, scale)
                assert np.linalg.eigvalsh(part).min() > 0.0
                checked += 1
        info = env.step(action)[-1]
    assert checked > 70


def test_beside_others_is_standard_normal():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 5))
    S = np.broadcast_to(root @ root.T, (20_000, 5, 5))
    nu = rng.standard_normal((20_000, 5)) @ root.T
    nu[:, 3] = np.nan
    S = np.where(np.isnan(nu)[:, :, None] | np.isnan(nu)[:, None, :], 0.0, S)
    residual, deviation = beside_others(nu, S)
    found = residual / deviation
    assert np.isnan(found[:, 3]).all()
    np.testing.assert_allclose(np.std(found, axis=0)[[0, 1, 2, 4]], 1.0, atol=0.02)


def test_biases_are_told_apart_from_noise():
    faults = {"range_step": {"start": 1.0, "duration": [2.0, 2.0], "size": [20.0, 20.0]}}
    stepped, plain = draw(GNSS, [0], faults=faults), draw(GNSS, [0], faults="none")
    bias = stepped.true_bias
    np.testing.assert_allclose(np.abs(bias[bias != 0.0]), 20.0)
    assert (np.abs(bias).max(axis=1) > 0.0).sum() == 1  # one channel
    hit = (bias != 0.0) & np.isfinite(stepped.measurement)
    off = (stepped.measurement - plain.measurement)[hit]
    assert np.abs(off - bias[hit]).max() < 6.0 * 3.2 * 2.0 and not plain.true_bias.any()
