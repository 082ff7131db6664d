"""The reference filters against FilterPy, an independent library.

FilterPy differs from the family in two ways, both met here without touching what is compared:
* Its unscented filter of release 1.4.5 measures the propagated points, which know nothing of
  the process noise (SPEC F4); release 2.0 redraws them, as we do. Its cubature filter never
  redraws. The oracle redraws after every prediction with FilterPy's own points.
* It averages angles as numbers, so that the recording must keep away from the cut at 180 deg.
"""

import numpy as np
import pytest
from pairs import Case, radar_case

from kfenv.filters.designs import FilterDesign
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.namespaces import scalar
from kfenv.models.process_noise import white_jerk
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

filterpy = pytest.importorskip("filterpy.kalman")

DT, STEPS = 0.2, 100
TOLERANCE = 1e-9  # of a deviation; of the deviations' product for covariances


@pytest.fixture(scope="module")
def case() -> Case:
    """One aircraft, all channels, off the cut; knobs at one."""
    case = radar_case(batch=1, steps=STEPS, missing=0.0, dt=DT, seed=5)
    assert np.abs(case.z[:, :, 1]).max() < 3.1
    return case


def measure(x):
    return np.array(radar().build(scalar)(tuple(x), ()))


def process_noise(motion, x):
    L = np.zeros((9, 9))
    entries = motion.build(scalar).noise_factor(tuple(x), (), DT)
    for (row, column), entry in zip(motion.noise_pattern, entries, strict=True):
        L[row, column] = entry
    return L @ L.T


def assert_equal_to(oracle, design, motion, case):
    """The posterior of every time against the oracle's (x, P)."""
    found = ReferenceFilter(motion, radar(), design).history(*case)
    for t, (x, P) in enumerate(oracle):
        sd = np.sqrt(np.diag(P))
        assert np.max(np.abs(found.mean[0, t] - x) / sd) < TOLERANCE
        assert np.max(np.abs(found.covariance[0, t] - P) / np.outer(sd, sd)) < TOLERANCE


def run(filter_, redraw, motion, case):
    """Yield FilterPy's posterior of every time; the first is an update only."""
    filter_.x, filter_.P = case.mean[0].copy(), case.factor[0] @ case.factor[0].T
    for t in range(STEPS):
        if t > 0:
            filter_.Q = process_noise(motion, np.ravel(filter_.x))
            filter_.predict()
        redraw(filter_)
        filter_.update(case.z[0, t], R=np.diag(case.sd[0, t] ** 2))
        yield np.ravel(filter_.x), filter_.P


def unscented(points, motion, case):
    step = motion.build(scalar).step
    filter_ = filterpy.UnscentedKalmanFilter(
        9, 3, DT, measure, lambda x, dt: np.array(step(tuple(x), (), dt)), points
    )

    def redraw(filter_):
        filter_.sigmas_f = points.sigma_points(filter_.x, filter_.P)

    return run(filter_, redraw, motion, case)


MOTIONS = [constant_acceleration(2.0), variable_turn(2.0)]


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.name)
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


@pytest.mark.parametrize("design", ["ckf-classical", "srckf-joseph-exact"])
@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.name)
def test_cubature(design, motion, case):
    from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas

    step = motion.build(scalar).step
    filter_ = filterpy.CubatureKalmanFilter(
        9, 3, DT, measure, lambda x, dt: np.array(step(tuple(x), (), dt))
    )

    def redraw(filter_):
        filter_.x = filter_.x.reshape(9, 1)
        filter_.sigmas_f = spherical_radial_sigmas(filter_.x, filter_.P)

    def update(z, R, plain=filter_.update):
        plain(z.reshape(3, 1), R)

    filter_.update = update
    assert_equal_to(run(filter_, redraw, motion, case), design, motion, case)


@pytest.mark.parametrize("design", ["ekf-joseph", "ekf-classical", "ekf-khp"])
def test_extended(design, case):
    """FilterPy predicts linearly and corrects in the Joseph form; Jacobian of SPEC 4.1."""

    def jacobian(x):
        px, py, pz = x[0, 0], x[3, 0], x[6, 0]
        ground2 = px**2 + py**2
        r2, ground = ground2 + pz**2, np.sqrt(ground2)
        H = np.zeros((3, 9))
        H[0, 0::3] = np.array([px, py, pz]) / np.sqrt(r2)
        H[1, [0, 3]] = py / ground2, -px / ground2
        H[2, 0::3] = -px * pz / (r2 * ground), -py * pz / (r2 * ground), ground / r2
        return H

    filter_ = filterpy.ExtendedKalmanFilter(9, 3)
    filter_.x, filter_.P = case.mean[0].reshape(9, 1), case.factor[0] @ case.factor[0].T
    F1 = [[1.0, DT, DT**2 / 2.0], [0.0, 1.0, DT], [0.0, 0.0, 1.0]]
    filter_.F, filter_.Q = np.kron(np.eye(3), F1), np.kron(np.eye(3), 2.0 * white_jerk(DT))

    def oracle():
        for t in range(STEPS):
            if t > 0:
                filter_.predict()
            filter_.update(
                case.z[0, t].reshape(3, 1), jacobian, lambda x: measure(x[:, 0]).reshape(3, 1),
                R=np.diag(case.sd[0, t] ** 2),
            )  # fmt: skip
            yield filter_.x[:, 0], filter_.P

    assert_equal_to(oracle(), design, MOTIONS[0], case)
