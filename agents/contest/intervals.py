"""Confidence intervals over episodes, where there are enough for them to cover."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Interval = tuple[float, float] | tuple[None, None]

RESAMPLES = 5000
BATCH = 10_000_000  # numbers that are resampled at once
CONFIDENCE = 0.95
FEWEST = 6  # values: the least and the largest of five hold the median in 94 % of trials
FEW = 30  # values: resampled, fewer of them cover too rarely
MANY = 20_000  # values: resampling more takes gigabytes, to tell what ranks and Student's t tell


def median_interval(values: Array, seed: int) -> Interval:
    """Confidence interval of the median: of `FEW` to `MANY` values by the bootstrap.

    By order statistics of others, and none of fewer than `FEWEST`.
    """
    return _interval(values, np.median, _between_ranks, seed)


def mean_interval(values: Array, seed: int) -> Interval:
    """Confidence interval of the mean: of `FEW` to `MANY` values by the bootstrap.

    Student's of others, and none of fewer than `FEWEST`.
    """
    return _interval(values, np.mean, _students, seed)


def _interval(
    values: Array, statistic: Callable, of_others: Callable[[Array], Interval], seed: int
) -> Interval:
    if len(values) < FEWEST:
        return None, None
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    if FEW <= len(values) <= MANY:
        return _percentiles(values, statistic, seed)
    return of_others(values)


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
        method="percentile", rng=np.random.default_rng(seed), batch=1 + BATCH // len(values),
    )  # fmt: skip
    interval = result.confidence_interval
    return float(interval.low), float(interval.high)
