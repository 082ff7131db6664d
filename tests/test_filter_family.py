"""The filters of the family equal each other where their algebra says so, and only there."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pairs import PAIRS, position_sensor, radar_case, robot_case

from kfenv.filters import covariance, square_root
from kfenv.filters.designs import DESIGNS, FilterDesign, find_design
from kfenv.filters.engine import Engine
from kfenv.filters.matrices import transpose, tria
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.transforms import StateFunction, extended, sigma_weights, unscented
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Sensor
from kfenv.models.namespaces import batch, dual
from kfenv.models.process_noise import white_jerk
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

AIRCRAFT = variable_turn(), radar()
JOSEPH_AS_PRINTED = ("ukf-joseph", "srukf-joseph")


def deviations(history):
    return np.sqrt(np.diagonal(history.covariance, axis1=2, axis2=3))


def assert_same_filter(a, b, tolerance):
    """Means within the tolerance of a deviation, covariances of the deviations' products."""
    sd = deviations(b)
    assert np.max(np.abs(a.mean - b.mean) / sd) < tolerance
    scale = sd[..., :, None] * sd[..., None, :]
    assert np.max(np.abs(a.covariance - b.covariance) / scale) < tolerance
    np.testing.assert_allclose(a.nis, b.nis, rtol=1e-6, atol=1e-6)


def histories(*designs, case=None):
    case = radar_case(batch=3, steps=200) if case is None else case
    return [ReferenceFilter(*AIRCRAFT, design).history(case, case.knobs) for design in designs]


# -- linear models: everything is the Kalman filter ----------------------------------


