"""Every process noise is a covariance and the right one; the printed ones are not."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kfenv.models import process_noise as noise
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.namespaces import scalar
from kfenv.models.variable_turn import variable_turn

GRID = [(0.3, 0.7, 1.0), (0.05, 0.2, 0.5), (-0.2, 0.4, 1.0), (0.5, 0.1, 2.0), (1.0, 1.0, 3.0)]
INTERVALS = (0.02, 0.1, 0.5, 1.0, 2.0)


def correlations(Q):
    deviation = np.sqrt(np.diag(Q))
    return Q / np.outer(deviation, deviation)


def assert_same_covariance(Q, expected, tolerance):
    deviation = np.sqrt(np.diag(expected))
    assert np.max(np.abs(Q - expected) / np.outer(deviation, deviation)) < tolerance


def covariance_of(motion, x, dt):
    """L L^T of a motion model's noise factor."""
    L = np.zeros((9, 9))
    for (row, column), entry in zip(
        motion.noise_pattern, motion.build(scalar).noise_factor(x, (), dt), strict=True
    ):
        L[row, column] = entry
    return L @ L.T


def turning_state(alpha, omega_c, speed=150.0):
    """A state with this damping and turn rate, |omega_c| >= |alpha|, in no special direction."""
    along = np.array([0.6, 0.64, 0.48])
    across = np.array([-0.8, 0.48, 0.36])
    v = speed * along
    a = speed * (-alpha * along + np.sqrt(omega_c**2 - alpha**2) * across)
    x = np.zeros(9)
    x[1::3], x[2::3] = v, a
    return tuple(x)


def test_the_oracle_of_the_variable_turn_noise():
    Q = noise.variable_turn(0.3, 0.7, 1.0)
    upper = Q[np.triu_indices(3)]
    expected = [0.0340734860, 0.0778464355, 0.0739937242, 0.195023832, 0.232414128, 0.499418307]
    np.testing.assert_allclose(upper, expected, rtol=2e-9)  # the oracle has nine digits


