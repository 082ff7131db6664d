"""Banks: one mode is the filter, moments are exact, FilterPy's IMM agrees, failures stay alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contestants.banks.noise_and_motion import MisreportBank
from kfenv.agents.contestants.fault_model import factors
from kfenv.agents.contestants.registry import BANKS, make_agent
from numba import njit
from pairs import drawn_case, position_sensor

from kfenv.filters.bank import Bank, Mode, markov
from kfenv.filters.engine import Engine
from kfenv.filters.gaussian_sum import Mixture
from kfenv.filters.mixing import MOST, _triangularise, mix
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.namespaces.compiled import FLOATING_POINT
from kfenv.scenarios.radar.tracking import RadarTracking

ENV, KEYWORDS = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 20.0}
SCENARIO = RadarTracking(duration=30.0, rate=2.0, faults="none")
DT, STEPS = 0.2, 60


@pytest.fixture(scope="module")
def engine():
    return Engine(SCENARIO.motion, SCENARIO.sensor)


@pytest.fixture(scope="module")
def recording():
    return SCENARIO.sample([np.random.default_rng(seed) for seed in range(9)])


def linear_case(steps=STEPS):
    """A target that moves as the filter believes, its position measured."""
    start = np.array([-6e3, 120.0, 0.0, 3e3, 30.0, 0.0, 1e3, 0.0, 0.0])
    factor = np.diag([300.0, 30.0, 3.0] * 3)
    sd = np.full((1, steps, 3), 20.0)
    sd[:, 20:30] *= 5.0
    sd[:, 40::9] = np.nan
    return drawn_case(constant_acceleration(2.0), position_sensor(), start, factor, sd, DT)[1]


# -- moments ----------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.integers(1, 17), st.integers(1, 5), st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_mixtures_have_the_moments_of_their_components(seed, batch, components, targets):
    rng = np.random.default_rng(seed)
    n, angle = 4, 2
    factor = np.tril(rng.standard_normal((batch, components, n, n)), -1)
    factor += np.eye(n) * rng.uniform(0.1, 3.0, (batch, components, 1, n))
    mean = rng.standard_normal((batch, components, n))
    mean[..., angle] = 3.0 + 0.3 * mean[..., angle]  # about the cut at pi
    weights = rng.dirichlet(np.ones(components), (batch, targets)).swapaxes(1, 2).copy()
    wrapped = mean.copy()
    wrapped[..., angle] = np.arctan2(np.sin(mean[..., angle]), np.cos(mean[..., angle]))
    is_angle = np.arange(n) == angle
    found, root = mix(weights, wrapped, factor, is_angle)
    expected = np.einsum("bij,bin->bjn", weights, mean)
    off = mean[:, :, None] - expected[:, None]
    P = np.einsum("bij,binm->bjnm", weights, factor @ factor.swapaxes(-1, -2))
    P += np.einsum("bij,bijn,bijm->bjnm", weights, off, off)
    difference = found - expected
    difference[..., angle] = np.sin(difference[..., angle])
    assert np.abs(difference).max() < 1e-12
    assert np.all(np.abs(found[..., angle]) <= np.pi)
    deviation = np.sqrt(np.diagonal(P, axis1=2, axis2=3))
    scale = deviation[..., :, None] * deviation[..., None, :]
    digits = MOST * np.finfo(float).eps  # that are lost before it takes the longer way
    np.testing.assert_allclose(root @ root.swapaxes(-1, -2) / scale, P / scale, atol=digits)
    assert np.all(np.diagonal(root, axis1=2, axis2=3) >= 0.0)


def test_covariances_beyond_double_precision_keep_their_square_root():
    factor = np.array([[1.0, 0.0], [1.0, 1e-9]])  # its square has no positive pivot left
    assert np.linalg.cond(factor @ factor.T) > 1e16
    weights = np.full((1, 2, 1), 0.5)
    _, root = mix(weights, np.zeros((1, 2, 2)), np.tile(factor, (1, 2, 1, 1)), np.zeros(2, bool))
    np.testing.assert_array_equal(root[0, 0], factor)


def test_a_component_without_spread_is_no_obstacle():
    factor = np.stack([np.zeros((2, 2)), np.array([[1.0, 0.0], [0.5, 2.0]])])[None]
    weights = np.array([[[0.9], [0.1]]])
    _, root = mix(weights, np.zeros((1, 2, 2)), factor, np.zeros(2, bool))
    np.testing.assert_allclose(root[0, 0], np.sqrt(0.1) * factor[0, 1], rtol=1e-14)


def test_triangularising_equals_squaring_where_both_work():
    rng = np.random.default_rng(0)
    factor, mean = np.tril(rng.standard_normal((3, 4, 4))), rng.standard_normal((3, 4))
    weights, L = np.array([0.2, 0.5, 0.3]), np.zeros((4, 4))
    centre = weights @ mean

    @njit(**FLOATING_POINT)
    def triangularise(weights, mean, centre, angles, factor, L):
        _triangularise(weights, mean, centre, angles, factor, L)

    triangularise(weights, mean, centre, np.zeros(4, bool), factor, L)
    off = mean - centre
    P = np.einsum("i,inm->nm", weights, factor @ factor.swapaxes(1, 2))
    np.testing.assert_allclose(L @ L.T, P + np.einsum("i,in,im->nm", weights, off, off), rtol=1e-12)


# -- against the filter and an independent bank -----------------------------------------------


def test_a_bank_of_one_is_its_filter(engine, recording):
    run, bank = engine.run(recording), Bank(engine, [Mode()], np.eye(1)).history(recording)
    np.testing.assert_array_equal(bank.mean, run.mean)
    np.testing.assert_array_equal(bank.nis, run.nis)


def test_identical_modes_are_their_filter(engine, recording):
    run = engine.run(recording)
    bank = Bank(engine, [Mode()] * 3, markov(np.full((3, 3), 0.4))).history(recording)
    deviation = np.sqrt(np.diagonal(bank.covariance, axis1=2, axis2=3))
    assert np.abs((bank.mean - run.mean) / deviation).max() < 1e-12
    outliers = Bank(engine, [Mode()], np.eye(1), Mixture(0.3, 1.0 + 1e-15)).history(recording)
    assert np.abs((outliers.mean - run.mean) / deviation).max() < 1e-9  # of noise one ulp larger


def test_a_linear_bank_equals_filterpys():
    filterpy = pytest.importorskip("filterpy.kalman")
    case, H = linear_case(), np.zeros((3, 9))
    H[[0, 1, 2], [0, 3, 6]] = 1.0
    M = np.array([[0.9, 0.1], [0.1, 0.9]])  # keeps even odds even, as FilterPy's start needs
    modes = [Mode(), Mode(noise=5.0, process_noise=3.0)]
    F1 = np.array([[1.0, DT, 0.5 * DT**2], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
    powers = np.array([[DT**5 / 20, DT**4 / 8, DT**3 / 6], [DT**4 / 8, DT**3 / 3, DT**2 / 2],
                       [DT**3 / 6, DT**2 / 2, DT]])  # fmt: skip
    filters = []
    for mode in modes:
        one = filterpy.KalmanFilter(9, 3)
        one.x, one.P = case.mean[0].copy(), case.factor[0] @ case.factor[0].T
        one.F, one.H = np.kron(np.eye(3), F1), sensor_matrix()
        one.Q = mode.process_noise * 2.0 * np.kron(np.eye(3), powers)
        one.R = (mode.noise * 20.0) ** 2 * np.eye(3)
        filters.append(one)
    imm = filterpy.IMMEstimator(filters, np.array([0.5, 0.5]), M)
    reference = ReferenceFilter(constant_acceleration(2.0), position_sensor())
    arrived = ~np.isnan(case.measurement[0, :, 0])
    told = case._replace(noise=np.full_like(case.noise, 20.0))
    bank = Bank(reference, modes, M).history(told)
    for t in range(40):  # from there on measurements are missing, which FilterPy does not know
        assert arrived[t]
        if t:
            imm.predict()
        imm.update(case.measurement[0, t])
        deviation = np.sqrt(np.diagonal(imm.P))
        assert np.abs((bank.mean[0, t] - imm.x) / deviation).max() < 1e-9, t
        off = (bank.covariance[0, t] - imm.P) / np.outer(deviation, deviation)
        assert np.abs(off).max() < 1e-9, t


def sensor_matrix():
    """Of `position_sensor`, by measuring unit states."""
    from kfenv.models.namespaces import scalar

    measure = position_sensor().build(scalar)
    return np.array([measure(tuple(row), ()) for row in np.eye(9)]).T


# -- chains, doors and failures ---------------------------------------------------------------


def test_a_chain_of_two_has_its_closed_form():
    up, down, dt = 0.3, 0.1, 2.5
    stationary = up / (up + down)
    gone = stationary * (1.0 - np.exp(-(up + down) * dt))
    np.testing.assert_allclose(markov([[7.0, up], [down, 7.0]])(dt)[0], [1.0 - gone, gone])
    np.testing.assert_allclose(markov([[0.0, up], [down, 0.0]])(0.0), np.eye(2))


@pytest.mark.parametrize(
    ("modes", "transition", "complaint"),
    [
        ([], np.eye(0), "at least one mode"),
        ([Mode(noise=-1.0)], np.eye(1), "positive"),
        ([Mode(), Mode()], np.eye(3), r"shape \(2, 2\)"),
        ([Mode(), Mode()], np.array([[0.5, 0.6], [0.0, 1.0]]), "sum 1"),
        ([Mode(), Mode()], np.array([[1.5, -0.5], [0.0, 1.0]]), "sum 1"),
    ],
)
def test_what_is_no_bank_is_refused(engine, modes, transition, complaint):
    with pytest.raises(ValueError, match=complaint):
        Bank(engine, modes, transition)


@pytest.mark.parametrize("rate", [-0.1, np.nan, np.inf])
def test_what_is_no_rate_is_refused(rate):
    with pytest.raises(ValueError, match="Switching rates"):
        markov([[0.0, rate], [0.1, 0.0]])


def test_a_bank_that_fails_leaves_the_others_alone(engine, recording):
    from dataclasses import replace

    measurement = recording.measurement.copy()
    measurement[4, 7] = 1e200
    spoilt = replace(recording, measurement=measurement)
    bank = Bank(engine, [Mode(), Mode(noise=4.0)], markov(np.full((2, 2), 0.1)))
    whole, sound = bank.history(recording), bank.history(spoilt)
    others = np.arange(9) != 4
    np.testing.assert_array_equal(sound.mean[others], whole.mean[others])
    assert sound.status[4] != 0 and sound.failed_at[4] == 7 and not sound.status[others].any()
    assert np.isnan(sound.mean[4, 7:]).all()


# -- contestants ------------------------------------------------------------------------------


def test_a_misreported_noise_is_learnt():
    case, tier = linear_case(300), ReferenceFilter(constant_acceleration(2.0), position_sensor())
    told = case._replace(noise=20.0 / factors((3,))[0] * np.ones_like(case.noise))
    bank = MisreportBank(tier, [Mode(), Mode(noise=5.0)], markov(np.full((2, 2), 0.1)), None,
                         (-6, -3, 0, 3, 6), 1e-4)  # fmt: skip
    bank.history(told)
    assert np.all(np.argmax(bank._belief[0], axis=1) == 3)
    assert np.all(bank._belief[0, :, 3] > 0.9)


def test_two_filters_of_one_process_noise_are_the_single_one():
    recording = draw_episodes(ENV, KEYWORDS, "test", 3, 6)
    shared = {"up": 0.05, "down": 0.02, "glint_share": 0.1, "leak": 1e-4, "process_noise": 1.0}
    two = make_agent("hmm-2q").with_values({**shared, "manoeuvre": 1.0})
    one = make_agent("hmm-noise").with_values(shared)
    found, expected = (rollout(agent, ENV, KEYWORDS, recording) for agent in (two, one))
    sound = expected.rmse < 300.0  # elsewhere rounding grows
    assert sound.sum() >= 5
    np.testing.assert_allclose(found.rmse[sound], expected.rmse[sound], rtol=1e-6)


@pytest.mark.parametrize("name", BANKS)
def test_banks_do_better_than_the_nominal_filter(name):
    recording = draw_episodes(ENV, KEYWORDS, "test", 0, 40)
    bank, fixed = (rollout(make_agent(one), ENV, KEYWORDS, recording) for one in (name, "fixed"))
    assert np.mean(np.log(bank.rmse / fixed.rmse)) < -0.3
    alone = rollout(make_agent(name), ENV, KEYWORDS, recording[[17]])
    assert alone.rmse[0] == bank.rmse[17]


def test_a_bank_needs_the_compiled_filter():
    from kfenv.agents.contest.rollout import scenario_and_options

    scenario, options = scenario_and_options(ENV, {"filter": "srukf-joseph"})
    with pytest.raises(ValueError, match="imm works with the compiled filter"):
        make_agent("imm").check(scenario, options, None)
