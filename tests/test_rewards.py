"""Rewards: minus RMSE over the scale, or improvement on the nominal filter; what loss costs."""

import numpy as np
import pytest
from rollouts import (
    change,
    draw,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    zeros,
)
from test_zero_action_is_nominal import nominal_run

CAP = {"rmse": 10.0, "improvement": 3.0}
intervals = pytest.mark.parametrize("interval", [1, 4])
rewards = pytest.mark.parametrize("reward", CAP)


def errors_of(env_id, recording, actions, interval):
    """Position errors of every filter step, each action held for the interval."""
    held = np.repeat(actions, interval, axis=0)
    heard = play(make(env_id, recording=recording), held)
    return np.array([step[4]["position_error"] for step in heard[1:]])


def grouped(values, interval):
    return [values[k : k + interval] for k in range(0, len(values), interval)]


@every_environment
@intervals
def test_rmse_over_the_scale(env_id, interval):
    recording = draw(env_id, [0])
    env = make(env_id, recording=recording, decision_interval=interval)
    actions = random_actions(env.action_space.shape, 41)
    heard = play(env, actions)
    errors = errors_of(env_id, recording, actions, interval)
    assert len(errors) == 41
    expected = [-min(np.sqrt(np.mean(e**2)) / env.scenario.error_scale, 10.0)
                for e in grouped(errors, interval)]  # fmt: skip
    assert -10.0 < np.median(expected) < 0.0
    np.testing.assert_allclose([step[1] for step in heard[1:]], expected, rtol=1e-12)


@every_environment
def test_rmse_is_capped(env_id):
    recording = draw(env_id, [0])
    off = 0.4 * make(env_id).scenario.lost_distance
    env = make(env_id, recording=change(recording, truth=recording.truth + off))
    heard = play(env, zeros(env, 41))
    assert [step[1] for step in heard[1:]] == [-10.0] * 41 and heard[-1][3]


def nominal_errors(env_id, recording):
    off = nominal_run(env_id, recording).mean - recording.truth
    position = list(make(env_id).scenario.motion.position)
    return np.sqrt((off[0][:, position] ** 2).sum(axis=1))


@every_environment
@intervals
def test_improvement_on_the_nominal_filter(env_id, interval):
    recording = draw(env_id, [3])
    env = make(env_id, recording=recording, reward="improvement", decision_interval=interval)
    actions = random_actions(env.action_space.shape, 41)
    heard = play(env, actions)
    ours = grouped(errors_of(env_id, recording, actions, interval), interval)
    nominal = grouped(nominal_errors(env_id, recording), interval)
    expected = [0.5 * np.log((np.mean(n**2) + 1e-6) / (np.mean(e**2) + 1e-6))
                for n, e in zip(nominal, ours, strict=True)]  # fmt: skip
    assert np.ptp(expected) > 1e-3
    got = [step[1] for step in heard[1:]]
    np.testing.assert_allclose(got, np.clip(expected, -3.0, 3.0), rtol=1e-9, atol=1e-9)


@every_environment
@intervals
def test_the_nominal_filter_improves_nothing_on_itself(env_id, interval):
    env = make(env_id, reward="improvement", decision_interval=interval)
    heard = play(env, zeros(env, 41), seed=0)
    assert abs(sum(step[1] for step in heard[1:])) < 1e-9
    better = play(env, zeros(env, 41) + 0.05, seed=0)
    assert abs(sum(step[1] for step in better[1:])) > 1e-3


@every_environment
@pytest.mark.parametrize(("told", "action", "reward"), [(0.2, 1.0, 3.0), (100.0, -1.0, -3.0)])
def test_improvement_is_capped_both_ways(env_id, told, action, reward):
    """Started at the truth and misled by far: whoever trusts the measurement is far off.

    The noise is told as a multiple of the initial estimate's deviation.
    """
    recording = draw(env_id, [0], faults="none")
    scenario = make(env_id).scenario

    def mislead(measurement):
        measurement[:, :, 0] += 0.5 * scenario.lost_distance
        measurement[:, :, 1:] = np.nan

    noise = np.full_like(recording.noise, told * scenario.initial_deviations[0])
    misled = change(recording, mean=recording.truth[:, 0], measurement=mislead, noise=noise)
    knob = f"{scenario.sensor.groups[0]}_noise"
    env = make(env_id, recording=misled, reward="improvement", actions=[knob])
    assert play(env, [[action]])[1][1] == reward


def truth_leaves(recording, k, scenario):
    """The truth jumps far away at index k: the track is lost there."""

    def leave(truth):
        truth[:, k:, scenario.motion.position[0]] += 2.0 * scenario.lost_distance

    return change(recording, truth=leave)


@every_environment
@rewards
@pytest.mark.parametrize("interval", [1, 4])
@pytest.mark.parametrize("lost_at", [0, 7, 40])
def test_a_lost_track_costs_the_cap_for_all_that_remained(env_id, reward, interval, lost_at):
    scenario = make(env_id).scenario
    recording = truth_leaves(draw(env_id, [0], faults="none"), lost_at, scenario)
    env = make(env_id, recording=recording, reward=reward, decision_interval=interval)
    heard = play(env, zeros(env, 41))
    decisions, begun = -(-41 // interval), lost_at // interval
    assert len(heard) == 1 + begun + 1
    _, value, terminated, truncated, info = heard[-1]
    assert terminated is True and truncated is False
    assert value == -CAP[reward] * (decisions - begun)
    assert all(not (step[2] or step[3]) for step in heard[1:-1])
    # and info tells of the update that lost it
    assert info["time"] == recording.time[lost_at]
    assert info["position_error"] > scenario.lost_distance
    np.testing.assert_array_equal(info["truth"], recording.truth[0, lost_at])
    assert set(info["knobs"].values()) == {1.0}


@every_environment
@pytest.mark.parametrize(("interval", "decisions"), [(1, 41), (4, 11), (50, 1)])
def test_the_time_limit_truncates(env_id, interval, decisions):
    env = make_vec(env_id, 3, decision_interval=interval, faults="none")
    env.reset(seed=0)
    for k in range(1, decisions + 1):
        _, _, terminated, truncated, info = env.step(zeros(env))
        assert not terminated.any() and (truncated == (k == decisions)).all()
    assert (info["time"] == 4.0).all()
