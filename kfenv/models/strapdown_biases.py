"""Strapdown navigation whose state holds the unit's biases: 15 states (Groves 2013, ch. 5, 14).

Beside `kfenv.models.strapdown` these know gravity where the vehicle is, and on request that the
Earth turns and is round.
"""

from __future__ import annotations

from functools import partial
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.checks import is_number
from kfenv.models import strapdown
from kfenv.models.model import Component, Motion, MotionFunctions
from kfenv.models.rotations import build_rotations

Array = NDArray[np.float64]

BIAS = "bias"  # the group of states whose process noise has a knob of its own
STATES = (
    *strapdown.STATES,
    *(Component(f"accelerometer bias {axis}", "m/s^2", BIAS) for axis in "xyz"),
    *(Component(f"gyroscope bias {axis}", "rad/s", BIAS) for axis in "xyz"),
)
INPUTS = (*strapdown.INPUTS, "gravity", "latitude", "height")
NOISE_PATTERN = tuple((i, i) for i in range(len(STATES)))
SHORTEST_TIME = 10.0  # s: a bias that forgets faster is noise

EQUATOR_RADIUS, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3  # WGS 84, m
EARTH_RATE = 7.292115e-5  # rad/s
EQUATOR_GRAVITY, GRAVITY_RATIO = 9.7803253359, 1.931852652458e-3  # of Somigliana's formula
FREE_AIR = 3.086e-6  # 1/s^2, gravity lost per metre of height
POLEWARD = 0.0519  # m/s^2, gravity gained from the equator to a pole


def local_gravity(latitude: ArrayLike, height: ArrayLike) -> Array:
    """Normal gravity, m/s^2: Somigliana's formula of WGS 84 and the free-air gradient.

    Args:
        latitude: rad.
        height: m above the ellipsoid.
    """
    squared = np.sin(latitude) ** 2
    surface = (1.0 + GRAVITY_RATIO * squared) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * squared)
    return EQUATOR_GRAVITY * surface - FREE_AIR * np.asarray(height)


def strapdown_with_biases(
    process_deviation: tuple[float, float, float],
    bias_drift: tuple[float, float],
    bias_time: tuple[float, float],
    earth: bool = False,
) -> Motion:
    """The model of `kfenv.models.strapdown.strapdown` with the biases of both triads as states.

    A bias is a first-order Markov process: over dt it keeps 1 - dt / T of itself and gains
    white noise. It is taken from the samples before they are integrated. Known inputs of a step
    are besides the samples gravity (m/s^2), latitude (rad) and height (m) of the frame's origin.

    Args:
        process_deviation: of position (m), velocity (m/s) and attitude (rad) after one second:
            what the samples' noise and the mechanisation leave.
        bias_drift: of the accelerometers (m/s^2) and gyroscopes (rad/s), what white noise alone
            would add in one second: the roots of their spectral densities.
        bias_time: correlation times T of the accelerometers and gyroscopes, s.
        earth: whether the Earth turns, is round, and attracts less higher up. Position then is
            the way along the meridian and the parallel.

    Raises:
        ValueError: if a deviation or time is no positive number, or a time shorter than 10 s.
    """
    first = strapdown.strapdown(process_deviation)  # complains
    if not all(is_number(value) and value > 0.0 for value in bias_drift) or len(bias_drift) != 2:
        raise ValueError(
            "bias_drift must hold two positive numbers (accelerometers in m/s^2, gyroscopes in "
            f"rad/s, after a second), got {bias_drift!r}."
        )
    if not all(is_number(t) and t >= SHORTEST_TIME for t in bias_time) or len(bias_time) != 2:
        raise ValueError(
            f"bias_time must hold two numbers of {SHORTEST_TIME:g} s or more, got {bias_time!r}."
        )
    deviation = tuple(map(float, (*process_deviation, *bias_drift)))
    build = partial(_build, deviation=deviation, time=tuple(map(float, bias_time)), earth=earth)
    name = "strapdown with biases"
    return Motion(name, STATES, first.position, first.velocity, NOISE_PATTERN, build, INPUTS)


