"""Agents do what their rules say, on numbers small enough to check by hand."""

import numpy as np
import pytest
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contestants.agent import Briefing, channels_of, knob_actions
from kfenv.agents.contestants.registry import AGENTS, make_agent
from rollouts import FAULTS, INERTIAL

from kfenv.envs.knobs import actions_for, knobs_of
from kfenv.models.radar import radar
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.radar.tracking import RadarTracking

KNOBS = knobs_of(radar().groups)


def briefing(batch=1, steps=3, noise=1.0, true_noise=1.0):
    scenario = RadarTracking(duration=steps / 10.0, faults="none")
    recording = scenario.sample([np.random.default_rng(i) for i in range(batch)])
    shape = recording.noise.shape
    object.__setattr__(recording, "noise", np.full(shape, noise))
    object.__setattr__(recording, "true_noise", np.full(shape, true_noise))
    return Briefing(KNOBS, scenario, batch, 0, recording)


def info(innovation, variance, noise=1.0):
    innovation = np.atleast_2d(np.asarray(innovation, float))
    return {
        "innovation": innovation,
        "innovation_variance": np.broadcast_to(np.asarray(variance, float), innovation.shape),
        "noise": np.full(innovation.shape, noise),
    }


def factors(actions):
    high, low = (np.array([getattr(knob, name) for knob in KNOBS]) for name in ("high", "low"))
    return np.where(actions >= 0.0, high**actions, low**-actions)


def started(name, values=None, **kwargs):
    agent = make_agent(name)
    agent = agent.with_values(values or {})
    agent.reset(briefing(**kwargs))
    return agent


def test_actions_undo_the_knobs():
    wanted = np.array([[1.7, 0.03, 0.2, 1.0, 30.0]])
    np.testing.assert_allclose(factors(actions_for(wanted, KNOBS)), wanted, rtol=1e-12)


def test_channels_of_a_group_share_its_knob():
    assert channels_of(radar()) == {"range": [0], "azimuth": [1], "elevation": [2]}
    actions = knob_actions(briefing(), 1.0, 1.0, np.array([[2.0, 3.0, 4.0]]))
    np.testing.assert_allclose(factors(actions)[0], [1.0, 1.0, 2.0, 3.0, 4.0])


def test_a_group_listens_to_the_channels_that_arrived():
    scenario = GnssTracking()
    recording = briefing(batch=2).recording
    asked = Briefing(knobs_of(scenario.sensor.groups), scenario, 2, 0, recording)
    noise = np.full((2, 24), np.nan)
    noise[0, :3], noise[0, 14] = (1.0, 5.0, 7.0), 4.0  # the other filter heard nothing
    actions = knob_actions(asked, 1.0, 1.0, noise)
    high = np.array([knob.high for knob in asked.knobs])
    np.testing.assert_allclose(high ** actions[0], [1.0, 1.0, 5.0, 4.0])
    assert not actions[1].any()


def test_fixed_is_the_nominal_filter():
    assert not started("fixed").act(None, info([1, 2, 3], 2.0)).any()


