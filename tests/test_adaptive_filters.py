"""Adaptive fading and Gaussian sums (SPEC 5, 6), and the failure that each erratum describes."""

import pickle
from dataclasses import replace
from decimal import Decimal
from math import log, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pairs import PAIRS, Case

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, AdaptiveDesign, AdaptiveFilter
from kfenv.filters.designs import DESIGNS, FilterDesign
from kfenv.filters.engine import Engine
from kfenv.filters.fading import Fading, fading_factor, second_moment
from kfenv.filters.gaussian_sum import GaussianSum, Mixture, collapse, posterior_log_weights
from kfenv.filters.matrices import transpose
from kfenv.filters.protocol import Knobs, Measurement
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.replay import faded_update, replay
from kfenv.filters.results import NOT_POSITIVE_DEFINITE, Prediction
from kfenv.models.model import Component, Motion, MotionFunctions, Sensor

EXTENDED, CUBATURE = ADAPTIVE_DESIGNS["ekf"].base, ADAPTIVE_DESIGNS["ckf"].base


# -- a world simple enough to compute by hand: F = I, H = I ------------------------------


def still(count=1, q=0.1):
    """States that stay where they are, each with process noise q a step."""
    states = tuple(Component(f"x{i}", "m") for i in range(count))

    def build(xp):
        def noise_factor(x, u, dt):
            return tuple(sqrt(q) + 0.0 * x[i] for i in range(count))

        return MotionFunctions(lambda x, u, dt: x, noise_factor)

    pattern = tuple((i, i) for i in range(count))
    return Motion("still", states, (0, 0, 0), (0, 0, 0), pattern, build)


def direct(count=1):
    """Every state measured as it is."""
    channels = tuple(Component(f"z{i}", "m", "position") for i in range(count))
    return Sensor("direct", channels, lambda xp: lambda x, s: x)


def pending(P, z, sd=1.0, q=0.0, m=1):
    """Arguments of an update: prediction with covariance P I + q I, knobs at one, measurement."""
    root, noise = sqrt(P) * np.eye(m)[None], sqrt(q) * np.eye(m)[None]
    prediction = Prediction(np.zeros((1, m)), root, noise)
    seen = Measurement(np.zeros((1, 0)), np.full((1, m), float(z)), np.full((1, m), float(sd)))
    return prediction, Knobs.nominal(1), seen, np.zeros(1, np.int64)


def still_case(batch=3, steps=60, m=2, seed=0, missing=0.0):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(batch, steps, m)) * 1.3
    z[rng.random(z.shape) < missing] = np.nan
    nothing = np.zeros((batch, steps, 0))
    factor = np.broadcast_to(2.0 * np.eye(m), (batch, m, m)).copy()
    mean, time, sd = np.zeros((batch, m)), 0.1 * np.arange(steps), np.ones(z.shape)
    return Case(mean, factor, time, nothing, nothing, z, sd, Knobs.nominal(batch))


# -- fading -----------------------------------------------------------------------------


@pytest.mark.parametrize(("applied", "expected"), [("once", 3.1 / 4.1), ("twice", None)])
def test_fading_twice_makes_the_covariance_negative(applied, expected):
    """SPEC 6: scalar, P = 1, Q = 0.1, R = 1, lambda = 3: P+ = -5.3 as printed, right 0.756."""
    rule = Fading(beta=1.0, applied=applied)
    # The unfaded H P H^T is 1.1, so lambda = 3 wants V = 1 + 3.3.
    tier = ReferenceFilter(still(), direct(), EXTENDED)
    arguments = pending(P=1.0, z=sqrt(1.0 + 3.0 * 1.1), q=0.1)
    status = arguments[-1]
    told, _ = faded_update(tier, rule, *arguments, np.full((1, 1), np.nan))
    if expected is None:
        predicted = 3.0 * 1.0 + 0.1
        K, Pyy = 3.0 * predicted / (3.0 * predicted + 1.0), 3.0 * predicted + 1.0
        assert predicted - K * Pyy * K == pytest.approx(-5.297, abs=1e-3)
        assert status[0] == NOT_POSITIVE_DEFINITE
    else:
        assert told.factor[0, 0, 0] ** 2 == pytest.approx(expected, rel=1e-12)
        assert expected == pytest.approx(0.756, abs=1e-3)
        assert status[0] == 0


