"""Bistatic tracking is a linear problem, and so has an answer: the Kalman filter's.

The published set-up (SPEC 7.1 E5, C13) is simulated as the environment draws it.
"""

import gymnasium as gym
import numpy as np
import pytest
from pairs import PAIRS, Case, position_case
from rollouts import BISTATIC

from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.process_noise import white_jerk

MOTION, SENSOR, _ = PAIRS["constant acceleration, position"]
DT, TOLERANCE = 0.5, 1e-9
RUNS, SETTLED = 2000, 10  # runs; steps after which the covariance is at its steady state
POSITION, VELOCITY = slice(0, 9, 3), slice(1, 9, 3)
F = np.kron(np.eye(3), [[1.0, DT, DT**2 / 2.0], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
Q = np.kron(np.eye(3), 0.2 * white_jerk(DT))
H = np.eye(9)[POSITION]
R = np.diag([10.0, 8.0, 5.0])


@pytest.fixture(scope="module")
def case() -> Case:
    """With whole and partial gaps; the knobs at one."""
    case = position_case(batch=3)
    return case._replace(knobs=Knobs.nominal(3))


def test_the_engine_is_the_kalman_filter(case):
    """Without a Jacobian, and from sigma points: the same means."""
    kalman = ReferenceFilter(MOTION, SENSOR, "lkf").history(case, case.knobs)
    engine = Engine(MOTION, SENSOR).run(case, case.knobs)
    assert not kalman.status.any() and not engine.status.any()
    deviation = np.sqrt(np.diagonal(kalman.covariance, axis1=2, axis2=3))
    assert np.max(np.abs(engine.mean - kalman.mean) / deviation) < TOLERANCE
    np.testing.assert_allclose(engine.nis, kalman.nis, rtol=TOLERANCE)


@pytest.mark.parametrize("design", ["lkf", "ekf-joseph", "srukf-joseph-exact"])
def test_every_form_is_filterpys_kalman_filter(design, case):
    kalman = pytest.importorskip("filterpy.kalman").KalmanFilter(9, 3)
    kalman.F, kalman.Q, kalman.H = F, Q, H
    found = ReferenceFilter(MOTION, SENSOR, design).history(case, case.knobs)
    for b in range(3):
        kalman.x, kalman.P = case.mean[b].reshape(9, 1), case.factor[b] @ case.factor[b].T
        for t in range(len(case.time)):
            if t > 0:
                kalman.predict()
            here = ~np.isnan(case.measurement[b, t])
            if here.any():
                R_t = np.diag(case.noise[b, t, here] ** 2)
                kalman.dim_z = here.sum()  # FilterPy 1.4 asks for as many
                kalman.update(case.measurement[b, t, here].reshape(-1, 1), R=R_t, H=H[here])
            sd = np.sqrt(np.diag(kalman.P))
            assert np.max(np.abs(found.mean[b, t] - kalman.x[:, 0]) / sd) < TOLERANCE
            error = np.abs(found.covariance[b, t] - kalman.P) / np.outer(sd, sd)
            assert np.max(error) < TOLERANCE


# ----- the published set-up -------------------------------------------------------------


@pytest.fixture(scope="module")
def published():
    """Its recordings, and the Kalman filter's run over them."""
    scenario = gym.make(BISTATIC, faults="paper").unwrapped.scenario
    recording = scenario.sample(np.random.default_rng(0).spawn(RUNS))
    return recording, ReferenceFilter(scenario.motion, scenario.sensor, "lkf").history(recording)


def test_the_published_case_is_drawn_as_published(published):
    recording, _ = published
    assert recording.faults == ((),) * RUNS
    assert not recording.mean.any() and not recording.truth[:, 0].any()
    covariance = recording.factor[0] @ recording.factor[0].T
    np.testing.assert_allclose(covariance, np.diag([0.1, 0.1, 0.5] * 3), atol=1e-15)
    np.testing.assert_array_equal(np.diff(recording.time), np.full(49, DT))  # 50 steps
    np.testing.assert_allclose(recording.noise**2, np.broadcast_to(np.diag(R), (RUNS, 50, 3)))
    noise = recording.measurement - recording.truth[..., POSITION]
    np.testing.assert_allclose(
        np.sqrt(np.mean(noise**2, axis=(0, 1))), [3.16, 2.83, 2.24], rtol=0.01
    )
    jumps = recording.truth[:, 1:] - recording.truth[:, :-1] @ F.T
    drawn = np.einsum("btk,btl->kl", jumps, jumps) / jumps[..., 0].size
    deviation = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(drawn / np.outer(deviation, deviation),
                               Q / np.outer(deviation, deviation), atol=0.02)  # fmt: skip


def test_the_published_case_converges_as_claimed(published):
    """SPEC C13: RMSE of the settled filter, and NEES of 9 degrees of freedom."""
    recording, run = published
    error = (run.mean - recording.truth)[:, SETTLED:]
    rmse = np.sqrt(np.mean(error**2, axis=(0, 1)))
    np.testing.assert_allclose(rmse[POSITION], [2.09, 1.89, 1.55], rtol=0.03)
    np.testing.assert_allclose(rmse[VELOCITY], [1.56, 1.46, 1.31], rtol=0.03)
    np.testing.assert_allclose(
        rmse, np.sqrt(np.diag(run.covariance[0, SETTLED:].mean(axis=0))), rtol=0.03
    )
    nees = np.einsum(
        "bk,bk->b",
        error[:, -1],
        np.linalg.solve(run.covariance[:, -1], error[:, -1, :, None])[..., 0],
    )
    assert abs(nees.mean() - 9.0) < 4.0 * np.sqrt(18.0 / RUNS)


def test_other_episodes_begin_with_an_estimate_about_the_truth():
    scenario = gym.make(BISTATIC, faults="none").unwrapped.scenario
    recording = scenario.sample(np.random.default_rng(1).spawn(1000))
    off = recording.mean - recording.truth[:, 0]
    np.testing.assert_allclose(np.std(off, axis=0) ** 2, [0.1, 0.1, 0.5] * 3, rtol=0.15)
    assert recording.time[-1] == 60.0