def kalman(case, q, H):
    """The Kalman filter of the textbook, one recording at a time."""
    means, covariances = [], []
    for b in range(len(case.mean)):
        x, P = case.mean[b], case.factor[b] @ case.factor[b].T
        for t in range(len(case.time)):
            fading, scale = case.knobs.fading[b], case.knobs.process_scale[b]
            dt = case.time[t] - case.time[t - 1] if t else 0.0
            F = np.kron(np.eye(3), [[1.0, dt, dt**2 / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
            Q = np.kron(np.eye(3), q * white_jerk(dt))
            x, P = F @ x, fading * F @ P @ F.T + scale * Q
            seen = ~np.isnan(case.measurement[b, t])
            h, R = H[seen], np.diag(case.noise[b, t, seen] ** 2)
            S = h @ P @ h.T + R
            K = np.linalg.solve(S, h @ P).T
            x = x + K @ (case.measurement[b, t, seen] - h @ x)
            P = P - K @ S @ K.T
            P = 0.5 * (P + P.T)
            means.append(x)
            covariances.append(P)
    shape = len(case.mean), len(case.time)
    return np.reshape(means, (*shape, 9)), np.reshape(covariances, (*shape, 9, 9))


@pytest.fixture(scope="module")
def linear_recording():
    case = radar_case(batch=2, steps=80, seed=3)
    missing = np.isnan(case.measurement)
    z = np.random.default_rng(4).normal(size=missing.shape) * 50.0 + case.mean[:, None, 0::3]
    z[missing] = np.nan
    case = case._replace(measurement=z, noise=np.full_like(z, 30.0))
    H = np.zeros((3, 9))
    H[[0, 1, 1, 2], [0, 3, 4, 6]] = 1.0, 1.0, 0.5, 1.0
    return case, kalman(case, 2.0, H)


@pytest.mark.parametrize("name", DESIGNS)
def test_on_linear_models_every_design_is_the_kalman_filter(name, linear_recording):
    case, (means, covariances) = linear_recording
    tier = ReferenceFilter(constant_acceleration(2.0), position_sensor(), name)
    found = tier.history(case, case.knobs)
    sd = np.sqrt(np.diagonal(covariances, axis1=2, axis2=3))
    assert np.max(np.abs(found.mean - means) / sd) < 1e-9
    scale = sd[..., :, None] * sd[..., None, :]
    assert np.max(np.abs(found.covariance - covariances) / scale) < 1e-9


# -- which designs are one estimator ----------------------------------------------------


def test_joseph_is_the_symmetrised_classical_form():
    """SPEC 7.3 number 3, over whole runs of the extended filter; (I - K H) P as well."""
    classical, joseph, khp = histories("ekf-classical", "ekf-joseph", "ekf-khp")
    assert_same_filter(joseph, classical, 1e-10)
    assert_same_filter(khp, classical, 1e-10)
    updated = classical.covariance[~np.isnan(classical.nis)]
    np.testing.assert_array_equal(updated, transpose(updated))


def test_the_exact_forms_are_one_filter():
    names = ["classical", "joseph-exact"]
    for family in ("ukf", "ckf"):
        plain, *others = histories(
            *(f"{family}-{n}" for n in names), *(f"sr{family}-{n}" for n in names)
        )
        for other in others:
            assert_same_filter(other, plain, 1e-10)


@pytest.mark.parametrize("update", ["joseph", "joseph-prior"])
def test_square_root_and_covariance_joseph_are_one_estimator(update):
    """SPEC 7.3 number 4: states within 1e-6 m over a run that is not lost."""
    full, root = histories(f"ukf-{update}", f"srukf-{update}")
    assert np.max(np.abs(full.mean - root.mean)) < 1e-6
    assert_same_filter(root, full, 1e-8)


def test_the_extended_filter_has_a_square_root_form():
    forms = [FilterDesign("extended", "square-root", u) for u in ("classical", "joseph-exact")]
    plain, *roots = histories("ekf-classical", *forms)
    for root in roots:
        assert_same_filter(root, plain, 1e-10)


def test_cubature_is_unscented_with_kappa_zero():
    case = radar_case(batch=2, steps=50)
    for form in ("ukf-classical", "srukf-joseph-exact"):
        cubature = ReferenceFilter(*AIRCRAFT, form.replace("ukf", "ckf")).run(case, case.knobs)
        unscented_ = ReferenceFilter(*AIRCRAFT, form, kappa=0.0).run(case, case.knobs)
        np.testing.assert_array_equal(cubature.mean, unscented_.mean)


def test_printed_joseph_is_another_filter_and_depends_on_the_measurement():
    """SPEC F9, F10: eq 32 leaves out the linearisation error, and its H the prediction."""
    exact, prior, printed = histories("ukf-joseph-exact", "ukf-joseph-prior", "ukf-joseph")
    assert np.max(np.abs(printed.mean - exact.mean) / deviations(exact)) > 1e-3
    assert np.max(np.abs(prior.mean - exact.mean) / deviations(exact)) > 1e-3
    case = radar_case(batch=1, steps=1, missing=0.0)
    moved = case._replace(measurement=case.measurement + case.noise)
    for design, depends in (("ukf-joseph", True), ("ukf-joseph-prior", False),
                            ("ukf-joseph-exact", False), ("srukf-joseph", True)):  # fmt: skip
        here, there = (histories(design, case=c)[0].covariance for c in (case, moved))
        assert (not np.array_equal(here, there)) == depends


def test_condition_of_the_factor_is_the_root_of_the_covariances():
    """SPEC 7.3 number 3: kappa(S)^2 = kappa(P) within 1e-9; half the digits, no more knowledge."""
    full, root = histories("ukf-joseph-exact", "srukf-joseph-exact")
    ratio = np.linalg.cond(root.factor) ** 2 / np.linalg.cond(full.covariance)
    assert np.max(np.abs(ratio - 1.0)) < 1e-9


# -- one update against its definition --------------------------------------------------


def one_update(seed):
    """A random predicted radar state (mean, factor), measurement and its noise."""
    case = radar_case(batch=3, steps=1, missing=0.0, seed=seed)
    measure = StateFunction(
        radar().build(batch), radar().build(dual), np.array([1, 2]), np.zeros((3, 0))
    )
    return measure, case.mean, case.factor, case.measurement[:, 0], case.noise[:, 0]


@given(seed=st.integers(0, 10**6), kappa=st.sampled_from([0.0, 0.3, 1.0, 3.0]))
@settings(max_examples=40, deadline=None)
def test_sigma_point_joseph_is_p_minus_k_pzz_kt(seed, kappa):
    """SPEC 7.3 number 3: within 1e-12 of the prior's size, in both forms."""
    measure, mean, factor, z, sd = one_update(seed)
    design = FilterDesign("unscented", "square-root", "joseph-exact", kappa=kappa)
    found = square_root.correct(measure, mean, factor, z, sd, design)
    points = unscented(measure, mean, factor, sigma_weights(design, 9))
    Pzz = (points.values * points.weights) @ transpose(points.values)
    Pzz = Pzz + sd[:, :, None] ** 2 * np.eye(3)
    Pxz = (points.states * points.weights) @ transpose(points.values)
    K = transpose(np.linalg.solve(Pzz, transpose(Pxz)))
    P = factor @ transpose(factor)
    sizes = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    scale = sizes[:, :, None] * sizes[:, None, :]
    expected = P - K @ Pzz @ transpose(K)
    assert np.max(np.abs(found.spread @ transpose(found.spread) - expected) / scale) < 1e-12
    assert np.all(np.diagonal(found.spread, axis1=1, axis2=2) >= 0.0)
    np.testing.assert_array_equal(found.spread, np.tril(found.spread))
    sizes = np.sqrt(np.diagonal(Pzz, axis1=1, axis2=2))
    off = found.root @ transpose(found.root) - Pzz
    assert np.max(np.abs(off) / (sizes[:, :, None] * sizes[:, None, :])) < 1e-12
    full = FilterDesign("unscented", "covariance", "joseph-exact", kappa=kappa)
    spread = covariance.correct(measure, mean, P, z, sd, full).spread
    assert np.max(np.abs(spread - expected) / scale) < 1e-12


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_section_9_split_is_the_same_update(seed):
    """Odd and even parts of the deviations, as the engine computes them (SPEC 9)."""
    measure, mean, factor, z, sd = one_update(seed)
    design = find_design("srukf-joseph-exact")
    found = square_root.correct(measure, mean, factor, z, sd, design)
    points = unscented(measure, mean, factor, sigma_weights(design, 9))
    middle, plus, minus = np.split(points.values, [1, 10], axis=2)
    w, c = 1.0 / 20.0, np.sqrt(10.0)
    U = w * c * (plus - minus)
    E = np.concatenate([np.sqrt(w / 2.0) * (plus + minus), np.sqrt(0.1) * middle], axis=2)
    noise = sd[:, :, None] * np.eye(3)
    Re = tria(E, noise)
    C = tria(U, Re)
    K = transpose(np.linalg.solve(C @ transpose(C), U @ transpose(factor)))
    S = tria(factor - K @ U, K @ Re)
    size = np.sqrt(np.sum(factor**2, axis=2))[:, :, None]
    assert np.max(np.abs(found.spread - S) / size) < 1e-12


def test_rounding_grows_only_in_the_unsymmetrised_form():
    """SPEC 2.3: an antisymmetric part of P grows under P - K Pzz K^T, and under no other form."""
    rng = np.random.default_rng(0)
    steps, dt = 300, 0.5
    step = StateFunction(
        *(constant_acceleration().build(xp).step for xp in (batch, dual)), np.array([], int),
        np.zeros((1, 0)), np.array([dt]),
    )  # fmt: skip
    measure = StateFunction(
        radar().build(batch), radar().build(dual), np.array([1, 2]), np.zeros((1, 0))
    )
    noise = np.kron(np.eye(3), np.linalg.cholesky(white_jerk(dt)))[None]
    sd, one = np.array([[30.0, 0.025, 0.087]]), np.ones(1)
    left = {}
    for name in ("ekf-unsymmetrised", "ekf-khp", "ekf-joseph"):
        mean = np.array([[-6e3, 120.0, 0.0, 3e3, 0.0, 0.0, 1e3, 0.0, 0.0]])
        deviation = np.array([300.0, 30.0, 3.0] * 3)
        skew = rng.normal(size=(9, 9))
        P = np.diag(deviation**2) + 1e-6 * np.outer(deviation, deviation) * (skew - skew.T)
        P = P[None]
        for _ in range(steps):
            mean, P = covariance.propagate(step, mean, P, DESIGNS[name])
            P = covariance.add_noise(P, noise, one, one)
            z = measure.values(mean[:, :, None])[:, :, 0]
            P = covariance.correct(measure, mean, P, z, sd, DESIGNS[name]).spread
        sizes = np.sqrt(np.abs(np.diagonal(P[0])))
        left[name] = np.max(np.abs(P[0] - P[0].T) / np.outer(sizes, sizes))
    assert left["ekf-unsymmetrised"] > 1e-3
    assert left["ekf-khp"] < 1e-9 and left["ekf-joseph"] < 1e-9


# -- missing channels -----------------------------------------------------------------


def without(sensor, kept):
    """The sensor with some of its channels only."""

    def build(xp):
        whole = sensor.build(xp)
        return lambda x, s: tuple(whole(x, s)[c] for c in kept)

    return Sensor("part", tuple(sensor.channels[c] for c in kept), build, sensor.inputs)


@given(
    name=st.sampled_from(sorted(DESIGNS)), seed=st.integers(0, 10**6),
    kept=st.sets(st.integers(0, 3), min_size=1, max_size=3),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_missing_channel_is_a_sensor_without_it(name, seed, kept):
    motion, sensor, _ = PAIRS["robot, beacon"]
    case, kept = robot_case(batch=2, steps=4, missing=0.0, seed=seed), sorted(kept)
    gone = [c for c in range(4) if c not in kept]
    z = case.measurement.copy()
    z[:, :, gone] = np.nan
    whole = ReferenceFilter(motion, sensor, name).history(case._replace(measurement=z), case.knobs)
    less = case._replace(measurement=case.measurement[:, :, kept], noise=case.noise[:, :, kept])
    part = ReferenceFilter(motion, without(sensor, kept), name).history(less, less.knobs)
    np.testing.assert_array_equal(whole.status, part.status)
    np.testing.assert_allclose(whole.mean, part.mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(whole.covariance, part.covariance, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(whole.nis, part.nis, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["engine", "srukf-joseph-exact", "ukf-joseph", "ekf-classical"])
def test_what_is_said_of_a_missing_channel_changes_no_bit(name):
    case = radar_case(batch=3, steps=100, missing=0.4)
    tier = Engine(*AIRCRAFT) if name == "engine" else ReferenceFilter(*AIRCRAFT, name)
    lies = np.random.default_rng(0).choice([np.nan, np.inf, 0.0, 1e9], size=case.noise.shape)
    noise = np.where(np.isnan(case.measurement), lies, case.noise)
    other = tier.run(case._replace(noise=noise), case.knobs)
    np.testing.assert_array_equal(other.mean, tier.run(case, case.knobs).mean)
    assert not other.status.any()


@pytest.mark.parametrize("name", ["engine", "srukf-joseph-exact", "ukf-classical"])
def test_without_any_measurement_the_filter_only_predicts(name):
    case = radar_case(batch=2, steps=30, missing=1.0)
    tier = Engine(*AIRCRAFT) if name == "engine" else ReferenceFilter(*AIRCRAFT, name)
    run = tier.run(case, case.knobs)
    assert np.isnan(run.nis).all() and not run.status.any()
    np.testing.assert_array_equal(run.mean[:, 0], case.mean)
    assert np.isfinite(run.mean).all()


# -- names and choices ------------------------------------------------------------------


def test_a_misspelt_design_is_told_the_close_ones():
    with pytest.raises(ValueError, match=r"Did you mean .*srukf-joseph"):
        ReferenceFilter(*AIRCRAFT, "srukf-josef")
    with pytest.raises(ValueError, match=r"Unknown filter design 'zzz'"):
        find_design("zzz")


@pytest.mark.parametrize(
    ("choice", "culprit"),
    [
        ({"transform": "unsented"}, "transform"),
        ({"form": "cholesky"}, "form"),
        ({"update": "khp"}, "khp"),
        ({"update": "symmetrised"}, "update"),
        ({"transform": "extended", "update": "joseph-exact"}, "joseph-prior"),
        ({"form": "square-root", "update": "unsymmetrised"}, "update"),
        ({"transform": "cubature", "kappa": 2.0}, "kappa"),
        ({"kappa": float("nan")}, "kappa"),
        ({"alpha": 0.0}, "alpha"),
    ],
)
def test_a_design_that_does_not_exist_is_refused(choice, culprit):
    parts = {"transform": "unscented", "form": "covariance", "update": "classical"} | choice
    with pytest.raises(ValueError, match=culprit):
        FilterDesign(**parts)


def test_weights_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match=r"negative.*no square root"):
        ReferenceFilter(*AIRCRAFT, "srukf-joseph-exact", kappa=-6.0)
    with pytest.raises(ValueError, match="kappa"):
        ReferenceFilter(*AIRCRAFT, "ukf-classical", kappa=-9.0)
    with pytest.raises(ValueError, match="kappa"):
        ReferenceFilter(*AIRCRAFT, "ekf-joseph", kappa=3.0)
    with pytest.raises(ValueError, match="kappa"):
        Engine(*AIRCRAFT, kappa=-1.0)


def test_covariance_designs_do_not_pass_their_covariance_for_a_factor():
    case = radar_case(batch=2, steps=2)
    tier = ReferenceFilter(*AIRCRAFT, "ukf-classical")
    with pytest.raises(TypeError, match="carries covariances"):
        inputs = case.motion_inputs[:, 0]
        tier.predict(case.mean, case.factor, inputs, np.ones(2), np.zeros(2, np.int64))


@pytest.mark.parametrize("name", DESIGNS)
def test_every_design_pickles(name):
    case = radar_case(batch=1, steps=5)
    tier = ReferenceFilter(*AIRCRAFT, name)
    again = pickle.loads(pickle.dumps(tier))
    np.testing.assert_array_equal(again.run(case, case.knobs).mean, tier.run(case, case.knobs).mean)


def test_the_linearised_ensemble_carries_the_covariance():
    measure, mean, factor, _, _ = one_update(0)
    found = extended(measure, mean, factor)
    H = measure.jacobian(mean)
    P = factor @ transpose(factor)
    np.testing.assert_allclose(
        found.values @ transpose(found.values), H @ P @ transpose(H), rtol=1e-12
    )
