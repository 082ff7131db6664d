"""A hash of recordings: whether a simulation still draws the episodes that it once drew."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]

INSTANTS = 25  # of an episode, evenly spread: what changes at others changes these too
BITS = 26  # of a column's largest magnitude
MISSING = -(2**62)
AT_THE_START = ("mean", "factor")
IN_TIME = (
    "measurement", "noise", "motion_inputs", "sensor_inputs", "truth", "true_noise", "scored",
)  # fmt: skip


def recording_hash(recordings: Iterable[Recording]) -> str:
    """Sixteen hexadecimal digits for recordings, in this order.

    Every number is rounded to 2^-26 of a power of two above the largest in its column (1e-4 m
    of 10 km), far above what platforms differ by in the last bits of sines and logarithms.
    """
    digest = sha256()
    for recording in recordings:
        instants = np.linspace(0, recording.time.shape[-1] - 1, INSTANTS).astype(int)
        arrays = [recording.time[..., None]]
        arrays += [getattr(recording, name) for name in AT_THE_START]
        arrays += [
            value[:, instants]
            for name in IN_TIME
            for value in [getattr(recording, name)]
            if value is not None
        ]
        for array in arrays:
            digest.update(repr(array.shape).encode())
            digest.update(_rounded(array).tobytes())
    return digest.hexdigest()[:16]


def _rounded(array: Array) -> NDArray[np.int64]:
    """Whole numbers (N, C) for an array (..., C), NaN as a number of its own."""
    columns = array.reshape(int(np.prod(array.shape[:-1])), array.shape[-1])
    largest = np.max(np.abs(np.nan_to_num(columns)), axis=0, initial=0.0)
    grid = np.ldexp(1.0, np.frexp(largest)[1] - BITS)
    whole = np.rint(np.nan_to_num(columns) / grid)
    return np.where(np.isnan(columns), MISSING, whole).astype("<i8")
