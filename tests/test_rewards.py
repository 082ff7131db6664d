"""Rewards: a return that is the RMSE, or its log; improvement on the nominal filter; losses."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kfenv.agents.contest.rollout import rollout
from kfenv.agents.contestants.agent import Agent
from rollouts import (
    PECULIAR,
    change,
    draw,
    error_name,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    short,
    truth_leaves,
    zeros,
)
from test_zero_action_is_nominal import nominal_run

from kfenv.envs.rewards import DENSE, worst

RETURNS = {
    "rmse": lambda error: -error,
    "log-rmse": lambda error: -np.log(error),
}
REWARDS = (*RETURNS, *DENSE)
intervals = pytest.mark.parametrize("interval", [1, 4])
every_return = pytest.mark.parametrize("reward", RETURNS)


def errors_of(env_id, recording, actions, interval):
    """Position errors of every filter step, each action held for the interval."""
    held = np.repeat(actions, interval, axis=0)
    heard = play(make(env_id, recording=recording), held)
    return np.array([step[4][error_name(env_id)] for step in heard[1:]])


def grouped(values, interval):
    return [values[k : k + interval] for k in range(0, len(values), interval)]


# ----- the return is the score ----------------------------------------------------------


class Played(Agent):
    """Repeats actions (decisions, K), or (K,) for ever."""

    all_knobs = False

    def __init__(self, actions):
        super().__init__("played")
        self.actions = np.atleast_2d(actions)

    def reset(self, briefing):
        super().reset(briefing)
        self._decision = -1

    def act(self, observation, info):
        self._decision += 1
        now = self.actions[min(self._decision, len(self.actions) - 1)]
        return np.tile(now, (self.briefing.batch, 1))


def returns_of(env, actions):
    """Of every sub-environment's first episode, the actions held or repeated as `Played` does."""
    env.reset(seed=0)
    total, running = np.zeros(env.num_envs), np.ones(env.num_envs, bool)
    for k in range(1000):
        now = actions[min(k, len(actions) - 1)]
        _, reward, gone, ended, _ = env.step(np.tile(now, (env.num_envs, 1)))
        total[running] += reward[running]
        running &= ~(gone | ended)
        if not running.any():
            return total
    raise AssertionError("the episodes do not end")


@pytest.fixture
def tracks_are_lost_early(monkeypatch):
    for env_id, peculiar in PECULIAR.items():
        scenario = load_env_creator(gym.spec(env_id).entry_point).scenario_class
        monkeypatch.setattr(scenario, "lost_distance", peculiar.early_loss)


@every_environment
@given(
    reward=st.sampled_from(list(RETURNS)),
    seed=st.integers(0, 2**20),
    interval=st.sampled_from([1, 3]),
    spoilt=st.booleans(),
    unscored=st.sampled_from([0.0, 0.3, 0.9]),
    spread=st.sampled_from([0.05, 0.3, 1.0]),
)
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_the_return_is_the_score(
    env_id, tracks_are_lost_early, reward, seed, interval, spoilt, unscored, spread
):
    """Of random agents with random faults, tracks lost and kept, instants scored or not."""
    rng = np.random.default_rng(seed)
    chosen = {"duration": 2.0, "decision_interval": interval}
    chosen |= {} if spoilt else {"faults": "none"}
    recording = draw(env_id, range(seed, seed + 4), **chosen)
    scored = np.where(rng.uniform(size=recording.truth.shape[:2]) < unscored, 0.0, 1.0)
    scored[:, seed % 21] = 1.0
    recording = change(recording, scored=scored)
    env = make_vec(env_id, 4, recording=recording, reward=reward, **chosen)
    actions = spread * rng.uniform(-1.0, 1.0, (21, env.single_action_space.shape[0]))
    scores = rollout(Played(actions), env_id, short(env_id, **chosen), recording)
    wanted = RETURNS[reward](scores.rmse / env.scenario.error_scale)
    np.testing.assert_allclose(returns_of(env, actions), wanted, rtol=1e-9, atol=1e-9)
    single = make(env_id, recording=recording[:1], reward=reward, **chosen)
    alone = sum(step[1] for step in play(single, actions)[1:])
    np.testing.assert_allclose(alone, wanted[0], rtol=1e-9, atol=1e-9)


