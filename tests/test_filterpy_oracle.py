"""The reference filters against FilterPy, an independent library (about 15 s).

Where the algorithms agree, means and covariances agree within 1e-9 of a deviation. FilterPy
differs from the family in the following, each shown by a test or met without touching what
is compared:
* Sigma points. Its unscented filter of release 1.4.5 and its cubature filter of every release
  measure the propagated points, which know nothing of the process noise (SPEC F4); its
  unscented filter of release 2.0 redraws them after the prediction, as we do. The oracle
  redraws with FilterPy's own points.
* Angles. It averages and subtracts them as numbers, so that the recordings keep away from the
  cut at 180 deg, unless it is given functions that know better.
* Sums. Its cubature filter takes covariances as sum X X^T - x x^T, which loses its digits far
  from the origin (SPEC F15).
* Form. Its unscented and cubature filters leave P - K S K^T unsymmetrised; that does no harm
  to sigma points, since P is rebuilt from them at every step. Its linear and extended filters
  use the Joseph form.
* Missing measurements. It takes all channels of an instant or none.
"""

import numpy as np
import pytest
from pairs import Case, drawn_case, position_sensor, radar_case, wrap

from kfenv.filters.designs import FilterDesign
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.namespaces import batch, scalar
from kfenv.models.process_noise import white_jerk
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

filterpy = pytest.importorskip("filterpy.kalman")

DT, STEPS = 0.2, 100
TOLERANCE = 1e-9  # of a deviation; of the deviations' product for covariances
H = np.zeros((3, 9))  # of the linear sensor
H[[0, 1, 1, 2], [0, 3, 4, 6]] = 1.0, 1.0, 0.5, 1.0


@pytest.fixture(scope="module")
def case() -> Case:
    """One aircraft off the cut, knobs at one; every seventh measurement is missing."""
    case = radar_case(batch=1, steps=STEPS, missing=0.0, dt=DT, seed=5)
    assert np.abs(case.measurement[:, :, 1]).max() < 3.1
    case.measurement[:, 5::7] = np.nan
    return case


def linear_case(q=2.0) -> Case:
    sd, deviation = np.full((1, STEPS, 3), 20.0), np.array([300.0, 30.0, 3.0] * 3)
    start = np.array([-6e3, 120.0, 0.0, 3e3, 30.0, 0.0, 1e3, 0.0, 0.0])
    sd[:, 5::7] = np.nan
    models = constant_acceleration(q), position_sensor()
    return drawn_case(*models, start, np.diag(deviation), sd, DT)[1]


def measure(x):
    return np.array(radar().build(scalar)(tuple(x), ()))


def process_noise(motion, x):
    L = np.zeros((9, 9))
    entries = motion.build(scalar).noise_factor(tuple(x), (), DT)
    for (row, column), entry in zip(motion.noise_pattern, entries, strict=True):
        L[row, column] = entry
    return L @ L.T


def differences(oracle, design, models, case):
    """Largest differences of mean and covariance from the oracle's (x, P) of every time."""
    found, worst = ReferenceFilter(*models, design).history(case, case.knobs), np.zeros(2)
    for t, (x, P) in enumerate(oracle):
        sd = np.sqrt(np.diag(P))
        off = np.abs(found.mean[0, t] - x) / sd
        spread = np.abs(found.covariance[0, t] - P) / np.outer(sd, sd)
        worst = np.maximum(worst, [off.max(), spread.max()])
    return worst


def assert_equal_to(oracle, design, motion, case, sensor=None):
    models = motion, sensor or radar()
    assert np.all(differences(oracle, design, models, case) < TOLERANCE)


def run(filter_, redraw, motion, case):
    """Yield FilterPy's posterior of every time; the first is an update only."""
    filter_.x, filter_.P = case.mean[0].copy(), case.factor[0] @ case.factor[0].T
    for t in range(STEPS):
        if t > 0:
            filter_.Q = process_noise(motion, np.ravel(filter_.x))
            filter_.predict()
        redraw(filter_, t)
        z = None if np.isnan(case.measurement[0, t]).any() else case.measurement[0, t]
        filter_.update(z, R=np.diag(case.noise[0, t] ** 2))
        yield np.ravel(filter_.x), filter_.P


# -- unscented ----------------------------------------------------------------------------


