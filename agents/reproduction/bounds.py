"""The posterior Cramer-Rao bound of a study, and how near its filters come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.bound import cramer_rao_bound

from .claims import mean_and_interval
from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]

ENSEMBLE = 100  # flights at most over which the slopes are averaged


def bound(study: Study) -> Array:
    """Least standard deviation (K, n) of the state at the kept instants, of any filter.

    Valid for flights drawn from the filter's own motion model; see `cramer_rao_bound`.
    """
    recording = study.sample(0, ENSEMBLE)
    same = np.ptp(recording.truth, axis=0).max() == 0.0 and not recording.sensor_inputs.size
    if same and np.ptp(recording.noise, axis=0).max() == 0.0:  # one flight says it all
        recording = recording[:1]
    heard = np.where(np.isnan(recording.measurement), np.nan, recording.true_noise)
    covariance = cramer_rao_bound(
        study.scenario.motion, study.scenario.sensor, recording.truth, recording.time, heard,
        recording.factor[0] @ recording.factor[0].T, recording.motion_inputs,
        recording.sensor_inputs,
    )  # fmt: skip
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[study.kept])


def over_bound(study: Study, outcome: Outcome, least: Array, after: float) -> tuple[Array, Array]:
    """RMS position error over the bound's RMS after a time (s), tracks kept, and its 95 % bound.

    Returns:
        The ratio of each axis (3,), and the upper end of its interval over the runs (3,).
    """
    late = study.time > after
    squares = np.mean(outcome.position_error[~outcome.lost][:, late] ** 2, axis=1)
    ratios = squares / np.mean(least[late, 0:9:3] ** 2, axis=0)
    means, _, uppers = np.array([mean_and_interval(axis) for axis in ratios.T]).T
    return np.sqrt(means), np.sqrt(uppers)