@every_environment
def test_agents_rank_by_return_as_by_score(env_id, tracks_are_lost_early):
    """Twenty constant actions, some of which lose many tracks and others few."""
    recording = draw(env_id, range(20), duration=2.0)
    rng, size = np.random.default_rng(1), make(env_id).action_space.shape[0]
    actions = rng.uniform(-1.0, 1.0, (20, size)) * np.linspace(0.0, 1.0, 20)[:, None]
    scores = [rollout(Played(a), env_id, short(env_id), recording) for a in actions]
    assert len({int(s.lost.sum()) for s in scores}) > 2
    assert 0 < sum(s.lost.sum() for s in scores) < 400
    rmse = np.array([s.rmse for s in scores]) / make(env_id).scenario.error_scale
    for reward, score in (("rmse", -rmse), ("log-rmse", RETURNS["log-rmse"](rmse))):
        env = make_vec(env_id, 20, recording=recording, reward=reward)
        returns = [returns_of(env, a[None]).mean() for a in actions]
        np.testing.assert_array_equal(np.argsort(returns), np.argsort(score.mean(axis=1)))


@every_environment
@every_return
@intervals
def test_a_decision_earns_what_it_adds(env_id, reward, interval):
    """Reward by reward, from the errors that the infos tell."""
    recording = draw(env_id, [0])
    env = make(env_id, recording=recording, decision_interval=interval, reward=reward)
    actions = random_actions(env.action_space.shape, 41)
    heard = play(env, actions)
    errors = errors_of(env_id, recording, actions, interval)
    assert len(errors) == 41
    errors = errors / env.scenario.error_scale
    known = np.minimum(np.arange(interval, 41 + interval, interval), 41)
    roots = np.array([np.sqrt((np.sum(errors[:k] ** 2) + 41.0 - k) / 41.0) for k in known])
    before = RETURNS[reward](roots) + (41.0 - known) / 41.0 * (reward == "rmse")
    np.testing.assert_allclose(
        [step[1] for step in heard[1:]], np.diff(before, prepend=0.0), rtol=1e-9, atol=1e-12
    )


@every_environment
@every_return
def test_an_error_of_one_scale_counts_alike_early_and_late(env_id, reward):
    """So it costs nothing in the log, and its share of one in the RMSE."""
    recording = draw(env_id, [0], faults="none")
    env = make(env_id)
    deaf = change(recording, measurement=np.full_like(recording.measurement, np.nan))
    own = np.stack(
        [step[4]["estimate"] for step in play(make(env_id, recording=deaf), zeros(env, 41))[1:]]
    )
    own[:, env.scenario.yardstick.states[1]] += env.scenario.error_scale
    env = make(env_id, recording=change(deaf, truth=own[None]), reward=reward)
    earned = [step[1] for step in play(env, zeros(env, 41))[1:]]
    np.testing.assert_allclose(earned, -1.0 / 41.0 if reward == "rmse" else 0.0, atol=1e-9)


# ----- improvement ----------------------------------------------------------------------