def unscented(points, motion, case, **angles):
    step = motion.build(scalar).step
    filter_ = filterpy.UnscentedKalmanFilter(
        9, 3, DT, measure, lambda x, dt: np.array(step(tuple(x), (), dt)), points, **angles
    )

    def redraw(filter_, t):
        filter_.sigmas_f = points.sigma_points(filter_.x, filter_.P)

    return run(filter_, redraw, motion, case)


MOTIONS = [constant_acceleration(2.0), variable_turn(2.0)]
each_motion = pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.name)


@each_motion
@pytest.mark.parametrize("kappa", [-6.0, 0.0, 1.0, 3.0])
def test_unscented(kappa, motion, case):
    case = case._replace(factor=0.5 * case.factor)  # a negative weight bears no wider prior
    design = FilterDesign("unscented", "covariance", "classical", kappa=kappa)
    points = filterpy.JulierSigmaPoints(9, kappa)
    assert_equal_to(unscented(points, motion, case), design, motion, case)
    if kappa >= 0.0:
        root = FilterDesign("unscented", "square-root", "joseph-exact", kappa=kappa)
        assert_equal_to(unscented(points, motion, case), root, motion, case)


@pytest.mark.parametrize(("alpha", "beta", "kappa"), [(0.5, 2.0, 1.0), (1.2, 0.5, -2.0)])
def test_scaled_unscented(alpha, beta, kappa, case):
    motion = MOTIONS[0]
    points = filterpy.MerweScaledSigmaPoints(9, alpha, beta, kappa)
    design = FilterDesign("unscented", "covariance", "classical", kappa, alpha, beta)
    assert_equal_to(unscented(points, motion, case), design, motion, case)


def test_across_the_cut_filterpy_must_be_told_of_angles():
    motion, points = MOTIONS[0], filterpy.JulierSigmaPoints(9, 1.0)
    south = np.array([-1e3, 120.0, 0.0, -5e3, 0.0, 0.0, 1.5e3, 0.0, 0.0])
    sd, spread = np.tile([20.0, 0.02, 0.02], (1, STEPS, 1)), np.diag([200.0, 20.0, 1.0] * 3)
    case = drawn_case(motion, radar(), south, spread, sd, DT)[1]
    assert case.measurement[0, :, 1].min() < -3.0 and case.measurement[0, :, 1].max() > 3.0

    def difference(a, b):
        off = np.subtract(a, b)
        return np.array([off[0], wrap(off[1]), wrap(off[2])])

    def mean(sigmas, weights):
        return sigmas[0] + weights @ np.array([difference(point, sigmas[0]) for point in sigmas])

    told = unscented(points, motion, case, z_mean_fn=mean, residual_z=difference)
    assert_equal_to(told, "ukf-classical", motion, case)
    untold = unscented(points, motion, case)
    assert differences(untold, "ukf-classical", (motion, radar()), case)[0] > 1.0


# -- cubature -----------------------------------------------------------------------------


def cubature(motion, case, measure=measure, redrawn=True):
    from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas

    step = motion.build(scalar).step
    filter_ = filterpy.CubatureKalmanFilter(
        9, 3, DT, measure, lambda x, dt: np.array(step(tuple(x), (), dt))
    )

    def redraw(filter_, t):
        filter_.x = filter_.x.reshape(9, 1)
        if redrawn or t == 0:
            filter_.sigmas_f = spherical_radial_sigmas(filter_.x, filter_.P)

    def update(z, R, plain=filter_.update):
        plain(z if z is None else z.reshape(3, 1), R)

    filter_.update = update
    return run(filter_, redraw, motion, case)


@pytest.mark.parametrize("design", ["ckf-classical", "srckf-joseph-exact"])
@each_motion
def test_cubature(design, motion, case):
    assert_equal_to(cubature(motion, case), design, motion, case)


def test_cubature_on_linear_models():
    motion, case = MOTIONS[0], linear_case()
    oracle = cubature(motion, case, lambda x: H @ x)
    assert_equal_to(oracle, "ckf-classical", motion, case, position_sensor())


@pytest.mark.parametrize(("q", "same"), [(1e-10, True), (2.0, False)])
def test_points_that_are_not_redrawn_know_nothing_of_the_process_noise(q, same):
    """SPEC F4: on linear models it is all that is wrong with them."""
    motion, case = constant_acceleration(q), linear_case(q)
    models, plain = (motion, position_sensor()), lambda x: H @ x
    oracle = cubature(motion, case, plain, redrawn=False)
    literal = differences(oracle, "ckf-classical", models, case)
    assert np.all(literal < 1e-7) if same else np.all(literal > 1e-4)


