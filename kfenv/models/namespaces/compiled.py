"""Numba: scalars inside compiled kernels.

Functions are inlined by force, since the kernel's loops over sigma points are
vectorised only where the model's body stands inside them.
"""

from math import cos, copysign, pi, sin, sqrt

from numba import njit

# NaN marks what did not arrive, so the flags that assume no NaN stay off.
FLOATING_POINT = {
    "fastmath": {"reassoc", "contract", "nsz", "arcp"},
    "error_model": "numpy",
}

maximum = max
minimum = min
function = njit(forceinline=True, **FLOATING_POINT)

# Minimax coefficients of (atan(t) - t) / t^3 in t^2 for |t| <= tan(pi/8): see `atan2`.
TAN_PI_8 = 0.41421356237309503


@function
def atan2(y, x):
    """Angle of (x, y) to about one unit in the last place, without a branch or a call.

    The library function would keep the loop over sigma points from being vectorised.
    Two reductions bring the argument to |t| <= tan(pi/8); there the rational
    approximation of the Cephes library (S. Moshier) holds.
    """
    ax, ay = abs(x), abs(y)
    steep = ay > ax
    t = (ax if steep else ay) / max(ay if steep else ax, 1e-300)
    far = t > TAN_PI_8
    t = (t - 1.0) / (t + 1.0) if far else t
    q = t * t
    top = (((-8.750608600031904122785e-1 * q - 1.615753718733365076637e1) * q
            - 7.500855792314704667340e1) * q - 1.228866684490136173410e2) * q - 6.485021904942025371773e1
    bottom = ((((q + 2.485846490142306297962e1) * q + 1.650270098316988542046e2) * q
               + 4.328810604912902668951e2) * q + 4.853903996359136964868e2) * q + 1.945506571482613964425e2
    angle = t + t * q * top / bottom + (0.25 * pi if far else 0.0)
    angle = 0.5 * pi - angle if steep else angle
    angle = pi - angle if x < 0.0 else angle
    return copysign(angle, y)


__all__ = ["atan2", "cos", "function", "maximum", "minimum", "sin", "sqrt"]
