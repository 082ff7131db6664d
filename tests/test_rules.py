"""The classical rules against independent checks: enumeration, pseudo-code, limits, by hand."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from kfenv.agents.contestants.agent import Briefing
from kfenv.agents.contestants.fault_model import FaultModel, factors, power
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.contestants.rules.hidden_markov import HOPS, grid, hear, prior
from scipy.stats import norm

from kfenv.envs.knobs import WIDEST_FADING, knobs_of
from kfenv.models.radar import radar
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import RadarValidation

KNOBS = knobs_of(radar().groups, most_fading=WIDEST_FADING)  # as rules get them
SCENARIO = RadarTracking(rate=2.0, faults="none")
STEP = 0.5  # s


def started(name, values=None, batch=1, scenario=SCENARIO):
    agent = make_agent(name).with_values(values or {})
    agent.reset(Briefing(KNOBS, scenario, batch, 0, None))
    return agent


def info(innovation, explained, told=1.0, time=0.0, estimate=None):
    innovation = np.atleast_2d(np.asarray(innovation, float))
    shape = innovation.shape
    noise = np.broadcast_to(np.asarray(told, float), shape)
    variance = np.where(np.isnan(innovation), np.nan, explained + noise**2)
    return {
        "innovation": innovation,
        "innovation_variance": variance,
        "noise": noise,
        "time": np.full(shape[0], time),
        "estimate": np.zeros((shape[0], 9)) if estimate is None else estimate,
    }


def factors_of(actions):
    high, low = (np.array([getattr(knob, name) for knob in KNOBS]) for name in ("high", "low"))
    return np.where(actions >= 0.0, high**actions, low**-actions)


def noise_factors(agent, *told):
    return factors_of(agent.act(None, info(*told)))[:, 2:]


# -- the fault model --------------------------------------------------------------------------


def test_the_fault_model_is_the_scenarios():
    model = FaultModel.of(RadarTracking(rate=2.0))
    assert model.levels == (0, 3, 6, 9, 12, 15)
    np.testing.assert_allclose(factors(model.levels), [1.0, *np.geomspace(2.0, 31.0, 5)], rtol=0.01)
    assert factors(model.glint) == pytest.approx(8.0, rel=0.12)
    assert model.misreport == tuple(range(-4, 5))
    assert (model.glint_share, model.glint_chance) == (0.1, 0.5)
    assert model.up == pytest.approx(2.0 / 120.0) and model.down == pytest.approx(1.0 / 15.0)


@pytest.mark.parametrize(
    "scenario",
    [BistaticTracking(), RadarValidation(faults="random"), InsGnss(), GnssTracking()],
    ids=lambda scenario: scenario.name,
)
def test_every_scenario_has_a_fault_model(scenario):
    model = FaultModel.of(scenario)
    assert model.levels[0] == 0 and len(model.levels) >= 4 and model.up > 0.0 < model.down
    assert min(model.misreport) < 0 < max(model.misreport)
    assert (model.glint > 0) == (scenario.name != "GnssTracking")


def test_without_faults_there_is_one_noise():
    assert FaultModel.of(SCENARIO) == FaultModel()
    assert power(8.0) == 9 and factors(0) == 1.0
    agent = started("hmm-noise")
    for innovation in ([1.0, 2.0, 3.0], [1e4, 0.0, 1.0]):
        np.testing.assert_allclose(noise_factors(agent, innovation, 2.0), 1.0)


# -- the hidden Markov model ------------------------------------------------------------------

UP, DOWN, CHANNELS, STEPS = 0.3, 0.2, 3, 6


def heard(model, innovation, explained, told, leak=0.0):
    """The belief after all innovations (T, m), the last factors of the noise, log-likelihood."""
    belief, evidence = prior(model, 1, innovation.shape[1]), 0.0
    for t, row in enumerate(innovation):
        variance = np.where(np.isnan(row), np.nan, explained + told**2)[None]
        passed = np.array([STEP if t else 0.0])
        factor, told_by = hear(
            row[None], variance, told[None], passed, UP, DOWN, leak, grid(model), belief
        )
        evidence += told_by[0]
    return belief, factor[0], evidence


def transition(levels):
    rise, fall = 1.0 - np.exp(-UP * STEP), 1.0 - np.exp(-DOWN * STEP)
    hop = (1.0 - fall) * (1.0 - np.exp(-HOPS * UP * STEP))
    matrix = np.full((levels, levels), hop / (levels - 2))
    matrix[0], matrix[:, 0] = rise / (levels - 1), fall
    np.fill_diagonal(matrix, 1.0 - fall - hop)
    matrix[0, 0] = 1.0 - rise
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    return matrix


def drawn(seed=0):
    rng = np.random.default_rng(seed)
    told, explained = np.array([1.0, 2.0, 0.5]), np.array([0.7, 3.0, 0.1])
    innovation = rng.normal(size=(STEPS, CHANNELS)) * told * np.array([[1, 1, 9, 4, 5, 4]]).T
    innovation[3, 1] = np.nan
    return innovation, explained, told


def likelihood(innovation, variance):
    return np.where(np.isnan(innovation), 1.0, norm.pdf(innovation, scale=np.sqrt(variance)))


def test_hmm_equals_enumeration_of_all_paths():
    model = FaultModel(levels=(0, 4, 9), glint=7, glint_share=0.2, glint_chance=1.0)
    innovation, explained, told = drawn()
    states = list(product(range(3), range(2)))
    power_of = np.array([model.levels[i] + g * model.glint for i, g in states])
    variance = explained + told**2 * factors(power_of)[:, None] ** 2  # (S, m)
    step = np.array([[transition(3)[i, j] * (0.2 if g else 0.8) for j, g in states]
                     for i, _ in states])  # fmt: skip
    first = np.array([(i == 0) * (0.2 if g else 0.8) for i, g in states])
    weight = np.array([likelihood(row, variance).prod(axis=1) for row in innovation])  # (T, S)
    paths = np.array(list(product(range(6), repeat=STEPS)))
    chance = first[paths[:, 0]] * weight[0, paths[:, 0]]
    for t in range(1, STEPS):
        chance *= step[paths[:, t - 1], paths[:, t]] * weight[t, paths[:, t]]
    last = np.bincount(paths[:, -1], chance, minlength=6) / chance.sum()
    belief, factor, evidence = heard(model, innovation, explained, told)
    np.testing.assert_allclose(evidence, np.log(chance.sum()), rtol=1e-9)
    np.testing.assert_allclose(belief.level[0], last.reshape(3, 2).sum(axis=1), rtol=1e-9)
    noise = 1.0 / (last @ (1.0 / variance)) - explained
    np.testing.assert_allclose(factor**2, noise / told**2, rtol=1e-9)


def test_hmm_weighs_misreports_as_bayes_does():
    model = FaultModel(misreport=(-3, 0, 2, 5))
    innovation, explained, told = drawn()
    variance = explained + told**2 * factors(model.misreport)[:, None] ** 2  # (M, m)
    chance = likelihood(innovation[:, None], variance).prod(axis=0)
    chance /= chance.sum(axis=0)
    belief, factor, _ = heard(model, innovation, explained, told)
    np.testing.assert_allclose(belief.misreport[0].T, chance, rtol=1e-9)
    noise = 1.0 / (chance / variance).sum(axis=0) - explained
    np.testing.assert_allclose(factor**2, noise / told**2, rtol=1e-9)


def test_hmm_learns_whether_the_episode_glints():
    model = FaultModel(glint=7, glint_share=0.2, glint_chance=0.5)
    innovation, explained, told = drawn()
    usual, outlier = (
        likelihood(innovation, explained + told**2 * factor**2).prod(axis=1)
        for factor in (1.0, factors(7))
    )
    glinting = (0.8 * usual + 0.2 * outlier).prod()
    belief, *_ = heard(model, innovation, explained, told)
    assert belief.glints[0] == pytest.approx(glinting / (glinting + usual.prod()), rel=1e-9)


def test_hmm_finds_a_level_and_leaves_it_again():
    agent = started("hmm-noise", batch=200, scenario=RadarTracking(rate=2.0))
    rng, seen = np.random.default_rng(1), []
    for t in range(60):
        jammed = 10.0 if 20 <= t < 40 else 1.0
        nu = rng.normal(size=(200, 3)) * np.sqrt(jammed**2 + 0.5)
        seen.append(np.median(noise_factors(agent, nu, 0.5, 1.0, STEP * t)))
    assert seen[19] == pytest.approx(1.0, rel=0.15)
    assert seen[39] == pytest.approx(10.0, rel=0.3)
    assert seen[59] == pytest.approx(1.0, rel=0.15)


def test_hmm_survives_what_no_level_explains():
    agent = started("hmm-noise", scenario=RadarTracking(rate=2.0))
    for size in (1e9, 0.0, 1e-9):
        seen = noise_factors(agent, [size, 0.0, np.nan], 1e-9)
        assert np.isfinite(seen).all() and (seen > 0.0).all()


def test_nothing_arriving_changes_no_belief_but_the_levels():
    model = replace(FaultModel.of(RadarTracking()), glint_share=0.1)
    innovation, explained, told = drawn()
    before, *_ = heard(model, innovation, explained, told)
    after, factor, _ = heard(model, np.vstack([innovation, np.full(3, np.nan)]), explained, told)
    assert np.isnan(factor).all()
    np.testing.assert_array_equal(after.misreport, before.misreport)
    np.testing.assert_array_equal(after.glints, before.glints)
    np.testing.assert_allclose(after.level[0], before.level[0] @ transition(6), rtol=1e-12)


def test_process_noise_follows_the_acceleration():
    agent = started("hmm-turn", {"process_noise": 2.0, "turn_gain": 3.0}, batch=3)
    estimate = np.zeros((3, 9))
    estimate[1:, [2, 5]] = [[12.0, 16.0], [1e6, 0.0]]  # 20 m/s^2, and beyond all bounds
    q = factors_of(agent.act(None, info(np.zeros((3, 3)), 1.0, estimate=estimate)))[:, 1]
    np.testing.assert_allclose(q, [2.0, 2.0 * 2.5, 2.0 * 4.0], rtol=1e-6)


# -- robust rules -----------------------------------------------------------------------------

WILD = ([30.0, -2.0, np.nan], 0.5, [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("rule", "limit"), [("student-t", {"freedom": 1e12}), ("correntropy", {"width": 1e9})]
)
def test_robust_rules_have_the_filter_as_a_limit(rule, limit):
    np.testing.assert_allclose(noise_factors(started(rule, limit | {"noise": 1.0}), *WILD), 1.0)
    assert noise_factors(started(rule, {"noise": 1.0}), *WILD)[0, 0] > 1.2


def kalman(P, R, nu):
    """Posterior mean and covariance of a state that is measured directly, prior mean zero."""
    K = P @ np.linalg.inv(P + R)
    return K @ nu, (np.eye(len(nu)) - K) @ P


def test_student_t_equals_the_filter_of_the_paper():
    P, R, nu, v = np.diag([2.0, 0.3, 5.0]), np.diag([1.0, 4.0, 0.25]), np.array([7.0, 1.0, -3.0]), 4
    w = 1.0
    for _ in range(3):
        mean, covariance = kalman(P, R / w, nu)
        left = nu - mean
        spread = np.trace(np.linalg.solve(R, np.outer(left, left) + covariance))
        w = (v + 3) / (v + spread)
    agent = started("student-t", {"freedom": v, "noise": 1.0})
    found = noise_factors(agent, nu, np.diag(P), np.sqrt(np.diag(R)))
    np.testing.assert_allclose(found[0], 1.0 / np.sqrt(w), rtol=1e-12)


def test_correntropy_has_the_gain_of_the_papers_fixed_point():
    """The update of Chen et al. (2017), eq 27 to 35, on a state measured directly."""
    for P, R, nu in ((2.0, 1.0, 6.0), (0.3, 4.0, 5.0), (5.0, 0.25, -4.0)):
        mean, width = 0.0, 2.5
        gain = P / (P + R)
        for _ in range(5):
            mean = gain * nu
            of_state = np.exp(-(mean**2) / P / (2.0 * width**2))
            of_measurement = np.exp(-((nu - mean) ** 2) / R / (2.0 * width**2))
            gain = (P / of_state) / (P / of_state + R / of_measurement)
        agent = started("correntropy", {"width": width, "noise": 1.0})
        found = noise_factors(agent, [nu, 0.0, 0.0], P, np.sqrt(R))[0, 0]
        assert P / (P + R * found**2) == pytest.approx(gain, rel=1e-9)


def test_nis_gate_rejects_by_chance_and_finds_a_jump_again():
    agent = started("nis-gate", {"gate": 4.0, "noise": 2.0}, batch=2)
    limit = np.sqrt(4.0 * 11.345 / 3.0 * 4.5)  # chi2_3(.99); S = 0.5 + 2^2
    near = np.array([[0.999 * limit] * 3, [1.001 * limit] * 3])
    found = noise_factors(agent, near, 0.5)
    np.testing.assert_allclose(found[0], 2.0)
    np.testing.assert_allclose(found[1], KNOBS[2].high)
    jumped = [noise_factors(agent, np.full((2, 3), 1e3), 0.5)[0, 0] for _ in range(7)]
    np.testing.assert_allclose(jumped, [KNOBS[2].high] * 5 + [2.0, 2.0])
    noise_factors(agent, np.zeros((2, 3)), 0.5)  # found again: the gate is shut as before
    assert noise_factors(agent, np.full((2, 3), 1e3), 0.5)[0, 0] == pytest.approx(KNOBS[2].high)


def test_nis_gate_counts_the_channels_that_arrived():
    agent = started("nis-gate", {"gate": 1.0, "noise": 1.0})
    limit = np.sqrt(6.635 * 1.5)  # chi2_1(.99)
    assert noise_factors(agent, [0.999 * limit, np.nan, np.nan], 0.5)[0, 0] == 1.0
    assert noise_factors(agent, [1.001 * limit, np.nan, np.nan], 0.5)[0, 0] > 100.0


def test_huber_scales_its_noise():
    agent = started("huber-gate", {"threshold": 1.0, "gate": 100.0, "noise": 3.0})
    found = noise_factors(agent, [8.0, 1.0, 0.0], 7.0)  # S = 7 + 9: sizes 2, 1/4 and 0
    np.testing.assert_allclose(found[0], [3.0 * np.sqrt(2.0), 3.0, 3.0])


# -- rules that learn the noise ---------------------------------------------------------------


def test_pooled_noise_converges_to_a_common_level_and_scales():
    agent = started("pooled-noise", {"gate": 5.0, "fast_window": 20.0, "slow_window": 50.0}, 100)
    rng, actual, seen = np.random.default_rng(2), np.array([5.0, 10.0, 20.0]), []
    for _ in range(600):
        nu = rng.normal(size=(100, 3)) * np.sqrt(actual**2 + 0.3)
        seen.append(noise_factors(agent, nu, 0.3))
    np.testing.assert_allclose(np.median(np.concatenate(seen[300:]), axis=0), actual, rtol=0.1)


def test_pooled_noise_is_one_step_of_its_formula():
    agent = started("pooled-noise", {"gate": 3.0, "fast_window": 2.0, "slow_window": 30.0})
    # h = 1 / 2 in both channels; e = 3 and -1, rho = 1: F stays, s = 1 +- 0.5 / 30
    found = noise_factors(agent, [2.0, 0.0, np.nan], 1.0)[0]
    np.testing.assert_allclose(found**2, [1.0 + 0.5 / 30.0, 1.0 - 0.5 / 30.0, 1.0], rtol=1e-12)


def test_vb_noise_equals_its_published_pseudo_code():
    """Sarkka and Nummenmaa (2009), the algorithm of their table, on a linear random walk."""
    rng, rho, told = np.random.default_rng(3), 0.96, np.array([1.0, 2.0, 0.5])
    agent = started("vb-noise", {"forgetting": rho, "shape": 5.0})
    mean, P, Q = np.zeros(3), np.diag([4.0, 1.0, 2.0]), np.diag([0.1, 0.4, 0.2])
    alpha, beta = np.full(3, 5.0), 5.0 * told**2
    for _ in range(40):
        P, alpha, beta = P + Q, rho * alpha, rho * beta
        z = mean + rng.normal(size=3) * 3.0 * told
        before = beta.copy()
        alpha = alpha + 0.5
        for _ in range(5):
            shift, covariance = kalman(P, np.diag(beta / alpha), z - mean)
            noise = beta / alpha
            beta = before + 0.5 * (z - mean - shift) ** 2 + 0.5 * np.diag(covariance)
        found = noise_factors(agent, z - mean, np.diag(P), told)[0]
        np.testing.assert_allclose((found * told) ** 2, noise, rtol=1e-9)
        mean, P = mean + shift, covariance


def test_sage_husa_is_its_recursion():
    agent, b, R = started("sage-husa", {"forgetting": 0.9}), 0.9, 1.0
    for k, nu in enumerate((3.0, 0.5, -6.0), start=1):
        d = (1.0 - b) / (1.0 - b ** (k + 1))
        mean, covariance = kalman(np.array([[2.0]]), np.array([[R]]), np.array([nu]))
        R = (1.0 - d) * R + d * ((nu - mean[0]) ** 2 + covariance[0, 0])
        found = noise_factors(agent, [nu, np.nan, np.nan], 2.0)[0]
        np.testing.assert_allclose(found**2, [R, 1.0, 1.0], rtol=1e-12)


# -- fading -----------------------------------------------------------------------------------


def test_strong_tracking_is_the_published_factor():
    agent = started("strong-tracking", {"weakening": 2.0, "noise": 2.0})
    # R = 4, H P H^T = 1: V = 36, then (0.95 36 + 49) / 1.95; lambda = tr(V - 2 R) / tr(H P H^T)
    first = factors_of(agent.act(None, info([6.0, 6.0, 6.0], 1.0)))[0]
    np.testing.assert_allclose(first, [28.0, 1.0, 2.0, 2.0, 2.0])
    second = factors_of(agent.act(None, info([0.0, np.nan, np.nan], 3.0)))[0]
    assert second[0] == pytest.approx((0.95 * 36.0 / 1.95 - 8.0) / 3.0)


@pytest.mark.parametrize(
    "rule", ["innovation-fading", "innovation-fading-printed", "strong-tracking"]
)
def test_fading_scales_its_noise(rule):
    agent = started(rule, {"noise": 3.0, "process_noise": 5.0})
    found = factors_of(agent.act(None, info([0.1, 0.1, np.nan], 1.0)))[0]
    np.testing.assert_allclose(found, [1.0, 5.0, 3.0, 3.0, 1.0])


# -- limits -----------------------------------------------------------------------------------


def test_clairvoyant_rq_sees_how_hard_the_target_manoeuvres():
    scenario = BistaticTracking(duration=100.0)  # whose truth moves as the filter's model does
    recording = scenario.sample([np.random.default_rng(i) for i in range(20)])
    agent = make_agent("clairvoyant-rq").with_values({"floor": 0.5, "gain": 2.0})
    agent.reset(Briefing(knobs_of(scenario.sensor.groups), scenario, 20, 0, recording))
    nothing = info(np.zeros((20, 3)), 1.0)
    q = np.array([factors_of(agent.act(None, nothing))[:, 1] for _ in range(len(scenario.time))])
    np.testing.assert_allclose(q[0], 0.5)
    assert q[1:].min() > 0.5
    assert np.mean(q[1:]) == pytest.approx(0.5 + 2.0, rel=0.03)


def test_clairvoyant_rq_needs_the_truth():
    recording = SCENARIO.sample([np.random.default_rng(0)])
    blind = replace(recording, truth=None)
    with pytest.raises(ValueError, match="truth"):
        make_agent("clairvoyant-rq").reset(Briefing(KNOBS, SCENARIO, 1, 0, blind))
