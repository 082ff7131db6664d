"""Discrete process noise of one axis [position, velocity, acceleration]: right forms and printed.

The models carry their own fast factors; these are the forms they are tested against,
and the published formulas that fail, so that each erratum can be shown (SPEC 3.1, 3.3).
All are for white jerk of unit power spectral density; multiply by q in m^2/s^5.
"""

from __future__ import annotations

from math import cos, exp, sin

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def white_jerk(dt: float) -> Array:
    """Covariance (3, 3) of constant acceleration driven by white jerk over dt (SPEC 3.1)."""
    return np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )


def van_loan(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Transition matrix and noise covariance over dt of x' = A x + B w, w white of unit density.

    One matrix exponential of twice the size (Van Loan 1978; SPEC 3.3).

    Args:
        A: (n, n).
        B: (n, r).
        dt: s.

    Returns:
        Phi (n, n) and Q (n, n), symmetric to the last bit.
    """
    from scipy.linalg import expm  # half a second of import that no filter needs

    n = len(A)
    M = expm(np.block([[-A, B @ B.T], [np.zeros_like(A), A.T]]) * dt)
    Phi = M[n:, n:].T
    Q = Phi @ M[:n, n:]
    return Phi, 0.5 * (Q + Q.T)


def matrix_fraction(A: Array, B: Array, dt: float) -> Array:
    """Noise covariance of x' = A x + B w over dt by matrix fraction decomposition (S3 eq 7).

    Q = C D^-1 with [C; D] = exp([[A, B B^T], [0, -A^T]] dt) [0; I]; arguments as in `van_loan`,
    which needs no solution of a linear system.
    """
    from scipy.linalg import expm  # half a second of import that no filter needs

    n = len(A)
    M = expm(np.block([[A, B @ B.T], [np.zeros_like(A), -A.T]]) * dt)
    C, D = M[:n, n:], M[n:, n:]
    return np.linalg.solve(D.T, C.T).T


def variable_turn(alpha: float, omega_c: float, dt: float) -> Array:
    """Covariance (3, 3) of v'' = -2 alpha v' - (alpha^2 + omega_c^2) v + w over dt (SPEC 3.3).

    Args:
        alpha: damping, 1/s.
        omega_c: turn rate of the Markov model, rad/s.
        dt: s.
    """
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -(alpha**2 + omega_c**2), -2.0 * alpha]])
    return van_loan(A, np.array([[0.0], [0.0], [1.0]]), dt)[1]


def variable_turn_closed_form(
    alpha: float, omega_c: float, dt: float
) -> tuple[float, float, float]:
    """Entries q22, q23, q33 of `variable_turn` in closed form, corrected (SPEC 3.3).

    For study only: 0/0 at alpha = 0 or omega_c = 0, and at an aircraft's turn rates the
    differences cancel to nothing.
    """
    a, w = alpha, omega_c
    head = exp(-2.0 * a * dt) / (4.0 * w**2)
    growth, c, s = w**2 * exp(2.0 * a * dt), cos(2.0 * w * dt), sin(2.0 * w * dt)
    common = growth - w**2 - a**2 + a**2 * c
    q22 = head / (a * (a**2 + w**2)) * (common - w * a * s)
    q23 = head * (1.0 - c)
    q33 = head / a * (common + w * a * s)
    return q22, q23, q33


def white_jerk_as_printed(dt: float) -> Array:
    """S0 eq 34: the middle entry is dt^3/6, so that the matrix is indefinite for every dt."""
    Q = white_jerk(dt)
    Q[1, 1] = dt**3 / 6.0
    return Q


def constant_acceleration_as_printed(dt: float) -> Array:
    """S3 eq 14, (9, 9) derivative-major: dt^5/20 in all diagonal blocks, dt^4/8 between
    velocity and acceleration; indefinite."""
    Q1 = white_jerk(dt)
    np.fill_diagonal(Q1, dt**5 / 20.0)
    Q1[1, 2] = Q1[2, 1] = dt**4 / 8.0
    return np.kron(Q1, np.eye(3))


def variable_turn_as_printed(alpha: float, omega_c: float, dt: float) -> tuple[float, float, float]:
    """S0 Appendix A: q22 and q23 have the wrong sign, q33 lacks omega_c^2 exp(2 alpha dt)."""
    q22, q23, q33 = variable_turn_closed_form(alpha, omega_c, dt)
    return -q22, -q23, q33 - 1.0 / (4.0 * alpha)
