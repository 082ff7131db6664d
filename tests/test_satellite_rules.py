"""Single satellites: a step is left out and readmitted, a ramp adds up, a clock blames nobody."""

import numpy as np
import pytest
from kfenv.agents.contest.evaluation import Contest, evaluate
from kfenv.agents.contest.rollout import rollout
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.contestants.rules.satellite_hidden_markov import follow, range_errors
from rollouts import GNSS, TRACKING
from scipy.stats import norm

from kfenv.envs.knobs import knobs_of
from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.scenarios.gnss.tracking import GnssTracking

RULES = ["raim", "satellite-gate", "satellite-hmm"]
every_rule = pytest.mark.parametrize("rule", RULES)
SETTING = {"duration": 80.0, "rate": 1.0}
EPISODES = 4


def watched(rule, faults):
    """The recording, the channels' factors (81, B, 24) that a rule sets, and the RMSE."""
    scenario = GnssTracking(**SETTING, faults=faults)
    recording = scenario.sample([np.random.default_rng(i) for i in range(EPISODES)])
    scores = rollout(make_agent(rule), GNSS, SETTING, recording, trace=True)
    return recording, scores.factors[..., len(knobs_of(scenario.sensor.groups)) :], scores.rmse


STEP = {"range_step": {"start": 20.0, "duration": [15.0, 15.0], "size": [50.0, 50.0]}}


@every_rule
def test_a_stepped_satellite_is_left_out_and_readmitted(rule):
    recording, factors, rmse = watched(rule, STEP)
    hit = recording.true_bias[:, 22] != 0.0
    assert hit[:, :CHANNELS].sum() == EPISODES
    for b in range(EPISODES):
        victim = np.flatnonzero(hit[b])[0]
        others = np.flatnonzero(np.isfinite(recording.measurement[b, 22]))
        others = others[(others != victim) & (others < CHANNELS)]
        assert factors[25:35, b, victim].min() > 5.0  # from the sixth epoch on
        assert np.median(factors[25:35, b][:, others]) < 2.0
        assert np.median(factors[65:, b, victim]) < 2.0
    fixed = rollout(make_agent("fixed"), GNSS, SETTING, recording)
    assert np.median(rmse) < 0.6 * np.median(fixed.rmse)


RAMP = {"range_ramp": {"start": 20.0, "duration": [35.0, 35.0], "rate": [1.0, 1.0]}}


@every_rule
def test_a_ramp_adds_up(rule):
    recording, factors, rmse = watched(rule, RAMP)
    hit = recording.true_bias[:, 40, :CHANNELS] != 0.0
    assert np.median(factors[40:55, :, :CHANNELS].transpose(1, 2, 0)[hit]) > 3.0
    fixed = rollout(make_agent("fixed"), GNSS, SETTING, recording)
    assert np.median(rmse) < 0.6 * np.median(fixed.rmse)


CLOCK = {
    "clock_degradation": {"start": 20.0, "duration": [30.0, 30.0], "range_error": [150.0, 150.0]}
}


@every_rule
def test_a_clocks_jitter_blames_nobody(rule):
    recording, factors, _ = watched(rule, CLOCK)
    arrived = np.isfinite(recording.measurement).transpose(1, 0, 2)[: len(factors)]
    found = factors[20:50][arrived[20:50]]
    assert np.mean(found > 5.0) < 0.05 and np.median(found) < 1.2


@every_rule
def test_where_there_are_no_satellites_it_is_refused_at_the_door(rule, tmp_path):
    contest = Contest(TRACKING, {}, (rule,), 2, 0, tuning_trials=0)
    with pytest.raises(ValueError, match=f"{rule}.*RadarTracking has none"):
        evaluate(contest, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_the_clairvoyant_knows_biases():
    recording, factors, _ = watched("clairvoyant-channels", STEP)
    hit = recording.true_bias[:, 22] != 0.0
    budget = np.hypot(recording.true_noise, recording.true_bias)[:, 22] / recording.noise[:, 22]
    np.testing.assert_allclose(factors[22][hit], budget[hit])
    assert (factors[22][hit] > 10.0).all()


def test_satellites_states_against_enumeration():
    """Three epochs of one satellite over all paths of its states."""
    errors = range_errors(GnssTracking())
    count, rate, passed = len(errors.error), 0.01, 1.0
    fails, older = 1.0 - np.exp(-rate * passed), 1.0 - np.exp(-errors.age * passed)
    ends = 1.0 - np.exp(-errors.end * passed)
    move = np.zeros((count, count))  # from, to
    move[0, 0] = 1.0 - fails
    move[0] += fails * errors.begin
    for k in range(1, count):
        move[k, 0] = ends[k]
        ages = k >= errors.ramps and errors.speed[min(k + 1, count - 1)] == errors.speed[k]
        ages = ages and k + 1 < count
        move[k, k] = (1.0 - ends[k]) * (1.0 - older * ages)
        if ages:
            move[k, k + 1] = (1.0 - ends[k]) * older
    np.testing.assert_allclose(move.sum(axis=1), 1.0)
    states = np.zeros((1, CHANNELS, count))
    states[..., 0] = 1.0
    wanted = states[0, 0].copy()
    for heard in ((2.0, 0.3), (7.0, np.nan), (12.0, 0.4)):
        residual, variance = np.full((1, 2 * CHANNELS), np.nan), np.full((1, 2 * CHANNELS), 9.0)
        residual[0, [0, CHANNELS]], variance[0, CHANNELS] = heard, 0.04
        follow(residual, variance, np.array([passed]), rate, errors, states)
        wanted = wanted @ move * norm.pdf(heard[0], errors.error, 3.0)
        if np.isfinite(heard[1]):
            wanted *= norm.pdf(heard[1], errors.speed, 0.2)
        wanted /= wanted.sum()
        np.testing.assert_allclose(states[0, 0], wanted, rtol=1e-9, atol=1e-15)
    assert 0.05 < states[0, 0, 0] < 0.95 and states[0, 1, 0] > 0.97


def test_what_no_likely_state_explains_leaves_probabilities():
    """The nearest error may belong to a state that cannot be: of probability zero exactly."""
    errors = range_errors(GnssTracking())
    states = np.zeros((1, CHANNELS, len(errors.error)))
    states[..., -1] = 1.0
    residual, variance = np.full((1, 2 * CHANNELS), np.nan), np.full((1, 2 * CHANNELS), 0.04)
    residual[0, :CHANNELS] = np.linspace(-300.0, 6000.0, CHANNELS)
    residual[0, CHANNELS:] = -33.0
    for _ in range(3):
        follow(residual, variance, np.array([1.0]), 0.01, errors, states)
        np.testing.assert_allclose(states.sum(axis=-1), 1.0)
    assert (states >= 0.0).all()
