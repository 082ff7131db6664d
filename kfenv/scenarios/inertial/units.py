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


def markov(rng: Generator, steps: int, dt: float, time: float) -> Array:
    """Six first-order Markov processes (T, 6) of unit deviation and that correlation time."""
    from scipy.signal import lfilter

    keep = exp(-dt / time)
    drive = rng.standard_normal((steps, 6))
    drive[1:] *= sqrt(1.0 - keep * keep)
    return lfilter([1.0], [1.0, -keep], drive, axis=0)
