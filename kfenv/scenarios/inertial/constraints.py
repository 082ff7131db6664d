"""Vehicle constraints along a real log: when they hold, and what is then measured of nothing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kfenv.models.vehicle_constraints import CHANNELS, NON_HOLONOMIC, ZERO_RATE
from kfenv.scenarios.inertial.log import InertialLog
from kfenv.scenarios.windows import PARTS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

SPAN = 1.0  # s of samples that tell whether the vehicle stands
ENOUGH = 20  # fixes of either kind
APART = 3.0  # times as lively: with less, rest and motion cannot be told apart


def pseudo_measurements(log: InertialLog, rows: Indices, names: Sequence[str]) -> Array:
    """What the channels (T, k) of constraints measure at a window's instants, NaN where nothing.

    They are due where fixes are, whether or not one arrives; those of a vehicle that stands
    only where it does, by the samples alone.
    """
    channels = sum(len(CHANNELS[name]) for name in names)
    value = np.full((len(rows), channels), np.nan)
    due = np.zeros(len(rows), bool)
    due[log.steps_per_fix :: log.steps_per_fix] = True
    standing = due & stands(log)[rows] if tuple(names) != (NON_HOLONOMIC,) else due
    begin = 0
    for name in names:
        columns = slice(begin, begin + len(CHANNELS[name]))
        holds = due if name == NON_HOLONOMIC else standing
        value[holds, columns] = _mean(log)[rows[holds], 3:] if name == ZERO_RATE else 0.0
        begin = columns.stop
    return value


@lru_cache(maxsize=4)
def stands(log: InertialLog) -> Mask:
    """Whether the vehicle stands, (K,): its samples are as quiet as where the fixes say so.

    How quiet that is, the part of the log for training tells; nowhere, if the vehicle does not
    stand there long enough, or shakes as much as when it drives.
    """
    shaking = _shaking(log)
    learnt = log.row < PARTS["tuning"][1] * len(log.time)
    speed = np.linalg.norm(log.fixes.velocity[log.used], axis=1)
    kinds = log.fixes.stands[log.used], speed > log.fixes.moving
    still, moving = (log.row[learnt & kind] for kind in kinds)
    if min(len(still), len(moving)) < ENOUGH:
        return np.zeros(len(log.time), bool)
    relative = (shaking / np.median(shaking[still], axis=0)).max(axis=1)
    quiet, lively = np.median(relative[still]), np.percentile(relative[moving], 5.0)
    return relative < np.sqrt(quiet * lively) * (lively > APART * quiet)


def _shaking(log: InertialLog) -> Array:
    """Deviations (K, 2) of the specific force and of the angular rate in the last second."""
    # about the whole log's mean, so that no digits are lost
    centred = log.samples - log.samples.mean(axis=0)
    variance = _trailing(centred**2, log.rate) - _trailing(centred, log.rate) ** 2
    total = variance.reshape(-1, 2, 3).sum(axis=2)
    return np.sqrt(np.maximum(total, 1e-16))


@lru_cache(maxsize=4)
def _mean(log: InertialLog) -> Array:
    return _trailing(log.samples, log.rate)


def _trailing(series: Array, rate: float) -> Array:
    """Means (K, k) over the last second; over less where the log begins."""
    total = np.cumsum(np.vstack([np.zeros(series.shape[1]), series]), axis=0)
    end = np.arange(1, len(series) + 1)
    begin = np.maximum(end - max(2, round(SPAN * rate)), 0)
    return (total[end] - total[begin]) / (end - begin)[:, None]