def _build(
    xp: ModuleType, deviation: tuple[float, ...], time: tuple[float, float], earth: bool
) -> MotionFunctions:
    rotations = build_rotations(xp)
    matrix, turn = rotations.matrix, rotations.turn
    product, angles = rotations.product, rotations.angles
    frame = _turning_frame(xp) if earth else _flat_frame(xp)
    force_time, rate_time = time

    @xp.function
    def step(x, u, dt):
        pn, pe, pd, vn, ve, vd, roll, pitch, yaw, bx, by, bz, gx, gy, gz = x
        fx, fy, fz, wx, wy, wz, gravity, latitude, height = u
        an, ae, ad, wn, we, wd = frame(pn, pd, vn, ve, vd, gravity, latitude, height)
        before = matrix(roll, pitch, yaw)
        c11, c12, c13, c21, c22, c23, c31, c32, c33 = before
        half = 0.5 * dt
        half_turn = turn(
            half * (wx - gx - (c11 * wn + c21 * we + c31 * wd)),
            half * (wy - gy - (c12 * wn + c22 * we + c32 * wd)),
            half * (wz - gz - (c13 * wn + c23 * we + c33 * wd)),
        )
        middle = product(before, half_turn)
        c11, c12, c13, c21, c22, c23, c31, c32, c33 = middle
        fx, fy, fz = fx - bx, fy - by, fz - bz
        new_vn = vn + dt * (c11 * fx + c12 * fy + c13 * fz + an)
        new_ve = ve + dt * (c21 * fx + c22 * fy + c23 * fz + ae)
        new_vd = vd + dt * (c31 * fx + c32 * fy + c33 * fz + ad)
        new_roll, new_pitch, new_yaw = angles(product(middle, half_turn))
        keep_force, keep_rate = 1.0 - dt / force_time, 1.0 - dt / rate_time
        return (
            pn + half * (vn + new_vn), pe + half * (ve + new_ve), pd + half * (vd + new_vd),
            new_vn, new_ve, new_vd, new_roll, new_pitch, new_yaw,
            keep_force * bx, keep_force * by, keep_force * bz,
            keep_rate * gx, keep_rate * gy, keep_rate * gz,
        )  # fmt: skip

    dp, dv, da, df, dr = deviation

    @xp.function
    def noise_factor(x, u, dt):
        s = xp.sqrt(dt + 0.0 * x[0])  # zero * x gives dt the shape of the state
        p, v, a, f, r = dp * s, dv * s, da * s, df * s, dr * s
        return p, p, p, v, v, v, a, a, a, f, f, f, r, r, r

    return MotionFunctions(step, noise_factor)


def _flat_frame(xp: ModuleType):
    """Acceleration and turn rate (north, east, down) of a frame at rest: gravity, and none."""

    @xp.function
    def frame(pn, pd, vn, ve, vd, gravity, latitude, height):
        zero = 0.0 * pd
        return zero, zero, gravity + zero, zero, zero, zero

    return frame


def _turning_frame(xp: ModuleType):
    """The same of the local level frame of the turning, round Earth (Groves 2013, eq 5.41-54)."""

    @xp.function
    def frame(pn, pd, vn, ve, vd, gravity, latitude, height):
        here = latitude + pn / EQUATOR_RADIUS  # to 1 % of the way: of no weight below
        sine, cosine = xp.sin(here), xp.cos(here)
        flat = 1.0 - ECCENTRICITY_SQUARED * sine * sine
        across = EQUATOR_RADIUS / xp.sqrt(flat)
        along = across * (1.0 - ECCENTRICITY_SQUARED) / flat
        above = height - pd
        earth_n, earth_d = EARTH_RATE * cosine, -EARTH_RATE * sine
        over_n, over_e = ve / (across + above), -vn / (along + above)
        over_d = -over_n * sine / cosine
        # what Coriolis takes: (2 earth + over) x v
        wn, we, wd = 2.0 * earth_n + over_n, over_e, 2.0 * earth_d + over_d
        begun = xp.sin(latitude)
        pull = gravity + FREE_AIR * pd + POLEWARD * (sine * sine - begun * begun)
        return (
            wd * ve - we * vd, wn * vd - wd * vn, pull + we * vn - wn * ve,
            earth_n + over_n, over_e, earth_d + over_d,
        )  # fmt: skip

    return frame