def test_fixed_tuned_holds_its_setting():
    agent = started("fixed-tuned", {"process_noise": 7.0, "azimuth_noise": 2.0})
    first, second = (factors(agent.act(None, info(nu, 2.0))) for nu in ([0, 0, 0], [9, 9, 9]))
    np.testing.assert_allclose(first[0], [1.0, 7.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(first, second)


def test_clairvoyant_sets_the_true_noise():
    agent = started("clairvoyant", noise=2.0, true_noise=6.0)
    np.testing.assert_allclose(factors(agent.act(None, None))[0, 2:], 3.0)


def test_clairvoyant_needs_the_true_noise():
    agent, blind = make_agent("clairvoyant"), briefing()
    object.__setattr__(blind.recording, "true_noise", None)
    with pytest.raises(ValueError, match="true noise"):
        agent.reset(blind)


def test_fading_follows_the_corrected_rule():
    # V1 = nu^2 = 9 per channel, R = 1, HPH = 1, beta = 2: tr(V - 2) / tr(HPH) = 21 / 3
    agent = started("innovation-fading", {"weakening": 2.0, "forgetting": 0.5})
    first = factors(agent.act(None, info([3, 3, 3], 2.0)))[0, 0]
    assert first == pytest.approx(7.0)
    # V2 = (0.5 * 9 + 0) / 1.5 = 3: tr(3 - 2) / tr(1) = 1
    assert factors(agent.act(None, info([0, 0, 0], 2.0)))[0, 0] == pytest.approx(1.0)


def test_corrected_fading_is_free_of_units_and_the_printed_is_not():
    for name, same in (("innovation-fading", True), ("innovation-fading-printed", False)):
        results = []
        for unit in (1.0, 1e-3):  # the last channel in other units
            scale = np.array([1.0, 1.0, unit])
            data = info(np.array([1.0, 1.0, 6.0]) * scale, 2.0 * scale**2)
            data["noise"] = scale[None]
            results.append(factors(started(name).act(None, data))[0, 0])
        assert np.isclose(*results) == same


def test_fading_ignores_what_did_not_arrive():
    agent = started("innovation-fading", {"weakening": 2.0})
    nothing = info([np.nan] * 3, np.nan)
    assert factors(agent.act(None, nothing))[0, 0] == 1.0
    assert factors(agent.act(None, info([3, np.nan, np.nan], [2, np.nan, np.nan])))[
        0, 0
    ] == pytest.approx(7.0)


@pytest.mark.parametrize("faults", ["paper", FAULTS])
def test_fading_by_the_knob_is_the_fading_filter(faults):
    """With the same points (no kappa) the rule and `ackf` part by rounding alone.

    Not so where the inertial unit fails while no fix comes: there the rounding of the start
    alone moves `ackf` by hundreds of metres.
    """
    place = (INERTIAL, {"faults": faults, "kappa": 0.0, "duration": 20.0})
    recording = draw_episodes(*place, "test", 0, 4)
    knob, filtered = (
        rollout(make_agent(name), *place, recording, trace=True)
        for name in ("innovation-fading", "ackf")
    )
    assert (knob.factors[..., 0] > 100.0).any()  # more than 10, and the filter follows
    np.testing.assert_array_equal(knob.lost, filtered.lost)
    np.testing.assert_allclose(knob.rmse, filtered.rmse, rtol=1e-6)
    every_fix = slice(9, None, 10)
    np.testing.assert_allclose(
        knob.error[:-1], filtered.error[every_fix][: len(knob.error) - 1], rtol=1e-6, atol=1e-3
    )


def test_huber_weighs_and_the_gate_rejects_then_reopens():
    agent = started("huber-gate", {"threshold": 2.0, "gate": 20.0})
    mild = factors(agent.act(None, info([4.0, 1.0, np.nan], [1.0, 1.0, np.nan])))[0]
    np.testing.assert_allclose(mild[2:], [np.sqrt(2.0), 1.0, 1.0])
    wild = info([100.0, 0.0, 0.0], 1.0)
    seen = [factors(agent.act(None, wild))[0, 2] for _ in range(6)]
    np.testing.assert_allclose(seen[:5], KNOBS[2].high)
    assert seen[5] == pytest.approx(np.sqrt(50.0))


def test_innovation_noise_finds_a_changed_level():
    rng = np.random.default_rng(1)
    agent = started("innovation-noise", {"window": 50.0, "gate": 5.0}, batch=200)
    for _ in range(400):  # HPH = 0.5 R, actual noise deviation 4 times the told one
        nu = rng.normal(scale=np.sqrt(16.0 + 0.5), size=(200, 3))
        actions = agent.act(None, info(nu, 1.5))
    assert np.median(factors(actions)[:, 2:]) == pytest.approx(4.0, rel=0.1)


def test_innovation_noise_contains_one_outlier():
    agent = started("innovation-noise", {"window": 10.0, "gate": 3.0})
    for _ in range(50):
        agent.act(None, info([1.0, 1.0, 1.0], 1.5))
    hit = factors(agent.act(None, info([100.0, 1.0, 1.0], 1.5)))[0]
    after = factors(agent.act(None, info([1.0, 1.0, 1.0], 1.5)))[0]
    assert hit[2] > 30.0 and after[2] < 2.0


def test_random_repeats_with_its_seed():
    first, second = (started("random").act(None, None) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.abs(first).max() <= 1.0


def test_unknown_agents_are_named():
    with pytest.raises(ValueError, match="Did you mean 'huber-gate'"):
        make_agent("hubergate")


def test_every_agent_has_sound_parameters():
    for name in AGENTS:
        for parameter in make_agent(name).tunable(RadarTracking(), KNOBS):
            assert 0.0 < parameter.low <= parameter.default <= parameter.high
