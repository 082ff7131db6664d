"""Rotations from body to navigation axes: Euler angles 3-2-1, matrices, rotation vectors.

`build_rotations` gives the component functions that models share; a matrix is a tuple of
nine components, row by row. The functions on arrays serve trajectories and logs.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.models.namespaces import batch

Array = NDArray[np.float64]

SERIES_TERMS = 10  # of sine and cosine: to rounding for a turn of a radian
GIMBAL_FLOOR = 1e-24  # of cos^2(pitch): straight up or down roll and yaw are one angle


class Rotations(NamedTuple):
    """Component functions on one backend."""

    matrix: Callable  # (roll, pitch, yaw) -> nine components of C_b^n
    turn: Callable  # (sx, sy, sz) -> nine components of exp[s x]
    product: Callable  # (A, B) -> A B
    angles: Callable  # C -> (roll, pitch, yaw)


def build_rotations(xp: ModuleType) -> Rotations:
    """The component functions for a module of `kfenv.models.namespaces`."""

    @xp.function
    def matrix(roll, pitch, yaw):
        sr, cr = xp.sin(roll), xp.cos(roll)
        sp, cp = xp.sin(pitch), xp.cos(pitch)
        sy, cy = xp.sin(yaw), xp.cos(yaw)
        return (
            cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy,
            cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy,
            -sp, sr * cp, cr * cp,
        )  # fmt: skip

    @xp.function
    def turn(sx, sy, sz):
        # I + a [s x] + b [s x]^2, a = sin|s| / |s|, b = (1 - cos|s|) / |s|^2; by series,
        # since |s| is small and may be zero
        squared = sx * sx + sy * sy + sz * sz
        a = 1.0 + 0.0 * squared
        b = 1.0 + 0.0 * squared
        for k in range(SERIES_TERMS, 0, -1):
            a = 1.0 - squared / (2.0 * k * (2.0 * k + 1.0)) * a
            b = 1.0 - squared / ((2.0 * k + 1.0) * (2.0 * k + 2.0)) * b
        b = 0.5 * b
        ax, ay, az = a * sx, a * sy, a * sz
        bx, by, bz = b * sx, b * sy, b * sz
        return (
            1.0 - by * sy - bz * sz, bx * sy - az, bx * sz + ay,
            bx * sy + az, 1.0 - bx * sx - bz * sz, by * sz - ax,
            bx * sz - ay, by * sz + ax, 1.0 - bx * sx - by * sy,
        )  # fmt: skip

    @xp.function
    def product(A, B):
        a11, a12, a13, a21, a22, a23, a31, a32, a33 = A
        b11, b12, b13, b21, b22, b23, b31, b32, b33 = B
        return (
            a11 * b11 + a12 * b21 + a13 * b31,
            a11 * b12 + a12 * b22 + a13 * b32,
            a11 * b13 + a12 * b23 + a13 * b33,
            a21 * b11 + a22 * b21 + a23 * b31,
            a21 * b12 + a22 * b22 + a23 * b32,
            a21 * b13 + a22 * b23 + a23 * b33,
            a31 * b11 + a32 * b21 + a33 * b31,
            a31 * b12 + a32 * b22 + a33 * b32,
            a31 * b13 + a32 * b23 + a33 * b33,
        )

    @xp.function
    def angles(C):
        c11, _, _, c21, _, _, c31, c32, c33 = C
        level = xp.sqrt(xp.maximum(c11 * c11 + c21 * c21, GIMBAL_FLOOR))
        return xp.atan2(c32, c33), xp.atan2(-c31, level), xp.atan2(c21, c11)

    return Rotations(matrix, turn, product, angles)


_ON_ARRAYS = build_rotations(batch)


def matrix_from_angles(angles: ArrayLike) -> Array:
    """C_b^n (..., 3, 3) of roll, pitch and yaw (..., 3), rad."""
    return _as_matrix(_ON_ARRAYS.matrix(*np.moveaxis(np.asarray(angles, float), -1, 0)))


def angles_from_matrix(C: ArrayLike) -> Array:
    """Roll, pitch and yaw (..., 3), rad, of C_b^n (..., 3, 3); inverse of `matrix_from_angles`."""
    C = np.asarray(C, float)
    components = tuple(C[..., i, j] for i in range(3) for j in range(3))
    return np.stack(_ON_ARRAYS.angles(components), axis=-1)


def exponential(sigma: ArrayLike) -> Array:
    """exp[sigma x] (..., 3, 3), the turn by a rotation vector (..., 3), rad (S4 eq 5, SPEC 3.5).

    C(t + dt) = C(t) exp[sigma x] with sigma = omega dt.
    """
    return _as_matrix(_ON_ARRAYS.turn(*np.moveaxis(np.asarray(sigma, float), -1, 0)))


def exponential_as_printed(sigma: ArrayLike) -> Array:
    """S4 eq 5 as printed: the minus before its sine makes it exp(-[sigma x]), a backwards turn."""
    return exponential(-np.asarray(sigma, float))


def logarithm(C: ArrayLike) -> Array:
    """The rotation vector (..., 3), rad, of a matrix (..., 3, 3) that turns by less than pi."""
    C = np.asarray(C, float)
    axis = 0.5 * np.stack(
        [C[..., 2, 1] - C[..., 1, 2], C[..., 0, 2] - C[..., 2, 0], C[..., 1, 0] - C[..., 0, 1]],
        axis=-1,
    )
    x, y, z = np.moveaxis(axis, -1, 0)
    sine = np.sqrt(x * x + y * y + z * z)[..., None]
    cosine = 0.5 * (C[..., 0, 0] + C[..., 1, 1] + C[..., 2, 2] - 1.0)[..., None]
    angle = np.arctan2(sine, cosine)
    return axis * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-9)


def _as_matrix(components) -> Array:
    stacked = np.stack(components, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)
