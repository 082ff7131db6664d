"""Dual numbers: a value and its exact gradient, carried through the arithmetic.

A model run on duals yields its Jacobian to rounding, so no Jacobian is ever
written by hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Dual:
    """A batch of values, shape (...,), with gradients, shape (..., n)."""

    __slots__ = ("gradient", "value")
    __array_ufunc__ = None  # NumPy arrays on the left defer to our operators

    def __init__(self, value: ArrayLike, gradient: ArrayLike) -> None:
        self.value = _real(value)
        self.gradient = _real(gradient)

    def __add__(self, other):
        other = _lift(other, self)
        return Dual(self.value + other.value, self.gradient + other.gradient)

    def __mul__(self, other):
        other = _lift(other, self)
        return Dual(
            self.value * other.value,
            self.value[..., None] * other.gradient + other.value[..., None] * self.gradient,
        )

    def __truediv__(self, other):
        other = _lift(other, self)
        quotient = self.value / other.value
        slope = (self.gradient - quotient[..., None] * other.gradient) / other.value[..., None]
        return Dual(quotient, slope)

    def __neg__(self):
        return Dual(-self.value, -self.gradient)

    def __sub__(self, other):
        return self + (-_lift(other, self))

    def __rsub__(self, other):
        return _lift(other, self) - self

    def __rtruediv__(self, other):
        return _lift(other, self) / self

    def __pow__(self, exponent: float):
        value = self.value**exponent
        return _chain(self, value, exponent * self.value ** (exponent - 1.0))

    __radd__ = __add__
    __rmul__ = __mul__


def _real(numbers: ArrayLike) -> Array:
    """Single precision stays single."""
    array = np.asarray(numbers)
    return array if array.dtype.kind == "f" else array.astype(float)


def _lift(number, like: Dual) -> Dual:
    """Give a constant a zero gradient, and the other's precision."""
    if isinstance(number, Dual):
        return number
    value = np.broadcast_to(np.asarray(number, dtype=like.value.dtype), like.value.shape)
    return Dual(value, np.zeros_like(like.gradient))


def _chain(x: Dual, value: Array, slope: Array) -> Dual:
    return Dual(value, slope[..., None] * x.gradient)


def sqrt(x: Dual) -> Dual:
    """Square root."""
    root = np.sqrt(x.value)
    return _chain(x, root, 0.5 / root)


def sin(x: Dual) -> Dual:
    """Sine."""
    return _chain(x, np.sin(x.value), np.cos(x.value))


def cos(x: Dual) -> Dual:
    """Cosine."""
    return _chain(x, np.cos(x.value), -np.sin(x.value))


def exp(x: Dual) -> Dual:
    """Exponential."""
    value = np.exp(x.value)
    return _chain(x, value, value)


def log(x: Dual) -> Dual:
    """Natural logarithm."""
    return _chain(x, np.log(x.value), 1.0 / x.value)


def atan2(y: Dual, x: Dual) -> Dual:
    """Angle of (x, y)."""
    y, x = (_lift(y, x), x) if isinstance(x, Dual) else (y, _lift(x, y))
    squared = x.value**2 + y.value**2
    gradient = x.value[..., None] * y.gradient - y.value[..., None] * x.gradient
    return Dual(np.arctan2(y.value, x.value), gradient / squared[..., None])


def _choose(take_first: NDArray[np.bool_], a: Dual, b: Dual) -> Dual:
    gradient = np.where(take_first[..., None], a.gradient, b.gradient)
    return Dual(np.where(take_first, a.value, b.value), gradient)


def maximum(a, b) -> Dual:
    """The larger of a and b; either may be a number."""
    a, b = (a, _lift(b, a)) if isinstance(a, Dual) else (_lift(a, b), b)
    return _choose(a.value >= b.value, a, b)


def minimum(a, b) -> Dual:
    """The smaller of a and b; either may be a number."""
    return -maximum(-a, -b)


def function(f):
    """Leave the function as it is."""
    return f


def seed(state: Array) -> tuple[Dual, ...]:
    """Turn states (..., n) into n duals whose gradients are the unit vectors."""
    identity = np.eye(state.shape[-1], dtype=state.dtype)
    return tuple(
        Dual(state[..., i], np.broadcast_to(identity[i], state.shape))
        for i in range(state.shape[-1])
    )


__all__ = [
    "Dual", "atan2", "cos", "exp", "function", "log", "maximum", "minimum", "seed", "sin", "sqrt",
]  # fmt: skip
