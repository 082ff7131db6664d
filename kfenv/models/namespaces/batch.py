"""NumPy arrays, one element per filter."""

from numpy import arctan2 as atan2
from numpy import cos, exp, log, maximum, minimum, sin, sqrt


def function(f):
    """Leave the function as it is: NumPy broadcasts it."""
    return f


__all__ = ["atan2", "cos", "exp", "function", "log", "maximum", "minimum", "sin", "sqrt"]
