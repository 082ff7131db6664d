"""NumPy arrays, one element per filter."""

from numpy import arctan2 as atan2
from numpy import cos, maximum, minimum, sin, sqrt


def function(f):
    """Leave the function as it is: NumPy broadcasts it."""
    return f


__all__ = ["atan2", "cos", "function", "maximum", "minimum", "sin", "sqrt"]
