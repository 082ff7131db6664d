"""Printed equations that fail, beside the right ones (SPEC 2.1); those of the noise elsewhere."""

import numpy as np
import pytest

from kfenv.filters.designs import find_design
from kfenv.filters.matrices import tria
from kfenv.filters.transforms import sigma_weights

rng = np.random.default_rng(7)
N, M = 4, 2
F = np.eye(N) + 0.4 * rng.normal(size=(N, N))
H = rng.normal(size=(M, N))
X0, S0 = 5.0 * rng.normal(size=N), np.tril(rng.normal(size=(N, N))) + 2.0 * np.eye(N)
Q = np.diag([0.5, 1.0, 2.0, 0.7])
MEAN, P = F @ X0, F @ S0 @ S0.T @ F.T + Q  # the prediction of the Kalman filter
WEIGHTS = sigma_weights(find_design("srukf-joseph-exact"), N)


def points(mean, factor):
    """Sigma points as columns, (N, 2N+1)."""
    offsets = WEIGHTS.spread * np.hstack([np.zeros((N, 1)), factor, -factor])
    return mean[:, None] + offsets


def weighted(A, B):
    return (A * WEIGHTS.covariance) @ B.T


def relative_error(found, right):
    return np.linalg.norm(found - right) / np.linalg.norm(right)


OLD = points(X0, S0)
REDRAWN = points(MEAN, np.linalg.cholesky(P))
Z = H @ REDRAWN - (H @ MEAN)[:, None]


def test_f3_the_cross_covariance_applies_f_once():
    right = weighted(REDRAWN - MEAN[:, None], Z)
    assert relative_error(right, P @ H.T) < 1e-14
    as_printed = weighted(F @ REDRAWN - MEAN[:, None], Z)
    assert relative_error(as_printed, P @ H.T) > 0.1


def test_f4_propagated_points_do_not_pair_with_redrawn_ones():
    as_printed = weighted(F @ OLD - MEAN[:, None], Z)
    assert relative_error(as_printed, P @ H.T) > 0.1


def test_f5_the_predicted_factor_takes_the_propagated_points():
    root_q = np.sqrt(Q)
    w = np.sqrt(WEIGHTS.covariance)
    right = tria((w * (F @ OLD - MEAN[:, None]))[None], root_q[None])[0]
    assert relative_error(right @ right.T, P) < 1e-14
    as_printed = tria((w * (OLD - MEAN[:, None]))[None], root_q[None])[0]
    assert np.trace(as_printed @ as_printed.T) > 1.2 * np.trace(P)


def test_f6_the_central_column_enters_by_its_root_weight():
    """A deviation d0 of weight w0 is the column sqrt(w0) d0; bare, it counts 1/w0 times."""
    d0, w0 = np.array([1.0, 2.0, 0.5, -1.0]), 0.1
    right = tria(S0[None], (np.sqrt(w0) * d0)[None, :, None])[0]
    assert relative_error(right @ right.T, S0 @ S0.T + w0 * np.outer(d0, d0)) < 1e-14
    as_printed = tria(S0[None], d0[None, :, None])[0]
    assert relative_error(as_printed @ as_printed.T, S0 @ S0.T + w0 * np.outer(d0, d0)) > 0.05


def test_f8_the_factor_is_the_transposed_r():
    """S0 eq 32: R^T R is the Joseph form; R taken as a lower factor is not."""
    S, R = np.linalg.cholesky(P), np.diag([0.3, 0.8])
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    G = np.eye(N) - K @ H
    joseph = G @ P @ G.T + K @ R @ K.T
    upper = np.linalg.qr(np.vstack([S.T @ G.T, np.sqrt(R) @ K.T]), mode="r")
    assert relative_error(upper.T @ upper, joseph) < 1e-13
    assert relative_error(upper @ upper.T, joseph) > 0.1
    assert relative_error(joseph, P - K @ (H @ P @ H.T + R) @ K.T) < 1e-12


@pytest.mark.parametrize(("state", "error"), [(1e3, 1e-8), (1e5, 2e-5), (6.4e6, 0.22)])
def test_f15_uncentred_sums_lose_a_variance_of_one(state, error):
    """S4 eq 27: sum w X X^T - m m^T, to within a factor of thirty of the quoted loss."""
    spread = np.sqrt(10.0)
    w = np.array([0.1] + 18 * [0.05])
    losses, centred = [], []
    for shift in np.linspace(0.0, 1.0, 50):
        x = state + shift + np.concatenate([[0.0], spread * np.eye(9)[0], -spread * np.eye(9)[0]])
        mean = w @ x
        losses.append(abs(w @ (x * x) - mean * mean - 1.0))
        centred.append(abs(w @ (x - mean) ** 2 - 1.0))
    assert error / 30.0 < max(losses) < error * 30.0
    assert max(centred) < 1e-8
