"""Scores of a contest in numbers: one object per agent for ``results.json``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .intervals import mean_interval, median_interval
from .scores import Scores

Array = NDArray[np.float64]

# The fixed agents, and what a difference or ratio to each is called.
NOMINAL, TUNED = "fixed", "fixed-tuned"


def summarise(
    name: str, scores: Mapping[str, Scores], against: str | None, groups: tuple[str, ...], seed: int
) -> dict[str, Any]:
    """One agent's scores, alone and paired with the others' on the same episodes.

    Args:
        scores: of all agents, by name.
        against: a rival to be compared with as well.
        groups: of channels.
        seed: of the bootstrap.
    """
    own = scores[name]
    summary = _alone(own, groups, seed)
    with np.errstate(divide="ignore", invalid="ignore"):  # an error may be exactly zero
        improvement = 1.0 - own.rmse / scores[NOMINAL].rmse
        ratio = None if against is None else np.log(own.rmse / scores[against].rmse)
    keys = ("improvement_over_fixed", "ci_low", "ci_high")
    summary |= _paired(keys, improvement, np.median, median_interval, seed)
    if TUNED in scores:
        difference = own.rmse - scores[TUNED].rmse
        keys = ("difference_to_fixed_tuned", "difference_ci_low", "difference_ci_high")
        summary |= _paired(keys, difference, np.median, median_interval, seed)
    if ratio is not None:
        keys = ("log_ratio", "log_ratio_ci_low", "log_ratio_ci_high")
        summary |= {"against": against} | _paired(keys, ratio, np.mean, mean_interval, seed)
    return summary


def _paired(
    keys: tuple[str, str, str], values: Array, statistic: Callable, interval: Callable, seed: int
) -> dict[str, float | None]:
    """A statistic of paired values with its interval; None where one of them is no number."""
    if not np.isfinite(values).all():
        return dict.fromkeys(keys)
    return dict(zip(keys, (float(statistic(values)), *interval(values, seed)), strict=True))


def _alone(own: Scores, groups: tuple[str, ...], seed: int) -> dict[str, Any]:
    kept = ~own.lost
    low, high = median_interval(own.rmse, seed)
    with np.errstate(divide="ignore"):
        geometric_mean = float(np.exp(np.mean(np.log(own.rmse))))
    return {
        "rmse": float(own.rmse.mean()),
        "rmse_std": float(own.rmse.std(ddof=1)),
        "rmse_median": float(np.median(own.rmse)),
        "rmse_median_ci_low": low,
        "rmse_median_ci_high": high,
        "rmse_geometric_mean": geometric_mean,
        "rmse_p95": float(np.percentile(own.rmse, 95)),
        "track_loss": float(own.lost.mean()),
        "anees": _mean(own.nees[kept]) if np.isfinite(own.nees[kept]).all() else None,
        "nis": {
            group: _mean(column[np.isfinite(column)])
            for group, column in zip(("all", *groups), own.nis[kept].T, strict=True)
        },
    }


def _mean(values: Array) -> float | None:
    """The mean over episodes, if there are any."""
    return float(np.mean(values)) if len(values) > 0 else None
