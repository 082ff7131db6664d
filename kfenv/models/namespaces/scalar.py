"""Python floats."""

from math import atan2, cos, exp, log, sin, sqrt

maximum = max
minimum = min


def function(f):
    """Leave the function as it is: Python runs it."""
    return f


__all__ = ["atan2", "cos", "exp", "function", "log", "maximum", "minimum", "sin", "sqrt"]
