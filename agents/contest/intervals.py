"""Confidence intervals over episodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESAMPLES = 5000
CONFIDENCE = 0.95


def median_interval(values: Array, seed: int) -> tuple[float, float]:
    """Percentile-bootstrap confidence interval of the median over episodes."""
    return _interval(values, np.median, seed)


def mean_interval(values: Array, seed: int) -> tuple[float, float]:
    """Percentile-bootstrap confidence interval of the mean over episodes."""
    return _interval(values, np.mean, seed)


def _interval(values: Array, statistic: Callable, seed: int) -> tuple[float, float]:
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    from scipy.stats import bootstrap

    result = bootstrap(
        (values,), statistic, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
        method="percentile", rng=np.random.default_rng(seed),
    )  # fmt: skip
    interval = result.confidence_interval
    return float(interval.low), float(interval.high)
