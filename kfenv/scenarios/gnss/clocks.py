"""The true clocks of simulated receivers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.gnss.receiver import CLOCK_OFFSET
from kfenv.scenarios.draws import normal

Array = NDArray[np.float64]

CLOCK_DENSITY = 0.1  # (m/s)^2/s, of truth and filter
DRIFT_DEVIATION = 5.0  # m/s


def clocks(rngs: Sequence[Generator], instants: int, dt: float) -> Array:
    """Bias and drift (B, T, 2), m and m/s, of one for each generator: as `with_clock` assumes."""
    covariance = [[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]
    root = np.linalg.cholesky(CLOCK_DENSITY * np.array(covariance))
    drawn = normal(rngs, (instants, 2))
    drawn[:, 0] *= [CLOCK_OFFSET, DRIFT_DEVIATION]
    drawn[:, 1:] = drawn[:, 1:] @ root.T
    bias, drift = np.moveaxis(drawn, -1, 0)
    np.cumsum(drift, axis=1, out=drift)
    bias[:, 1:] += dt * drift[:, :-1]
    np.cumsum(bias, axis=1, out=bias)
    return drawn