@given(
    P=st.floats(0.1, 5.0), q=st.floats(0.01, 1.0), z=st.floats(0.0, 2.5),
    m=st.integers(1, 3),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_fading_twice_is_the_printed_covariance_where_that_is_positive(P, q, z, m):
    """Eq 35, 41, 42 in covariance form against the square-root one."""
    rule = Fading(beta=1.0, applied="twice")
    tier = ReferenceFilter(still(m), direct(m), EXTENDED)
    arguments = pending(P, z, q=q, m=m)
    status = arguments[-1]
    told, _ = faded_update(tier, rule, *arguments, np.full((1, m), np.nan))
    factor = max(1.0, (z * z - 1.0) / (P + q))
    predicted = factor * P + q
    expected = predicted - (factor * predicted) ** 2 / (factor * predicted + 1.0)
    if abs(expected) > 1e-6:
        assert (status[0] == 0) == (expected > 0.0)
    if expected > 1e-6:
        np.testing.assert_allclose(told.factor[0] ** 2, expected * np.eye(m), atol=1e-10)
        gain = factor * predicted / (factor * predicted + 1.0)
        np.testing.assert_allclose(told.mean[0], gain * z, atol=1e-12)


def test_the_raw_second_moment_depends_on_where_the_origin_lies():
    """SPEC 6, eq 40: lambda = 1.05 at 1 km makes 50 105 m^2 of 100 m^2, not 105."""
    variances = {}
    for applied in ("once", "raw-moment"):
        tier = ReferenceFilter(still(), direct(), CUBATURE)
        prediction, *rest = pending(P=100.0, z=1000.0 + sqrt(1.0 + 105.0))
        prediction = prediction._replace(mean=np.full((1, 1), 1000.0))
        rule = Fading(beta=1.0, applied=applied)
        told, _ = faded_update(tier, rule, prediction, *rest, np.full((1, 1), np.nan))
        variances[applied] = told.variance[0, 0] - 1.0
    assert variances["once"] == pytest.approx(105.0, rel=1e-9)
    assert variances["raw-moment"] == pytest.approx(50105.0, rel=1e-9)


def test_fading_raises_the_gain_at_an_outlier():
    """SPEC 6: scalar, 20-sigma outlier: gain 0.5 -> 0.998, the opposite of robust."""
    tier = ReferenceFilter(still(), direct(), CUBATURE)
    plain = tier.update(*pending(P=1.0, z=20.0))
    faded, _ = faded_update(tier, Fading(), *pending(P=1.0, z=20.0), np.full((1, 1), np.nan))
    assert plain.mean[0, 0] / 20.0 == pytest.approx(0.5, abs=1e-12)
    assert faded.mean[0, 0] / 20.0 == pytest.approx(0.998, abs=1e-3)
    mixture = GaussianSum(tier, Mixture())
    robust, _ = faded_update(
        mixture, Fading(v_mode="robust"), *pending(P=1.0, z=20.0), np.full((1, 1), np.nan)
    )
    assert robust.mean[0, 0] / 20.0 < 0.01


def test_the_second_moment_remembers_three_samples():
    """SPEC 6: unbiased, and Var V = 2 / 2.9 for white unit innovations."""
    rng = np.random.default_rng(0)
    moment, total = np.full((20000, 1), np.nan), []
    for _ in range(30):
        moment = second_moment(Fading(), moment, rng.normal(size=moment.shape), moment)
        total.append(moment.copy())
    settled = total[-1]
    assert settled.mean() == pytest.approx(1.0, abs=0.03)
    assert 2.0 / settled.var() == pytest.approx(2.9, rel=0.05)


@pytest.mark.parametrize(("beta", "low", "high"), [(1.0, 0.42, 0.45), (3.0, 0.0, 0.04)])
def test_a_consistent_filter_fades_for_no_reason(beta, low, high):
    """SPEC 6: lambda > 1 in 42 to 45 % of the steps at beta = 1, in 0 to 4 % at beta = 3."""
    rng = np.random.default_rng(1)
    rule, S = Fading(beta=beta), np.full((20000, 3), 1.1)
    moment = np.full(S.shape, np.nan)
    for _ in range(30):
        moment = second_moment(rule, moment, np.sqrt(S) * rng.normal(size=S.shape), S)
    factor = fading_factor(rule, moment, S, np.ones(S.shape))
    assert low <= np.mean(factor > 1.0) <= high
    if beta == 1.0:
        assert np.percentile(factor, 99) == pytest.approx(18.0, rel=0.15)


def test_normalised_traces_are_free_of_units_and_printed_ones_are_not():
    """SPEC 6: position is 99.92 % of tr R as printed, so that attitude cannot fade anything."""
    sd = np.array([[15.0] * 3 + [0.5] * 3 + [0.02] * 3])
    variance, moment = 2.0 * sd**2, sd**2 * ([1.0] * 6 + [60.0] * 3)  # attitude is off
    kilo = np.array([1e-9] * 3 + [1.0] * 6)  # position in other units
    other = (moment * kilo**2, variance * kilo**2, sd * kilo)
    assert fading_factor(Fading(), moment, variance, sd) == pytest.approx((6 + 180 - 13.5) / 9)
    assert fading_factor(Fading(), *other) == pytest.approx((6 + 180 - 13.5) / 9)
    printed = Fading(norm=False, beta=1.0)
    assert fading_factor(printed, moment, variance, sd) == 1.0
    moment[:, :3] *= 5.0
    assert fading_factor(printed, moment, variance, sd) == pytest.approx(2.0, abs=0.01)
    moment[:, 6:] *= 1e-3
    assert fading_factor(printed, moment, variance, sd) == pytest.approx(2.0, abs=0.01)
    # Numerator and denominator do not match as printed: P_yy holds R, too.
    scalar = (np.array([[11.5]]), np.array([[2.0]]), np.array([[1.0]]))
    assert fading_factor(Fading(), *scalar) == pytest.approx(10.0)
    assert fading_factor(Fading(norm=False), *scalar) == pytest.approx(5.0)


def test_missing_channels_keep_their_moment_and_count_in_no_trace():
    rule = Fading()
    nan = np.nan
    moment = second_moment(rule, np.array([[4.0, nan, nan]]), np.array([[nan, 2.0, nan]]), nan)
    np.testing.assert_array_equal(moment, [[4.0, 4.0, nan]])
    factor = fading_factor(rule, moment, np.array([[nan, 2.0, nan]]), np.ones((1, 3)))
    assert factor == pytest.approx(4.0 - 1.5)
    assert fading_factor(rule, moment, np.full((1, 3), nan), np.ones((1, 3))) == 1.0


def test_the_fading_filter_is_its_recursion_written_out():
    """Scalar Kalman filter with SPEC 6 by hand, over a run with steps that skip."""
    case = still_case(batch=1, steps=80, m=1, seed=5)
    case.measurement[0, 40:] += 6.0
    case.measurement[0, 5::7] = np.nan
    found = AdaptiveFilter(still(), direct(), "ackf").history(case, case.knobs)
    x, P, V = 0.0, 4.0, None
    for t in range(80):
        Q = 0.1 if t else 0.0
        nu = case.measurement[0, t, 0] - x
        if np.isnan(nu):
            P = P + Q
        else:
            V = nu**2 if V is None else (0.95 * V + nu**2) / 1.95
            P = max(1.0, (V - 1.5) / (P + Q)) * P + Q
            K = P / (P + 1.0)
            x, P = x + K * nu, (1.0 - K) * P
        assert found.mean[0, t, 0] == pytest.approx(x, abs=1e-10)
        assert found.covariance[0, t, 0, 0] == pytest.approx(P, abs=1e-10)


# -- the Gaussian sum --------------------------------------------------------------------


def test_weight_of_the_outlier_branch_at_zero_innovation():
    """SPEC 5: 0.011 with the mixture's prior, 0.059 with the printed one."""
    tier = ReferenceFilter(still(), direct(), EXTENDED)
    for as_printed, expected in ((False, 0.0110), (True, 0.0594)):
        sums = GaussianSum(tier, Mixture(as_printed=as_printed))
        _, nominal = sums.nominal_probability(*pending(P=1.0, z=0.0))
        assert 1.0 - nominal[0] == pytest.approx(expected, rel=5e-3)


def test_weights_are_right_where_likelihoods_underflow():
    """SPEC 5: 40 sigma in 9 channels, where gamma underflows; against decimals."""
    sigma, m = 20.0, 9
    tier = ReferenceFilter(still(m), direct(m), CUBATURE)
    sums = GaussianSum(tier, Mixture())
    prediction, knobs, seen, status = pending(P=1.0, z=0.0, m=m)
    for size in (40.0, 3.0, 0.0):
        S = 1.0 + sigma**2
        z = np.zeros((1, m)) + size * sqrt(S)
        told, nominal = sums.nominal_probability(
            prediction._replace(root=sigma * prediction.root), knobs, seen._replace(value=z), status
        )
        total = Decimal(m) * Decimal(z[0, 0]) ** 2
        gammas = [  # all but the powers of 2 pi; exponents of decimals do not underflow
            Decimal(w) / Decimal(v).sqrt() ** m * (-total / Decimal(2.0 * v)).exp()
            for w, v in (("0.85", S), ("0.15", 500.0 + sigma**2))
        ]
        alpha = gammas[0] / sum(gammas)
        assert nominal[0] == pytest.approx(float(alpha), rel=1e-9)
        assert size < 40.0 or np.exp(told.log_likelihood[0]) == 0.0
        expected = -0.5 * m * (size**2 + log(2.0 * pi * S))
        assert told.log_likelihood[0] == pytest.approx(expected, rel=1e-10)
    log_weights = posterior_log_weights(np.log([[0.85], [0.15]]), np.array([[-7200.0], [-3618.0]]))
    np.testing.assert_allclose(log_weights[:, 0], [-3582.0 + log(0.85 / 0.15), 0.0], rtol=1e-12)


@given(seed=st.integers(0, 10**6), branches=st.integers(1, 4), n=st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_collapse_keeps_mean_and_covariance(seed, branches, n):
    """Against sum w m m^T - x x^T, in small numbers where that is accurate."""
    rng = np.random.default_rng(seed)
    w = rng.dirichlet(np.ones(branches), size=2).T
    means = rng.normal(size=(branches, 2, n))
    factors = np.tril(rng.normal(size=(branches, 2, n, n)))
    mean, factor = collapse(w, means, factors, np.array([], int))
    first = np.einsum("jb,jbi->bi", w, means)
    second = np.einsum("jb,jbi,jbk->bik", w, means, means)
    second += np.einsum("jb,jbil,jbkl->bik", w, factors, factors)
    np.testing.assert_allclose(mean, first, atol=1e-12)
    expected = second - first[:, :, None] * first[:, None, :]
    np.testing.assert_allclose(factor @ transpose(factor), expected, atol=1e-11)
    assert np.all(np.diagonal(factor, axis1=1, axis2=2) >= 0.0)
    printed = collapse(w, means, factors, np.array([], int), spread_of_means=False)[1]
    within = np.einsum("jb,jbil,jbkl->bik", w, factors, factors)
    np.testing.assert_allclose(printed @ transpose(printed), within, atol=1e-11)


def test_collapse_averages_angles_across_the_cut():
    means = np.array([[[pi - 0.1]], [[-pi + 0.3]]])
    mean, factor = collapse(np.array([[0.5], [0.5]]), means, np.zeros((2, 1, 1, 1)), np.array([0]))
    assert mean[0, 0] == pytest.approx(-pi + 0.1, abs=1e-12)
    assert factor[0, 0, 0] == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize("kind", ["ekf", "ckf"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_without_outliers_the_sum_is_its_base(kind, missing):
    """weight = 0, and robust fading then is printed fading but for V_0."""
    motion, sensor, make = PAIRS["robot, beacon"]
    case = make(batch=3, steps=120, missing=missing)
    base = ADAPTIVE_DESIGNS[kind].base
    plain = AdaptiveFilter(motion, sensor, kind).history(case, case.knobs)
    sums = AdaptiveFilter(motion, sensor, AdaptiveDesign(base, None, Mixture(weight=0.0))).history(
        case, case.knobs
    )
    np.testing.assert_allclose(sums.mean, plain.mean, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(sums.covariance, plain.covariance, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(sums.nis, plain.nis, rtol=1e-8, atol=1e-8)


def test_the_sum_is_its_equations_written_out():
    """One update of two channels in covariance form, S4 eq 43 to 46 with SPEC 5."""
    P, z, R = np.array([[2.0, 0.6], [0.6, 1.0]]), np.array([1.5, -7.0]), np.diag([1.0, 2.0])
    prediction = Prediction(np.zeros((1, 2)), np.linalg.cholesky(P)[None], np.zeros((1, 2, 2)))
    tier = GaussianSum(ReferenceFilter(still(2), direct(2), CUBATURE), Mixture(0.3, 20.0))
    seen = Measurement(np.zeros((1, 0)), z[None], np.sqrt([[1.0, 2.0]]))
    arguments = (prediction, Knobs.nominal(1), seen, np.zeros(1, np.int64))
    found = tier.update(*arguments)
    means, covariances, gammas = [], [], []
    for prior, noise in ((0.7, R), (0.3, 20.0 * R)):
        S = P + noise
        K = P @ np.linalg.inv(S)
        means.append(K @ z)
        covariances.append(P - K @ S @ K.T)
        density = np.exp(-0.5 * z @ np.linalg.solve(S, z)) / sqrt(np.linalg.det(2.0 * pi * S))
        gammas.append(prior * density)
    alpha = np.array(gammas) / sum(gammas)
    mean = sum(a * m for a, m in zip(alpha, means, strict=True))
    expected = sum(
        a * (C + np.outer(m - mean, m - mean))
        for a, m, C in zip(alpha, means, covariances, strict=True)
    )
    np.testing.assert_allclose(found.mean[0], mean, rtol=1e-12)
    np.testing.assert_allclose(found.factor[0] @ found.factor[0].T, expected, rtol=1e-11)
    assert found.log_likelihood[0] == pytest.approx(log(sum(gammas)), rel=1e-12)
    likelier = tier.update(*arguments, outlier_odds=np.array([10.0]))
    assert np.abs(likelier.mean).max() < np.abs(found.mean).max()


def test_the_sum_ignores_what_a_plain_filter_follows():
    case = still_case(batch=50, steps=200, m=2, seed=3)
    rng = np.random.default_rng(4)
    hit = rng.random((50, 200, 1)) < 0.15
    z = rng.normal(size=case.measurement.shape) * np.where(hit, sqrt(500.0), 1.0)
    error = {
        name: np.sqrt(np.mean(AdaptiveFilter(still(2), direct(2), name).run(
            case._replace(measurement=z), case.knobs).mean[:, 50:] ** 2))
        for name in ("ckf", "gsckf", "ackf", "gsackf")
    }  # fmt: skip
    assert error["gsckf"] < 0.3 * error["ckf"]
    assert error["ackf"] > error["ckf"]
    assert error["gsackf"] < 0.5 * error["ckf"]


# -- the eight filters --------------------------------------------------------------------


@pytest.mark.parametrize("sums", ["", "gs"])
@pytest.mark.parametrize("fades", ["", "a"])
def test_where_everything_is_linear_extended_is_cubature(sums, fades):
    case = still_case(batch=3, steps=60, m=3, missing=0.2)
    first, second = (
        AdaptiveFilter(still(3), direct(3), f"{sums}{fades}{kind}").history(case, case.knobs)
        for kind in ("ekf", "ckf")
    )
    np.testing.assert_allclose(first.mean, second.mean, atol=1e-10)
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-9, atol=1e-11)


def test_the_plain_ones_are_filters_of_the_family():
    motion, sensor, make = PAIRS["robot, beacon"]
    case = make(batch=2, steps=60)
    for name, other in (("ekf", "ekf-joseph"), ("ckf", "srckf-joseph-exact")):
        found = AdaptiveFilter(motion, sensor, name).history(case, case.knobs)
        expected = ReferenceFilter(motion, sensor, other).history(case, case.knobs)
        np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-8, atol=1e-12)
        assert DESIGNS[other].transform == ADAPTIVE_DESIGNS[name].base.transform


@pytest.mark.parametrize("name", ["ckf", "ackf", "gsckf", "gsackf"])
def test_over_the_engine_as_over_the_reference(name):
    motion, sensor, make = PAIRS["strapdown, navigation fix"]
    case = make(batch=11, steps=60)
    design = replace(ADAPTIVE_DESIGNS[name], base=DESIGNS["srukf-joseph-exact"])
    fast = Engine(motion, sensor)
    tier = GaussianSum(fast, design.mixture) if design.mixture else fast
    found = replay(tier, design.fading, case, case.knobs)
    expected = AdaptiveFilter(motion, sensor, design).history(case, case.knobs)
    sd = np.sqrt(np.diagonal(expected.covariance, axis1=2, axis2=3))
    assert np.max(np.abs(found.mean - expected.mean) / sd) < 1e-9
    np.testing.assert_array_equal(found.status, 0)


@pytest.mark.parametrize("name", ADAPTIVE_DESIGNS)
def test_a_broken_filter_leaves_its_neighbours_alone(name):
    motion, sensor, make = PAIRS["robot, beacon"]
    case = make(batch=4, steps=40)
    broken = case._replace(motion_inputs=case.motion_inputs.copy())
    broken.motion_inputs[2, 20] = np.nan
    tier = AdaptiveFilter(motion, sensor, name)
    whole, hurt = tier.history(case, case.knobs), tier.history(broken, broken.knobs)
    assert hurt.status[2] != 0 and hurt.failed_at[2] == 20
    assert np.isnan(hurt.mean[2, 20:]).all() and np.isfinite(hurt.mean[2, :20]).all()
    np.testing.assert_array_equal(hurt.mean[[0, 1, 3]], whole.mean[[0, 1, 3]])
    one = case.only([1])
    alone = tier.history(one, one.knobs)
    np.testing.assert_array_equal(alone.mean[0], whole.mean[1])
    again = pickle.loads(pickle.dumps(tier)).run(case, case.knobs)
    np.testing.assert_array_equal(again.mean, whole.mean)


def test_an_update_by_nothing_hands_out_copies():
    """The environment writes into what it is handed, where filters end at different times."""
    for tier in (ReferenceFilter(still(), direct(), CUBATURE),
                 GaussianSum(ReferenceFilter(still(), direct(), EXTENDED))):  # fmt: skip
        prediction, *rest = pending(P=1.0, z=np.nan)
        told = tier.update(prediction, *rest)
        for array in prediction:
            assert not np.shares_memory(told.mean, array)
            assert not np.shares_memory(told.factor, array)
        np.testing.assert_array_equal(told.mean, prediction.mean)
        assert told.log_likelihood[0] == 0.0 and np.isnan(told.nis[0])


def test_names_and_parts_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="Did you mean 'gsckf'"):
        AdaptiveFilter(still(), direct(), "gsckff")
    with pytest.raises(ValueError, match="square-root"):
        AdaptiveDesign(DESIGNS["ekf-joseph"])
    with pytest.raises(ValueError, match="robust"):
        AdaptiveDesign(
            FilterDesign("cubature", "square-root", "classical"), Fading(v_mode="robust")
        )
    for wrong in ({"rho": 0.0}, {"eta": -1.0}, {"beta": 0.5}, {"v_mode": "x"}, {"applied": "x"}):
        with pytest.raises(ValueError, match=next(iter(wrong)).replace("applied", "apply")):
            Fading(**wrong)
    for wrong in ({"weight": 1.0}, {"ratio": 1.0}, {"weight": float("nan")}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Mixture(**wrong)
