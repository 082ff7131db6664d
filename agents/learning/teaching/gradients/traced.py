"""A namespace for models (see `kfenv.models.namespaces`) that records what they compute.

A model that is built with it and called on symbols gives expressions; `pullback` differentiates
them. What a model multiplies by zero is left out.
"""

from __future__ import annotations

import math
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

_numbers = count()


class Expression:
    """One operation and what it takes.

    Attributes:
        operation: an operator, a function of the namespace, ``"symbol"`` or ``"polynomial"``.
        arguments: expressions and numbers; the text of a symbol; of a polynomial x, y, a table
            (nodes, rows, powers of x, powers of y) of coefficients and its place there.
        number: greater than those of its arguments.
    """

    __slots__ = ("arguments", "number", "operation")

    def __init__(self, operation: str, *arguments: Any) -> None:
        self.operation, self.arguments, self.number = operation, arguments, next(_numbers)

    def __add__(self, other):
        return self if _is(other, 0.0) else Expression("+", self, other)

    def __sub__(self, other):
        return self if _is(other, 0.0) else Expression("-", self, other)

    def __rsub__(self, other):
        return -self if _is(other, 0.0) else Expression("-", other, self)

    def __mul__(self, other):
        if _is(other, 0.0):
            return 0.0
        return self if _is(other, 1.0) else Expression("*", self, other)

    def __truediv__(self, other):
        return Expression("/", self, other)

    def __rtruediv__(self, other):
        return Expression("/", other, self)

    def __pow__(self, exponent):
        return Expression("**", self, int(exponent))

    def __neg__(self):
        return Expression("*", self, -1.0)

    __radd__, __rmul__ = __add__, __mul__


def _is(other: Any, number: float) -> bool:
    return isinstance(other, float | int) and other == number


def _recorded(name: str, of_numbers: Any) -> Any:
    def call(*arguments):
        if any(isinstance(argument, Expression) for argument in arguments):
            return Expression(name, *arguments)
        return of_numbers(*arguments)

    return call


sqrt, sin, cos = (_recorded(name, getattr(math, name)) for name in ("sqrt", "sin", "cos"))
exp, log, atan2 = (_recorded(name, getattr(math, name)) for name in ("exp", "log", "atan2"))
maximum, minimum = _recorded("maximum", max), _recorded("minimum", min)


def function(f):
    """Leave the function as it is."""
    return f


def gram(table: NDArray[np.float64], x: Any, y: Any) -> tuple[tuple[Expression, ...], ...]:
    """See `kfenv.models.namespaces.tensor.gram`."""
    nodes, rows = (range(size) for size in table.shape[:2])
    v = [[Expression("polynomial", x, y, table, i, row) for row in rows] for i in nodes]
    return tuple(tuple(sum(v[i][a] * v[i][b] for i in nodes) for b in rows) for a in rows)


__all__ = ["atan2", "cos", "exp", "function", "gram", "log", "maximum", "minimum", "sin", "sqrt"]
