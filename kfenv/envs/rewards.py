"""Rewards: two whose return is an episode's score, and a dense surrogate for training.

With ``"rmse"`` and ``"log-rmse"`` an episode has a cost, which grows with the squared errors
so far over all its scored instants, and a decision earns minus what it adds. The cost begins
at zero, so that the undiscounted return is minus the cost at the end, whatever lies between.
"""

from __future__ import annotations

from math import log, log1p, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOG_RMSE = "log-rmse"
IMPROVEMENT = "improvement"
IMPROVEMENT_CAP = 3.0  # of a decision's reward either way, and the price of each after a loss
# Of "log-rmse", in error scales: small beside the error of a good filter, and large enough
# that a first error of a scale, one of hundreds in the mean, costs little.
FLOOR = 0.1


def mean_square(
    squared: Array, scored: Array, to_score: Array, lost: NDArray[np.bool_], lost_distance: float
) -> Array:
    """Squared errors so far over all scored instants of an episode, (B,), m^2.

    A lost track has the loss distance at every scored instant that it missed.

    Args:
        squared: sums (B,) of squared errors, m^2.
        scored: number of instants in these.
        to_score: number of scored instants in the whole episode.
        lost: whether the track is lost.
        lost_distance: m.
    """
    missed = np.where(lost, to_score - scored, 0.0)
    return (squared + missed * lost_distance**2) / np.maximum(to_score, 1.0)


def book(reward: str, mean_square: Array, error_scale: float, cost: Array) -> Array:
    """Minus what is added to each episode's cost (B,), which is brought up to date.

    The cost is RMSE / error_scale, or with ``"log-rmse"`` log sqrt(1 + (RMSE / floor)^2),
    the floor being `FLOOR` error scales.
    """
    added = np.empty_like(cost)
    _book(mean_square, error_scale, reward == LOG_RMSE, cost, added)
    return -added


@njit(cache=True)
def _book(mean_square, error_scale, logarithmic, cost, added):
    for b in range(cost.shape[0]):
        new = _cost(mean_square[b], error_scale, logarithmic)
        added[b], cost[b] = new - cost[b], new


@njit(cache=True)
def _cost(mean_square, error_scale, logarithmic):
    if logarithmic:
        return 0.5 * log1p(mean_square / (FLOOR * error_scale) ** 2)
    return sqrt(mean_square) / error_scale


def worst(reward: str, error_scale: float, lost_distance: float) -> float:
    """What a track lost at once costs; of ``"improvement"`` the same for each decision."""
    if reward == IMPROVEMENT:
        return IMPROVEMENT_CAP
    return _cost(lost_distance**2, error_scale, reward == LOG_RMSE)


@njit(cache=True)
def improvement(nominal_squared, squared, reward):
    """Log of the nominal filter's RMS error over this one's, capped."""
    for b in range(reward.shape[0]):
        ratio = 0.5 * log((nominal_squared[b] + 1e-6) / (squared[b] + 1e-6))
        reward[b] = max(-IMPROVEMENT_CAP, min(IMPROVEMENT_CAP, ratio))
