"""Errors of simulated inertial units."""

from __future__ import annotations

from math import exp, radians, sqrt

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]


def of_unit(pair: tuple[float, float]) -> Array:
    """Six numbers, SI, from m/s^2 and deg/s."""
    return np.repeat([pair[0], radians(pair[1])], 3)


def markov(rng: Generator, steps: int, dt: float, time: float, deviation: Array) -> Array:
    """Six first-order Markov processes (T, 6) of these deviations (6,) and that correlation time.

    Those without a deviation draw their numbers too, so that what follows stays the same.
    """
    from scipy.signal import lfilter

    keep = exp(-dt / time)
    drive = rng.standard_normal((steps, 6))
    if not deviation.any():
        return np.zeros((steps, 6))
    drive[1:] *= sqrt(1.0 - keep * keep)
    return deviation * lfilter([1.0], [1.0, -keep], drive, axis=0)
