"""Variable turn: a second-order Markov acceleration (SPEC 3.2, 3.3)."""

from __future__ import annotations

from functools import partial
from math import factorial, sqrt
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from kfenv.models.kinematics import (
    NOISE_PATTERN,
    POSITION,
    STATES,
    VELOCITY,
    check_spectral_density,
)
from kfenv.models.model import Motion, MotionFunctions

MAX_DAMPING = 2.0  # |alpha|, 1/s
MAX_TURN_RATE_SQUARED = 4.0  # omega_c^2, 1/s^2
TAYLOR_TERMS = 16  # of the impulse response: 1e-11 relative at 2 Hz and the clips above


def variable_turn(spectral_density: float = 1.0, speed_floor: float = 10.0) -> Motion:
    """The manoeuvring-aircraft model: v' = a, a' = -2 alpha a - (alpha^2 + omega_c^2) v + w.

    alpha = -(v.a)/|v|^2, omega_c = |a|/|v|; without noise it flies exact turns at
    constant turn rate and constant linear acceleration. One Runge-Kutta step of
    fourth order per filter step. The process noise takes alpha and omega_c frozen
    at the step's start; its factor comes from an eight-node Gauss-Legendre rule,
    since the published closed form loses all its digits at an aircraft's turn
    rates (SPEC 3.3). Keep dt <= 1 s.

    alpha and omega_c are clipped at 2 per second, far above an aircraft's, in the noise
    (SPEC 3.2) and in the step as well: a sigma point of a vague prior may be slow and
    hard accelerated, and from |a| dt / |v| = 2.8 on the step would explode.

    Args:
        spectral_density: q of the white jerk per axis, m^2/s^5.
        speed_floor: |v| below this counts as this (the model is singular at rest), m/s.

    Raises:
        ValueError: if either is not a positive number.
    """
    if not 0.0 < speed_floor < float("inf"):
        raise ValueError(f"speed_floor must be a positive number of m/s, got {speed_floor!r}.")
    build = partial(
        _build,
        root_density=sqrt(check_spectral_density(spectral_density)),
        floor_squared=float(speed_floor) ** 2,
    )
    return Motion("variable-turn", STATES, POSITION, VELOCITY, NOISE_PATTERN, build)


def _build(xp: ModuleType, root_density: float, floor_squared: float) -> MotionFunctions:
    rates = _build_rates(xp, floor_squared)
    step = _build_step(xp, rates)
    at_once = hasattr(xp, "gram")  # tensors: hundreds of small operations are slow
    covariance = (_build_covariance_at_once if at_once else _build_covariance)(xp)

    @xp.function
    def noise_factor(x, u, dt):
        _, vx, ax, _, vy, ay, _, vz, az = x
        alpha, turn = rates(vx, vy, vz, ax, ay, az)
        q11, q12, q13, q22, q23, q33 = covariance(alpha, turn, dt)
        # Cholesky in units of dt^2, dt, 1, where the factor's entries are of order one
        l11 = xp.sqrt(q11)
        l21, l31 = q12 / l11, q13 / l11
        l22 = xp.sqrt(q22 - l21 * l21)
        l32 = (q23 - l31 * l21) / l22
        l33 = xp.sqrt(q33 - l31 * l31 - l32 * l32)
        s = root_density * xp.sqrt(dt + 0.0 * alpha)
        sv, sp = s * dt, s * dt * dt
        axis = (sp * l11, sv * l21, sv * l22, s * l31, s * l32, s * l33)
        return axis + axis + axis

    return MotionFunctions(step, noise_factor)


def _build_rates(xp: ModuleType, floor_squared: float):
    @xp.function
    def rates(vx, vy, vz, ax, ay, az):
        """alpha and omega_c^2, clipped."""
        inverse = 1.0 / xp.maximum(vx * vx + vy * vy + vz * vz, floor_squared)
        alpha = -(vx * ax + vy * ay + vz * az) * inverse
        alpha = xp.minimum(xp.maximum(alpha, -MAX_DAMPING), MAX_DAMPING)
        return alpha, xp.minimum((ax * ax + ay * ay + az * az) * inverse, MAX_TURN_RATE_SQUARED)

    return rates