@pytest.mark.parametrize(("alpha", "omega_c", "dt"), GRID)
def test_van_loan_is_the_integral_of_the_impulse_response(alpha, omega_c, dt):
    """Q = integral of phi phi^T, by a rule of many nodes from the impulse response itself."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    tau, weights = 0.5 * dt * (nodes + 1.0), 0.5 * dt * weights
    decay = np.exp(-alpha * tau)
    sine, cosine = np.sin(omega_c * tau), np.cos(omega_c * tau)
    velocity = decay * sine / omega_c
    acceleration = decay * (cosine - alpha / omega_c * sine)
    stiffness = alpha**2 + omega_c**2
    position = (1.0 - decay * (cosine + alpha / omega_c * sine)) / stiffness
    phi = np.stack([position, velocity, acceleration])
    assert_same_covariance(noise.variable_turn(alpha, omega_c, dt), (phi * weights) @ phi.T, 1e-12)


@pytest.mark.parametrize(("alpha", "omega_c", "dt"), GRID)
def test_corrected_closed_form_and_printed_entries(alpha, omega_c, dt):
    Q = noise.variable_turn(alpha, omega_c, dt)
    right = noise.variable_turn_closed_form(alpha, omega_c, dt)
    np.testing.assert_allclose(right, (Q[1, 1], Q[1, 2], Q[2, 2]), rtol=1e-10)
    q22, q23, q33 = noise.variable_turn_as_printed(alpha, omega_c, dt)
    np.testing.assert_allclose([q22 / Q[1, 1], q23 / Q[1, 2]], -1.0, rtol=1e-10)
    np.testing.assert_allclose(Q[2, 2] - q33, 1.0 / (4.0 * alpha), rtol=1e-9)


def test_closed_form_is_unusable_at_an_aircrafts_turn_rate():
    """Five digits of q22 are lost at omega_c dt = 0.01, nine at 0.001."""
    for x, least in ((0.01, 1e-13), (0.001, 1e-10)):
        Q = noise.variable_turn(0.5 * x, x, 1.0)
        q22 = noise.variable_turn_closed_form(0.5 * x, x, 1.0)[0]
        assert abs(q22 / Q[1, 1] - 1.0) > least
        assert_same_covariance(Q, noise.white_jerk(1.0), 10.0 * x)


@given(
    alpha=st.floats(-2.0, 2.0), omega_c=st.floats(0.0, 2.0), dt=st.floats(0.01, 2.0),
)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_every_noise_is_positive_definite(alpha, omega_c, dt):
    for Q in (noise.white_jerk(dt), noise.variable_turn(alpha, omega_c, dt)):
        assert np.linalg.eigvalsh(correlations(Q)).min() > 0.0
        np.testing.assert_array_equal(Q, Q.T)


@given(
    omega_c=st.floats(0.0, 1.0), share=st.floats(-1.0, 1.0), dt=st.floats(0.02, 1.0),
    q=st.floats(1e-3, 1e3),
)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_variable_turn_factor_equals_van_loan(omega_c, share, dt, q):
    alpha = share * omega_c
    Q = covariance_of(variable_turn(q), turning_state(alpha, omega_c), dt)
    per_axis = q * noise.variable_turn(alpha, omega_c, dt)
    assert_same_covariance(Q, np.kron(np.eye(3), per_axis), 1e-10)


@pytest.mark.parametrize("dt", INTERVALS)
def test_constant_acceleration_factor_equals_its_covariance(dt):
    Q = covariance_of(constant_acceleration(2.5), (0.0,) * 9, dt)
    assert_same_covariance(Q, np.kron(np.eye(3), 2.5 * noise.white_jerk(dt)), 1e-14)
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    Phi, Q1 = noise.van_loan(A, np.array([[0.0], [0.0], [1.0]]), dt)
    assert_same_covariance(noise.white_jerk(dt), Q1, 1e-13)
    np.testing.assert_allclose(Phi, [[1.0, dt, dt**2 / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("dt", INTERVALS)
def test_matrix_fraction_decomposition(dt):
    """S3 eq 7 in its own order of the states, position before velocity before acceleration."""
    A = np.kron([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], np.eye(3))
    B = sqrt(0.2) * np.kron([[0.0], [0.0], [1.0]], np.eye(3))
    Q = noise.matrix_fraction(A, B, dt)
    exact = 0.2 * np.kron(noise.white_jerk(dt), np.eye(3))
    np.testing.assert_allclose(Q, exact, rtol=1e-14, atol=1e-15 * exact.max())
    assert_same_covariance(Q, noise.van_loan(A, B, dt)[1], 1e-13)
    axis_major = [3 * d + i for i in range(3) for d in range(3)]
    model = covariance_of(constant_acceleration(0.2), (0.0,) * 9, dt)
    assert_same_covariance(Q[np.ix_(axis_major, axis_major)], model, 1e-14)


@pytest.mark.parametrize("dt", INTERVALS)
def test_printed_constant_acceleration_noise_is_indefinite(dt):
    """S0 eq 34: a correlation of 1.2247, for every dt."""
    Q = noise.white_jerk_as_printed(dt)
    assert correlations(Q)[1, 2] == pytest.approx(1.2247, abs=1e-4)
    units = np.array([dt**2.5, dt**1.5, dt**0.5])
    scaled = np.linalg.eigvalsh(Q / np.outer(units, units))
    np.testing.assert_allclose(scaled, [-0.085, 0.033, 1.268], atol=1e-3)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(Q)


@pytest.mark.parametrize("dt", [0.1, 0.5, 1.0, 2.0])
def test_printed_three_dimensional_noise_is_indefinite(dt):
    """S3 eq 14."""
    values = np.linalg.eigvalsh(noise.constant_acceleration_as_printed(dt))
    assert values[0] < 0.0
    if dt == 0.5:
        np.testing.assert_allclose(values[::3], [-0.0193, -0.0032, 0.0272], atol=5e-5)
