"""What a receiver adds to its pseudoranges: thermal noise and multipath (SPEC 4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT

Array = NDArray[np.float64]

CODE_NOISE = 0.01 * SPEED_OF_LIGHT / 1.023e6  # m: 1 % of a C/A chip, 2.93 m
TROPOSPHERE_RESIDUAL = 0.5  # m: what the standard atmosphere leaves
USUAL_STRENGTH = 45.0  # dB-Hz, of C/N0
RATE_NOISE = 0.06  # m/s: 0.3 Hz at L1
CLOCK_OFFSET = 500e-9 * SPEED_OF_LIGHT  # m: 500 ns, the clock's first uncertainty


def multipath_deviation(elevation: ArrayLike) -> Array:
    """Standard deviation 0.13 + 0.53 exp(-E / 10 deg), m; elevation in rad.

    The formula wants degrees: 0.45 m at 5 deg, 0.13 m overhead (SPEC 4.3).
    """
    return 0.13 + 0.53 * np.exp(-np.degrees(elevation) / 10.0)


def range_deviation(elevation: ArrayLike, code_noise: ArrayLike = CODE_NOISE) -> Array:
    """Standard deviation of a corrected pseudorange, m: the root of the summed squares."""
    squared = multipath_deviation(elevation) ** 2 + np.square(code_noise) + TROPOSPHERE_RESIDUAL**2
    return np.sqrt(squared)


def noise_at(strength: ArrayLike, noise: float) -> Array:
    """Noise at a C/N0 in dB-Hz, of a receiver that has so much at 45 dB-Hz: as its square root."""
    return noise * 10.0 ** ((USUAL_STRENGTH - np.asarray(strength)) / 20.0)
