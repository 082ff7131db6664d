"""Constant acceleration driven by white jerk (SPEC 3.1)."""

from __future__ import annotations

from functools import partial
from math import sqrt
from types import ModuleType

from kfenv.models.kinematics import (
    NOISE_PATTERN,
    POSITION,
    STATES,
    VELOCITY,
    check_spectral_density,
)
from kfenv.models.model import Motion, MotionFunctions


def constant_acceleration(spectral_density: float = 1.0) -> Motion:
    """The linear motion model of the validation experiments.

    Per axis p' = v, v' = a, a' = w with white w of the given power spectral
    density. Discrete noise: Q = q [[dt^5/20, dt^4/8, dt^3/6], [., dt^3/3, dt^2/2],
    [., ., dt]], the printed dt^3/6 in the middle being wrong (SPEC 3.1).

    Args:
        spectral_density: q of the white jerk, m^2/s^5.
    """
    build = partial(_build, root_density=sqrt(check_spectral_density(spectral_density)))
    return Motion("constant-acceleration", STATES, POSITION, VELOCITY, NOISE_PATTERN, build)


def _build(xp: ModuleType, root_density: float) -> MotionFunctions:
    @xp.function
    def step(x, u, dt):
        px, vx, ax, py, vy, ay, pz, vz, az = x
        half = 0.5 * dt * dt
        return (
            px + dt * vx + half * ax, vx + dt * ax, ax,
            py + dt * vy + half * ay, vy + dt * ay, ay,
            pz + dt * vz + half * az, vz + dt * az, az,
        )  # fmt: skip

    # The Cholesky factor of Q in closed form: its constants are exact fractions.
    c11, c21, c31 = 1.0 / sqrt(20.0), sqrt(20.0) / 8.0, sqrt(20.0) / 6.0
    c22, c32, c33 = 1.0 / sqrt(48.0), sqrt(48.0) / 12.0, 1.0 / 3.0

    @xp.function
    def noise_factor(x, u, dt):
        # zero * x gives dt the shape of the state, whatever the backend
        s = root_density * xp.sqrt(dt + 0.0 * x[0])
        l11, l21, l31 = c11 * dt * dt * s, c21 * dt * s, c31 * s
        l22, l32, l33 = c22 * dt * s, c32 * s, c33 * s
        axis = (l11, l21, l22, l31, l32, l33)
        return axis + axis + axis

    return MotionFunctions(step, noise_factor)
