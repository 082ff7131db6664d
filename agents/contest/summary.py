"""Scores of a contest in numbers: one object per agent for ``results.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .intervals import mean_interval, median_interval
from .scores import Scores

Array = NDArray[np.float64]

# The yardsticks, and what a difference or ratio to each is called.
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
    improvement = 1.0 - own.rmse / scores[NOMINAL].rmse
    summary["improvement_over_fixed"] = float(np.median(improvement))
    summary["ci_low"], summary["ci_high"] = median_interval(improvement, seed)
    if TUNED in scores:
        difference = own.rmse - scores[TUNED].rmse
        low, high = median_interval(difference, seed)
        summary["difference_to_fixed_tuned"] = float(np.median(difference))
        summary["difference_ci_low"], summary["difference_ci_high"] = low, high
    if against is not None:
        ratio = np.log(own.rmse / scores[against].rmse)
        low, high = mean_interval(ratio, seed)
        summary |= {"against": against, "log_ratio": float(np.mean(ratio))}
        summary["log_ratio_ci_low"], summary["log_ratio_ci_high"] = low, high
    return summary


def _alone(own: Scores, groups: tuple[str, ...], seed: int) -> dict[str, Any]:
    kept = ~own.lost
    low, high = median_interval(own.rmse, seed)
    return {
        "rmse": float(own.rmse.mean()),
        "rmse_std": float(own.rmse.std(ddof=1)),
        "rmse_median": float(np.median(own.rmse)),
        "rmse_median_ci_low": low,
        "rmse_median_ci_high": high,
        "rmse_geometric_mean": float(np.exp(np.mean(np.log(own.rmse)))),
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