def _build_step(xp: ModuleType, rates):
    @xp.function
    def jerk(vx, vy, vz, ax, ay, az):
        alpha, turn = rates(vx, vy, vz, ax, ay, az)
        damping, stiffness = -2.0 * alpha, alpha * alpha + turn
        return (
            damping * ax - stiffness * vx,
            damping * ay - stiffness * vy,
            damping * az - stiffness * vz,
        )

    @xp.function
    def step(x, u, dt):
        px, vx1, ax1, py, vy1, ay1, pz, vz1, az1 = x
        h = 0.5 * dt
        jx1, jy1, jz1 = jerk(vx1, vy1, vz1, ax1, ay1, az1)
        vx2, vy2, vz2 = vx1 + h * ax1, vy1 + h * ay1, vz1 + h * az1
        ax2, ay2, az2 = ax1 + h * jx1, ay1 + h * jy1, az1 + h * jz1
        jx2, jy2, jz2 = jerk(vx2, vy2, vz2, ax2, ay2, az2)
        vx3, vy3, vz3 = vx1 + h * ax2, vy1 + h * ay2, vz1 + h * az2
        ax3, ay3, az3 = ax1 + h * jx2, ay1 + h * jy2, az1 + h * jz2
        jx3, jy3, jz3 = jerk(vx3, vy3, vz3, ax3, ay3, az3)
        vx4, vy4, vz4 = vx1 + dt * ax3, vy1 + dt * ay3, vz1 + dt * az3
        ax4, ay4, az4 = ax1 + dt * jx3, ay1 + dt * jy3, az1 + dt * jz3
        jx4, jy4, jz4 = jerk(vx4, vy4, vz4, ax4, ay4, az4)
        s = dt / 6.0
        return (
            px + s * (vx1 + 2.0 * (vx2 + vx3) + vx4),
            vx1 + s * (ax1 + 2.0 * (ax2 + ax3) + ax4),
            ax1 + s * (jx1 + 2.0 * (jx2 + jx3) + jx4),
            py + s * (vy1 + 2.0 * (vy2 + vy3) + vy4),
            vy1 + s * (ay1 + 2.0 * (ay2 + ay3) + ay4),
            ay1 + s * (jy1 + 2.0 * (jy2 + jy3) + jy4),
            pz + s * (vz1 + 2.0 * (vz2 + vz3) + vz4),
            vz1 + s * (az1 + 2.0 * (az2 + az3) + az4),
            az1 + s * (jz1 + 2.0 * (jz2 + jz3) + jz4),
        )

    return step


def _build_covariance(xp: ModuleType):
    """Q1 of unit density over dt, in units of dt^2.5, dt^1.5, dt^0.5 per component.

    Q1 = integral of phi phi^T with the impulse response phi by its Taylor series
    in the scaled time (SPEC 3.3), whose first terms carry the powers of dt.
    """
    nodes, weights = _quadrature()
    inverse = tuple(1.0 / factorial(k) for k in range(TAYLOR_TERMS + 2))

    @xp.function
    def covariance(alpha, turn_rate_squared, dt):
        damping = 2.0 * alpha * dt
        stiffness = (alpha * alpha + turn_rate_squared) * dt * dt
        q11 = q12 = q13 = q22 = q23 = q33 = 0.0 * alpha
        for i in range(8):
            tau = nodes[i]
            d, before = 1.0 + 0.0 * alpha, 0.0 * alpha
            power = 1.0
            position = velocity = acceleration = 0.0 * alpha
            for k in range(TAYLOR_TERMS):
                acceleration = acceleration + d * (power * inverse[k])
                velocity = velocity + d * (power * tau * inverse[k + 1])
                position = position + d * (power * tau * tau * inverse[k + 2])
                d, before = -damping * d - stiffness * before, d
                power = power * tau
            w = weights[i]
            q11 = q11 + w * position * position
            q12 = q12 + w * position * velocity
            q13 = q13 + w * position * acceleration
            q22 = q22 + w * velocity * velocity
            q23 = q23 + w * velocity * acceleration
            q33 = q33 + w * acceleration * acceleration
        return q11, q12, q13, q22, q23, q33

    return covariance


def _quadrature() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Nodes and weights of the eight-node Gauss-Legendre rule over [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    return (
        tuple(float(0.5 * (node + 1.0)) for node in nodes),
        tuple(float(0.5 * weight) for weight in weights),
    )


def _build_covariance_at_once(xp: ModuleType):
    """`_build_covariance` as a product of matrices, with the same series and nodes."""
    table = _taylor_table()

    def covariance(alpha, turn_rate_squared, dt):
        damping = 2.0 * alpha * dt
        stiffness = (alpha * alpha + turn_rate_squared) * dt * dt
        (q11, q12, q13), (_, q22, q23), (_, _, q33) = xp.gram(table, damping, stiffness)
        return q11, q12, q13, q22, q23, q33

    return covariance


def _taylor_table() -> NDArray[np.float64]:
    """Coefficients (nodes, 3, powers of damping, powers of stiffness) of the impulse response.

    They are those of position, velocity and acceleration, times the root of the node's weight.
    """
    powers = TAYLOR_TERMS, TAYLOR_TERMS // 2
    d = np.zeros((TAYLOR_TERMS, *powers))  # derivatives at zero, as polynomials
    d[0, 0, 0] = 1.0
    d[1, 1, 0] = -1.0
    for k in range(2, TAYLOR_TERMS):
        d[k, 1:] = -d[k - 1, :-1]
        d[k, :, 1:] -= d[k - 2, :, :-1]
    nodes, weights = _quadrature()
    table = np.zeros((len(nodes), 3, *powers))
    for row in range(3):
        for k in range(TAYLOR_TERMS):
            power = k + 2 - row
            at_nodes = np.sqrt(weights) * np.power(nodes, power) / factorial(power)
            table[:, row] += at_nodes[:, None, None] * d[k]
    return table
