"""Confidence intervals over episodes, where there are enough for them to cover."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Interval = tuple[float, float] | tuple[None, None]

RESAMPLES = 5000
CONFIDENCE = 0.95
FEWEST = 6  # values: the least and the largest of five hold the median in 94 % of trials
FEW = 30  # values: resampled, fewer of them cover too rarely


def median_interval(values: Array, seed: int) -> Interval:
    """Confidence interval of the median: by order statistics, or of many by the bootstrap.

    None of fewer than `FEWEST` values.
    """
    return _interval(values, np.median, _between_ranks, seed)


def mean_interval(values: Array, seed: int) -> Interval:
    """Confidence interval of the mean: Student's, or of many by the bootstrap.

    None of fewer than `FEWEST` values.
    """
    return _interval(values, np.mean, _students, seed)


def _interval(
    values: Array, statistic: Callable, of_few: Callable[[Array], Interval], seed: int
) -> Interval:
    if len(values) < FEWEST:
        return None, None
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    return of_few(values) if len(values) < FEW else _percentiles(values, statistic, seed)


def _between_ranks(values: Array) -> Interval:
    """Order statistics that hold the median of any distribution in 95 % of trials or more."""
    from scipy.stats import binom

    rank = int(binom.ppf((1.0 - CONFIDENCE) / 2.0, len(values), 0.5))
    ordered = np.sort(values)
    return float(ordered[rank - 1]), float(ordered[-rank])


def _students(values: Array) -> Interval:
    from scipy.stats import sem, t

    low, high = t.interval(CONFIDENCE, len(values) - 1, np.mean(values), sem(values))
    return float(low), float(high)


def _percentiles(values: Array, statistic: Callable, seed: int) -> Interval:
    """Those of the statistic over resamples (the percentile bootstrap)."""
    from scipy.stats import bootstrap

    result = bootstrap(
        (values,), statistic, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
        method="percentile", rng=np.random.default_rng(seed),
    )  # fmt: skip
    interval = result.confidence_interval
    return float(interval.low), float(interval.high)
