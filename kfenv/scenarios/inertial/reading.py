"""Reading an inertial log: its two or three files, checked together and set on even instants."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from kfenv.checks import gathered
from kfenv.scenarios.inertial.files import (
    FixLog,
    ImuLog,
    check_together,
    check_truth,
    read_fixes,
    read_imu,
)
from kfenv.scenarios.inertial.log import InertialLog
from kfenv.scenarios.inertial.measured import check_measured, clocks_apart, complain_of_clocks
from kfenv.scenarios.inertial.mounting import check_mounting

MAX_DRIFT = 0.02  # instants from one fix to the next


def read_log(
    paths: tuple[str, ...],
    rate: float,
    mounting: tuple[float, ...] = (0.0, 0.0, 0.0),
    time_offset: float = 0.0,
) -> InertialLog:
    """Read and check an inertial file, a GNSS file and perhaps one with the truth.

    What was read is kept for the next call, until a file changes.

    Args:
        paths: of the two or three files.
        rate: instants per second.
        mounting, time_offset: see `kfenv.scenarios.inertial.files.read_imu`.

    Raises:
        FileNotFoundError: if a file is not there.
        ValueError: naming the file, what is wrong with it, and the remedy.
    """
    stamps = tuple(os.stat(path).st_mtime_ns if os.path.exists(path) else 0 for path in paths)
    return _read(paths, rate, tuple(mounting), time_offset, stamps)


@lru_cache(maxsize=8)
def _read(
    paths: tuple[str, ...], rate: float, mounting: tuple[float, ...], time_offset: float,
    stamps: tuple[int, ...],
) -> InertialLog:  # fmt: skip
    imu, fixes, *more = gathered(
        partial(read_imu, paths[0], mounting, time_offset),
        partial(read_fixes, paths[1]),
        *(partial(read_fixes, path, truth=True) for path in paths[2:]),
    )
    truth = more[0] if more else None
    apart = clocks_apart(imu, fixes)
    aligned = imu if apart is None else replace(imu, time=imu.time - apart.value)
    gathered(
        *([partial(complain_of_clocks, imu, fixes, apart)] if apart is not None else ()),
        partial(check_together, aligned, fixes),
        partial(check_measured, aligned, fixes),
        *(partial(check_truth, known, imu, fixes) for known in more),
        partial(_check_rate, imu, rate),
        partial(_check_period, fixes, rate),
    )
    begin, end = max(imu.time[0], fixes.time[0]), min(imu.time[-1], fixes.time[-1])
    if truth is not None:
        begin, end = max(begin, truth.time[0]), min(end, truth.time[-1])
    time = begin + np.arange(int((end - begin) * rate + 1e-6) + 1) / rate
    total = imu.integral(time)
    samples = np.diff(total, axis=0) * rate
    samples = np.vstack([samples[:1], samples])
    row = np.rint((fixes.time - begin) * rate).astype(np.int64)
    used = np.flatnonzero((row >= 0) & (row < len(time)))
    used = used[np.unique(row[used], return_index=True)[1]]  # one fix an instant
    log = InertialLog(imu, fixes, truth, rate, time, samples, used, row[used])
    check_mounting(log)
    return log


def _check_rate(imu: ImuLog, rate: float) -> None:
    own = 1.0 / float(np.median(np.diff(imu.time)))
    if own < 0.9 * rate:
        raise ValueError(
            f"{imu.path} has {own:.4g} samples per second, but rate={rate:g}: set rate to "
            f"{np.floor(own):g} or less."
        )


def _check_period(fixes: FixLog, rate: float) -> None:
    """Complain if fixes do not come every so many instants, so that they would drift off them."""
    steps = fixes.interval * rate
    if abs(steps - max(1, round(steps))) > max(MAX_DRIFT, 0.001 * steps):
        fitting = max(1, int(steps)) / fixes.interval
        raise ValueError(
            f"{fixes.path} has a fix every {fixes.interval:.6g} s, which is {steps:.4g} instants "
            f"with rate={rate:g}, and must be a whole number: set rate to {fitting:.6g}."
        )


def check_paths(log: object) -> tuple[str, ...]:
    """The paths of a log as a tuple.

    Raises:
        ValueError: if they are not two or three.
    """
    right = isinstance(log, Sequence) and not isinstance(log, str) and 2 <= len(log) <= 3
    if not right or not all(isinstance(path, str) or hasattr(path, "__fspath__") for path in log):
        raise ValueError(
            "log must be the paths of an inertial and a GNSS file, and perhaps of one with the "
            f"truth, got {log!r}."
        )
    return tuple(str(path) for path in log)
