"""Numba: floats, or eight of them at once (`lanes`), inside compiled kernels."""

from math import pi

from numba import njit

import kfenv.kernel_cache  # noqa: F401  (processes take turns at it)
from kfenv.models.namespaces.lanes import copysign, exp, floor, log, sqrt, where_greater

# NaN marks what did not arrive, so the flags that assume no NaN stay off.
FLOATING_POINT = {
    "fastmath": {"contract", "nsz", "arcp"},
    "error_model": "numpy",
}
# Compiled code alone calls it: the ways in from Python and C take a sixth of the compilation.
INNER = {**FLOATING_POINT, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
TWO_PI = 2.0 * pi
TAN_PI_8 = 0.41421356237309503

function = njit(forceinline=True, **INNER)


@function
def maximum(a, b):
    """The larger of a and b."""
    return where_greater(a, b, a, b)


@function
def minimum(a, b):
    """The smaller of a and b."""
    return where_greater(b, a, a, b)


@function
def wrap(angle):
    """The angle in [-pi, pi)."""
    return angle - TWO_PI * floor(angle / TWO_PI + 0.5)


@function
def atan2(y, x):
    """Angle of (x, y) to a few units in the last place, without a branch or a call.

    Two reductions bring the argument to |t| <= tan(pi/8); there the rational
    approximation of the Cephes library (S. Moshier) holds.
    """
    ax, ay = abs(x), abs(y)
    t = minimum(ax, ay) / maximum(maximum(ax, ay), 1e-300)
    reduced = where_greater(t, TAN_PI_8, (t - 1.0) / (t + 1.0), t)
    q = reduced * reduced
    top = -8.750608600031904122785e-1 * q - 1.615753718733365076637e1
    top = (top * q - 7.500855792314704667340e1) * q - 1.228866684490136173410e2
    top = top * q - 6.485021904942025371773e1
    bottom = (q + 2.485846490142306297962e1) * q + 1.650270098316988542046e2
    bottom = (bottom * q + 4.328810604912902668951e2) * q + 4.853903996359136964868e2
    bottom = bottom * q + 1.945506571482613964425e2
    angle = reduced + reduced * q * top / bottom + where_greater(t, TAN_PI_8, 0.25 * pi, 0.0)
    angle = where_greater(ay, ax, 0.5 * pi - angle, angle)
    angle = where_greater(0.0, x, pi - angle, angle)
    return copysign(angle, y)


@function
def _sin_cos(angle):
    """Sine and cosine, after reduction to |r| <= pi/4, by Taylor series to rounding."""
    quarter = floor(angle * (2.0 / pi) + 0.5)
    # pi/2 in three parts: exact products for any angle a filter meets
    r = angle - quarter * 1.57079632673412561417
    r = (r - quarter * 6.07710050630396597660e-11) - quarter * 2.02226624879595063154e-21
    q = r * r
    sine = 1.0 - q / 342.0
    for factor in (272.0, 210.0, 156.0, 110.0, 72.0, 42.0, 20.0, 6.0):
        sine = 1.0 - q / factor * sine
    cosine = 1.0 - q / 306.0
    for factor in (240.0, 182.0, 132.0, 90.0, 56.0, 30.0, 12.0, 2.0):
        cosine = 1.0 - q / factor * cosine
    sine = r * sine
    turn = quarter - 4.0 * floor(quarter * 0.25)  # 0, 1, 2 or 3 quarters
    odd = turn - 2.0 * floor(turn * 0.5)
    s = where_greater(odd, 0.5, cosine, sine)
    c = where_greater(odd, 0.5, sine, cosine)
    s = where_greater(turn, 1.5, -s, s)
    c = where_greater(where_greater(turn, 0.5, 1.0, 0.0) * where_greater(2.5, turn, 1.0, 0.0),
                      0.5, -c, c)  # fmt: skip
    return s, c


@function
def sin(angle):
    """Sine."""
    return _sin_cos(angle)[0]


@function
def cos(angle):
    """Cosine."""
    return _sin_cos(angle)[1]


__all__ = ["atan2", "cos", "exp", "function", "log", "maximum", "minimum", "sin", "sqrt"]