def nominal_errors(env_id, recording):
    off = nominal_run(env_id, recording).mean - recording.truth
    position = list(make(env_id).scenario.yardstick.states)
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
    least = min(1e-6, (1e-4 * env.scenario.error_scale) ** 2)
    expected = [0.5 * np.log((np.mean(n**2) + least) / (np.mean(e**2) + least))
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


# ----- losses ---------------------------------------------------------------------------


@every_environment
@pytest.mark.parametrize("reward", REWARDS)
@pytest.mark.parametrize(("interval", "lost_at"), [(1, 0), (4, 7), (1, 40), (4, 40)])
def test_a_lost_track_pays_for_all_that_remained(env_id, reward, interval, lost_at):
    scenario = make(env_id).scenario
    recording = truth_leaves(draw(env_id, [0], faults="none"), lost_at, scenario)
    env = make(env_id, recording=recording, reward=reward, decision_interval=interval)
    heard = play(env, zeros(env, 41))
    decisions, begun = -(-41 // interval), lost_at // interval
    assert len(heard) == 1 + begun + 1
    _, value, terminated, truncated, info = heard[-1]
    assert terminated is True and truncated is False
    assert all(not (step[2] or step[3]) for step in heard[1:-1])
    if reward in DENSE:
        assert value == -3.0 * (decisions - begun)
    else:
        before = errors_of(env_id, recording, zeros(env, 41), 1)[:lost_at]
        squares = np.sum(before**2) + (41 - lost_at) * scenario.lost_distance**2
        total = RETURNS[reward](np.sqrt(squares / 41.0) / scenario.error_scale)
        assert sum(step[1] for step in heard[1:]) == pytest.approx(total, rel=1e-9)
    # and info tells of the update that lost it
    assert info["time"] == recording.time[lost_at]
    assert info[error_name(env_id)] > scenario.lost_distance
    np.testing.assert_array_equal(info["truth"], recording.truth[0, lost_at])
    assert set(info["knobs"].values()) == {1.0}


@every_environment
@every_return
def test_a_track_lost_at_once_costs_the_worst(env_id, reward):
    scenario = make(env_id).scenario
    recording = truth_leaves(draw(env_id, [0], faults="none"), 0, scenario)
    heard = play(make(env_id, recording=recording, reward=reward), zeros(make(env_id), 41))
    price = worst(reward, scenario.error_scale, scenario.lost_distance)
    assert heard[1][1] == pytest.approx(-price, rel=1e-12)
    assert price == {"rmse": scenario.lost_distance / scenario.error_scale}.get(reward, price)


@every_environment
@pytest.mark.parametrize("reward", REWARDS)
def test_losing_never_pays(env_id, reward):
    """Lost at an instant, or barely kept from there to the end: keeping earns more.

    Discounted or not, since a loss pays for all that remained at once.
    """
    scenario = make(env_id).scenario
    recording = draw(env_id, [0], faults="none", duration=2.0)
    deaf = change(recording, measurement=np.full_like(recording.measurement, np.nan))
    for lost_at in (0, 12, 20):
        earned = []
        for far in (2.0, 0.9):
            env = make(env_id, recording=truth_leaves(deaf, lost_at, scenario, far), reward=reward)
            heard = play(env, zeros(env, 21))
            assert heard[-1][2] == (far == 2.0)
            values = [step[1] for step in heard[1:]]
            earned.append([sum(values * g ** np.arange(len(values))) for g in (0.9, 0.99, 1.0)])
        assert (np.array(earned[0]) <= np.array(earned[1]) + 1e-9).all()


@every_environment
@every_return
def test_without_truth_a_failed_filter_pays_for_all_that_remained(env_id, reward):
    recording = draw(env_id, [0], faults="none")

    def overflow(measurement):
        measurement[:, 20:] = 1e300

    blind = change(recording, truth=None, measurement=overflow)
    env = make(env_id, recording=blind, reward=reward)
    heard = play(env, zeros(env, 41))
    assert heard[-1][2] and all(step[1] == 0.0 for step in heard[1:-1])
    price = worst(reward, env.scenario.error_scale, env.scenario.lost_distance)
    assert heard[-1][1] == pytest.approx(-price * (1.0 - (len(heard) - 2) / 41.0), rel=1e-12)


@every_environment
@every_return
def test_an_episode_without_scored_instants_earns_nothing(env_id, reward):
    recording = draw(env_id, [0], faults="none")
    env = make(env_id, recording=change(recording, scored=np.zeros((1, 41))), reward=reward)
    assert all(step[1] == 0.0 for step in play(env, zeros(env, 41))[1:])


@every_environment
@pytest.mark.parametrize(("interval", "decisions"), [(1, 41), (4, 11), (50, 1)])
def test_the_time_limit_truncates(env_id, interval, decisions):
    env = make_vec(env_id, 3, decision_interval=interval, faults="none")
    env.reset(seed=0)
    for k in range(1, decisions + 1):
        _, _, terminated, truncated, info = env.step(zeros(env))
        assert not terminated.any() and (truncated == (k == decisions)).all()
    assert (info["time"] == 4.0).all()
