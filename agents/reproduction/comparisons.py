"""What the radar experiments compare filters by: paired errors, and when they are of account."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .claims import mean_and_interval, too_few
from .monte_carlo import Outcome

Array = NDArray[np.float64]

SETTLED = 25.0  # s
BROKEN = 1e6  # condition number of a covariance that has come apart
ROUNDING = 1e-6  # m and relative: more is no rounding any more
MATTERS = 0.01  # share of the RMSE below which a difference is of no account
POSITION, ACCELERATION = slice(0, 9, 3), slice(2, 9, 3)


def run_rmse(outcome: Outcome, when: NDArray[np.bool_], columns: slice = POSITION) -> Array:
    """(N,) of a part of the state of each run at some instants (K,), NaN where lost."""
    errors = outcome.error[:, when, columns]
    rmse = np.sqrt(np.mean(np.sum(errors**2, axis=2), axis=1))
    return np.where(outcome.lost, np.nan, rmse)


def largest_difference(one: Outcome, other: Outcome) -> float:
    """Of the states in the runs that both kept; NaN if there is none."""
    both = ~(one.lost | other.lost)
    apart = np.abs(one.error - other.error)[both]
    return float(np.max(apart)) if both.any() else float("nan")


def matters(difference: Array, typical: float) -> bool:
    """Whether a paired difference is surely positive and large enough to be of account.

    Of runs that neither filter lost; the others are NaN, and `with_interval` tells their number.
    """
    mean, low, _ = mean_and_interval(difference)
    return low > 0.0 and mean > MATTERS * typical


def unsure(difference: Array, typical: float) -> str:
    """Told of a difference that was not shown to matter, where the runs leave that open."""
    return "" if matters(difference, typical) else too_few(difference, MATTERS * typical)
