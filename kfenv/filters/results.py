"""What the filters of both tiers return, and how a failure is told."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OK, BAD_PREDICTION, BAD_INNOVATION, BAD_UPDATE, NOT_POSITIVE_DEFINITE = range(5)
FAILURES = (
    "",
    "the prediction is not finite: the state has left the motion model's domain",
    "the innovation is not finite: check the measurement and its noise",
    "the updated state is not finite: the innovation covariance is singular",
    "the covariance is no longer positive definite: choose a square-root Joseph form",
)


class Prediction(NamedTuple):
    """Predicted state; its covariance is root root^T + noise noise^T until the knobs are set."""

    mean: Array  # (B, n)
    root: Array  # (B, n, n) lower factor of the propagated covariance
    noise: Array  # (B, n, n) lower factor of the discrete process noise


class Update(NamedTuple):
    """A state and what the measurement said of it; NaN in channels that are missing."""

    mean: Array  # (B, n)
    factor: Array  # (B, n, n) lower factor of the covariance
    innovation: Array  # (B, m)
    variance: Array  # (B, m) diagonal of the innovation covariance
    whitened: Array  # (B, m) C^-1 innovation, C the innovation factor of the channels present
    nis: Array  # (B,) normalised innovation squared, NaN if nothing arrived
    log_likelihood: Array  # (B,) of the innovation, 0 if nothing arrived


class Run(NamedTuple):
    """A filter run over whole recordings with constant knobs."""

    mean: Array  # (B, T, n) posterior means, NaN from a failure on
    nis: Array  # (B, T)
    status: NDArray[np.int64]  # (B,) 0, or an index of FAILURES
    failed_at: NDArray[np.int64]  # (B,) time index of the failure, -1 if none


class History(NamedTuple):
    """A `Run` with the posterior covariances; NaN from a failure on."""

    mean: Array  # (B, T, n)
    nis: Array  # (B, T)
    status: NDArray[np.int64]  # (B,)
    failed_at: NDArray[np.int64]  # (B,)
    covariance: Array  # (B, T, n, n)
    factor: Array | None  # (B, T, n, n) lower factors, None where the filter carries none


def blame(status: NDArray[np.int64], code: int, *results: Array) -> None:
    """Set the status of the filters, so far sound, whose results (B, ...) are not finite."""
    for result in results:
        broken = ~np.isfinite(result.reshape(len(status), -1)).all(axis=1)
        status[broken & (status == OK)] = code


def describe_failures(status: NDArray[np.int64], failed_at: NDArray[np.int64]) -> list[str]:
    """One sentence per failed filter: which one, when and why."""
    return [
        f"Filter {b} failed at time index {failed_at[b]}: {FAILURES[status[b]]}."
        for b in np.flatnonzero(status)
    ]
