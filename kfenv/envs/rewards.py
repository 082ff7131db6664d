"""Rewards: two whose return is an episode's score, and dense ones for training.

With ``"rmse"`` and ``"log-rmse"`` an episode has a cost, and a decision earns minus what it adds.
The cost supposes an error of one scale wherever there is none yet, so that at first it is zero
and a step counts about alike early and late; at the end it is a function of the RMSE alone. The
undiscounted return is therefore minus that, whatever lay between.
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.kernel_cache import KERNEL

Array = NDArray[np.float64]

LOG_RMSE = "log-rmse"
IMPROVEMENT = "improvement"
LABEL_FREE = LIKELIHOOD, CONSISTENCY = "likelihood", "consistency"  # see `foresight`
DENSE = (IMPROVEMENT, *LABEL_FREE)
CAP = 3.0  # of a dense reward either way, and the price of each decision after a loss


def mean_square(
    squared: Array, scored: Array, to_score: Array, lost: NDArray[np.bool_], lost_distance: float,
    supposed: float = 0.0,
) -> Array:  # fmt: skip
    """Mean of squared errors over all scored instants of an episode, (B,), m^2.

    A lost track has the loss distance at every scored instant that it missed.

    Args:
        squared: sums (B,) of squared errors so far, m^2.
        scored: number of instants in these.
        to_score: number of scored instants in the whole episode.
        lost: whether the track is lost.
        lost_distance: m.
        supposed: error at those that are still to come, m.
    """
    mean = np.empty_like(squared)
    _mean_square(squared, scored, to_score, lost, lost_distance, supposed, mean)
    return mean


@njit(**KERNEL)
def _mean_square(squared, scored, to_score, lost, lost_distance, supposed, mean):
    for b in range(mean.shape[0]):
        missing = lost_distance if lost[b] else supposed
        total = squared[b] + (to_score[b] - scored[b]) * (missing * missing)
        mean[b] = total / max(to_score[b], 1.0)


def book(
    reward: str, squared: Array, scored: Array, to_score: Array, lost: NDArray[np.bool_],
    lost_distance: float, error_scale: float, cost: Array,
) -> Array:  # fmt: skip
    """Minus what is added to each episode's cost (B,), which is brought up to date.

    The cost is the root of the mean square over the scale, less the share still to come, or
    with ``"log-rmse"`` the log of that root.

    Args:
        squared, scored, to_score, lost, lost_distance: as for `mean_square`.
        error_scale: m; one is supposed where there is no error yet.
        cost: (B,) so far.
    """
    earned = np.empty(cost.shape)
    _book(
        squared, scored, to_score, lost, lost_distance, error_scale, reward == LOG_RMSE, cost,
        earned,
    )  # fmt: skip
    return earned


@njit(**KERNEL)
def _book(
    squared, scored, to_score, lost, lost_distance, error_scale, logarithmic, cost, earned
):  # fmt: skip
    _mean_square(squared, scored, to_score, lost, lost_distance, error_scale, earned)
    for b in range(cost.shape[0]):
        to_come = 0.0 if lost[b] else 1.0 - scored[b] / to_score[b]
        root = sqrt(earned[b]) / error_scale
        new = log(root) if logarithmic else root - to_come
        earned[b], cost[b] = -(new - cost[b]), new


@njit(**KERNEL)
def withhold(running, reward):
    """Nothing is earned by those who do not run."""
    for b in range(reward.shape[0]):
        if not running[b]:
            reward[b] = 0.0


def worst(reward: str, error_scale: float, lost_distance: float) -> float:
    """What a track lost at once costs; of a dense reward the same for each decision."""
    if reward in DENSE:
        return CAP
    ratio = lost_distance / error_scale
    return log(ratio) if reward == LOG_RMSE else ratio


def least_square(error_scale: float) -> float:
    """What a squared error counts at least, so that no ratio is without bounds: (1 mm)^2 or less.

    Of small scales a ten-thousandth, squared.
    """
    return min(1e-6, (1e-4 * error_scale) ** 2)


@njit(**KERNEL)
def improvement(nominal_squared, squared, least, reward):
    """Log of the nominal filter's RMS error over this one's, capped."""
    for b in range(reward.shape[0]):
        ratio = 0.5 * log((nominal_squared[b] + least) / (squared[b] + least))
        reward[b] = max(-CAP, min(CAP, ratio))
