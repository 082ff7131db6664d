"""Strapdown inertial navigation in a local level frame (SPEC 3.5; S4 eq 1-8)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Component, Motion, MotionFunctions
from kfenv.models.namespaces import batch
from kfenv.models.rotations import build_rotations, exponential_as_printed, matrix_from_angles

Array = NDArray[np.float64]

GRAVITY = 9.81  # m/s^2, along down
STATES = (
    *(Component(f"p{axis}", "m") for axis in "NED"),
    *(Component(f"v{axis}", "m/s") for axis in "NED"),
    *(Component(angle, "rad", angle=True) for angle in ("roll", "pitch", "yaw")),
)
INPUTS = (
    *(f"specific force {axis}" for axis in "xyz"),
    *(f"angular rate {axis}" for axis in "xyz"),
)
POSITION, VELOCITY, ATTITUDE = (0, 1, 2), (3, 4, 5), (6, 7, 8)
NOISE_PATTERN = tuple((i, i) for i in range(9))


def strapdown(process_deviation: Sequence[float], per_step: bool = False) -> Motion:
    """Position and velocity in north, east, down and roll, pitch, yaw, driven by inertial samples.

    Known inputs of a step: specific force (m/s^2) and angular rate (rad/s) along the body
    axes forward, right, down, both constant over the step. With C at the step's middle,
    C(t + dt) = C(t) exp[omega dt x]; v <- v + dt (C f + g), g = (0, 0, +9.81);
    p <- p + dt (v_old + v_new) / 2. Earth rotation, transport rate and the change of
    gravity are neglected. Attitude is kept as Euler angles: straight up or down roll and
    yaw cannot be told apart, and within a few deviations of it the filter is poor.

    The process noise is white in each state and stands for all that the samples hide,
    biases included. All its deviations must be positive: the square-root filter's
    triangularisation must not meet a column of zeros (SPEC 9).

    Args:
        process_deviation: of position (m), velocity (m/s) and attitude (rad) after one
            second, so that a step adds their squares times dt.
        per_step: take them as deviations after each step instead, however long.

    Raises:
        ValueError: if a deviation is no positive number.
    """
    given = tuple(process_deviation)
    if len(given) != 3 or not all(is_number(value) and value > 0.0 for value in given):
        raise ValueError(
            "process_deviation must hold three positive numbers (position in m, velocity in "
            f"m/s, attitude in rad), got {process_deviation!r}."
        )
    deviation = tuple(float(value) for value in given for _ in range(3))
    build = partial(_build, deviation=deviation, per_step=per_step)
    return Motion("strapdown", STATES, POSITION, VELOCITY, NOISE_PATTERN, build, INPUTS)


def _build(xp: ModuleType, deviation: tuple[float, ...], per_step: bool) -> MotionFunctions:
    rotations = build_rotations(xp)
    matrix, turn = rotations.matrix, rotations.turn
    product, angles = rotations.product, rotations.angles

    @xp.function
    def step(x, u, dt):
        pn, pe, pd, vn, ve, vd, roll, pitch, yaw = x
        fx, fy, fz, wx, wy, wz = u
        half = 0.5 * dt
        half_turn = turn(half * wx, half * wy, half * wz)
        middle = product(matrix(roll, pitch, yaw), half_turn)
        c11, c12, c13, c21, c22, c23, c31, c32, c33 = middle
        new_vn = vn + dt * (c11 * fx + c12 * fy + c13 * fz)
        new_ve = ve + dt * (c21 * fx + c22 * fy + c23 * fz)
        new_vd = vd + dt * (c31 * fx + c32 * fy + c33 * fz + GRAVITY)
        new_roll, new_pitch, new_yaw = angles(product(middle, half_turn))
        return (
            pn + half * (vn + new_vn), pe + half * (ve + new_ve), pd + half * (vd + new_vd),
            new_vn, new_ve, new_vd, new_roll, new_pitch, new_yaw,
        )  # fmt: skip

    dp, dv, da = deviation[0], deviation[3], deviation[6]

    @xp.function
    def noise_factor(x, u, dt):
        # zero * x gives dt the shape of the state, whatever the backend
        s = 1.0 + 0.0 * x[0] if per_step else xp.sqrt(dt + 0.0 * x[0])
        return dp * s, dp * s, dp * s, dv * s, dv * s, dv * s, da * s, da * s, da * s

    return MotionFunctions(step, noise_factor)


def mechanise(state: Array, samples: Array, time: Array) -> Array:
    """Integrate inertial samples from a first state, as the filter's model does.

    Args:
        state: (9,) at the first time.
        samples: (T, 6) specific force and angular rate; row t drives the step from t - 1
            to t, row 0 is not used.
        time: (T,) s.

    Returns:
        States (T, 9).
    """
    step = _build(batch, (1.0,) * 9, False).step
    states = np.empty((len(time), 9))
    states[0] = state
    for t in range(1, len(time)):
        states[t] = step(tuple(states[t - 1]), tuple(samples[t]), time[t] - time[t - 1])
    return states


def step_as_printed(state: Array, sample: Array, dt: float) -> Array:
    """One step of S4 eq 5, 7 and 8 as printed: backwards turn, C f - g, new velocity in p."""
    C = matrix_from_angles(state[6:]) @ exponential_as_printed(np.asarray(sample[3:]) * dt)
    velocity = state[3:6] + dt * (C @ sample[:3] - np.array([0.0, 0.0, GRAVITY]))
    position = state[:3] + dt * velocity
    angles = build_rotations(batch).angles(tuple(C.ravel()))
    return np.concatenate([position, velocity, angles])
