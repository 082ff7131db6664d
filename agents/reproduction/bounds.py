"""The posterior Cramer-Rao bound of a study, and how near its filters come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.bound import cramer_rao_bound

from .claims import mean_and_interval
from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]

ENSEMBLE = 100  # flights at most over which the slopes are averaged


def bound(study: Study, start: Array | None = None) -> Array:
    """Least standard deviation (K, n) of the state at the kept instants, of any filter.

    Valid for flights drawn from the filter's own motion model; see `cramer_rao_bound`.

    Args:
        start: covariance (n, n) of the initial state, if it is not the one that filters are told.
    """
    recording = study.sample(0, ENSEMBLE)
    same = np.ptp(recording.truth, axis=0).max() == 0.0 and not recording.sensor_inputs.size
    if same and np.ptp(recording.noise, axis=0).max() == 0.0:  # one flight says it all
        recording = recording[:1]
    heard = np.where(np.isnan(recording.measurement), np.nan, recording.true_noise)
    told = recording.factor[0] @ recording.factor[0].T
    covariance = cramer_rao_bound(
        study.scenario.motion, study.scenario.sensor, recording.truth, recording.time, heard,
        told if start is None else start, recording.motion_inputs, recording.sensor_inputs,
    )  # fmt: skip
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[study.kept])


def over_bound(study: Study, outcome: Outcome, least: Array, after: float) -> tuple[Array, Array]:
    """RMS position error over the bound's RMS after a time (s), tracks kept, and its 95 % bound.

    Returns:
        The ratio of each axis (3,), and the upper end of its interval over the runs (3,).
    """
    ratios = squares_over_bound(outcome, least, study.time > after)
    means, _, uppers = np.array([mean_and_interval(axis) for axis in ratios.T]).T
    return np.sqrt(means), np.sqrt(uppers)


def squares_over_bound(outcome: Outcome, least: Array, when: NDArray[np.bool_]) -> Array:
    """Mean square position error over the bound's, of tracks kept (N, 3), at some instants (K,)."""
    squares = np.mean(outcome.position_error[~outcome.lost][:, when] ** 2, axis=1)
    return squares / np.mean(least[when, 0:9:3] ** 2, axis=0)