def test_uncentred_sums_lose_their_digits_far_from_the_origin():
    """SPEC F15: the filter does not depend on where its linear sensor stands."""
    motion, here = MOTIONS[0], linear_case()
    far = np.array([6.4e6, 0.0, 0.0] * 3)
    there = here._replace(mean=here.mean + far, measurement=here.measurement + H @ far)
    tier = ReferenceFilter(motion, position_sensor(), "ckf-classical")
    covariance = [tier.history(c, c.knobs).covariance[0] for c in (here, there)]
    theirs = [P for _, P in cubature(motion, there, lambda x: H @ x)]
    sd = np.sqrt(np.diagonal(covariance[0], axis1=1, axis2=2))
    scale = sd[:, :, None] * sd[:, None, :]
    assert np.max(np.abs(covariance[1] - covariance[0]) / scale) < 1e-9
    assert np.max(np.abs(theirs - covariance[0]) / scale) > 1e-4


# -- linear and extended --------------------------------------------------------------------


@pytest.mark.parametrize("design", ["lkf", "ekf-joseph", "ukf-joseph-exact", "srckf-classical"])
def test_linear(design):
    """FilterPy's Kalman filter in the Joseph form, with the matrices of the textbook."""
    case, filter_ = linear_case(), filterpy.KalmanFilter(9, 3)
    filter_.x, filter_.P = case.mean[0].copy(), case.factor[0] @ case.factor[0].T
    F1 = [[1.0, DT, DT**2 / 2.0], [0.0, 1.0, DT], [0.0, 0.0, 1.0]]
    filter_.F, filter_.Q = np.kron(np.eye(3), F1), np.kron(np.eye(3), 2.0 * white_jerk(DT))
    filter_.H, filter_.R = H, 400.0 * np.eye(3)

    def oracle():
        for t, z in enumerate(case.measurement[0]):
            if t > 0:
                filter_.predict()
            filter_.update(None if np.isnan(z).any() else z)
            yield filter_.x, filter_.P

    assert_equal_to(oracle(), design, MOTIONS[0], case, position_sensor())


def radar_slopes(x):
    """Jacobian of SPEC 4.1, by hand."""
    px, py, pz = np.ravel(x)[::3]
    ground2 = px**2 + py**2
    r2, ground = ground2 + pz**2, np.sqrt(ground2)
    slopes = np.zeros((3, 9))
    slopes[0, 0::3] = np.array([px, py, pz]) / np.sqrt(r2)
    slopes[1, [0, 3]] = py / ground2, -px / ground2
    slopes[2, 0::3] = -px * pz / (r2 * ground), -py * pz / (r2 * ground), ground / r2
    return slopes


def transition(motion, x):
    """Jacobian of the step by complex differences, which round nothing off."""
    points = x[:, None] + 1e-30j * np.eye(9)
    return (
        np.array(np.broadcast_arrays(*motion.build(batch).step(tuple(points), (), DT))).imag / 1e-30
    )


@pytest.mark.parametrize("design", ["ekf-joseph", "ekf-classical", "ekf-khp"])
@each_motion
def test_extended(design, motion, case):
    """FilterPy corrects in the Joseph form; its linear prediction is given the model's step."""
    step, filter_ = motion.build(scalar).step, filterpy.ExtendedKalmanFilter(9, 3)
    filter_.x, filter_.P = case.mean[0].reshape(9, 1), case.factor[0] @ case.factor[0].T

    def predict_x(u=0):
        filter_.x = np.reshape(step(tuple(filter_.x[:, 0]), (), DT), (9, 1))

    filter_.predict_x = predict_x

    def oracle():
        for t, z in enumerate(case.measurement[0]):
            if t > 0:
                x = filter_.x[:, 0]
                filter_.F, filter_.Q = transition(motion, x), process_noise(motion, x)
                filter_.predict()
            filter_.update(
                None if np.isnan(z).any() else z.reshape(3, 1), radar_slopes,
                lambda x: measure(x[:, 0]).reshape(3, 1), R=np.diag(case.noise[0, t] ** 2),
            )  # fmt: skip
            yield filter_.x[:, 0], filter_.P

    assert_equal_to(oracle(), design, motion, case)
