"""Blocks of a log, which intervals are from; windows that overlap share theirs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.recording import Recording

Indices = NDArray[np.int64]

LEAST = 10  # blocks, or intervals would hardly hold


def blocks_of(recording: Recording) -> Indices:
    """The block (B, T) of each instant: a window's length of the log, or less for ten of them.

    Windows drawn at random from one log overlap, which the measurements that they share tell:
    what is the same instant of the log is in the same block.
    """
    piece, begin = _places(recording)
    steps = recording.measurement.shape[1]
    place = begin[:, None] + np.arange(steps)
    total = sum(int(np.ptp(place[piece == k])) + 1 for k in range(piece.max() + 1))
    width = min(float(steps), total / LEAST)
    blocks, first = np.zeros(place.shape, np.int64), 0
    for k in range(piece.max() + 1):
        own = piece == k
        _, number = np.unique((place[own] / width).astype(np.int64), return_inverse=True)
        blocks[own] = first + number.reshape(place[own].shape)
        first = int(blocks.max()) + 1
    return blocks


def _places(recording: Recording) -> tuple[Indices, Indices]:
    """For each window the stretch of log (B,) that it is of, and where it begins there (B,)."""
    shifts = _shifts(recording)
    piece, begin = np.full(len(recording), -1), np.zeros(len(recording), np.int64)
    for first in range(len(recording)):
        if piece[first] >= 0:
            continue
        piece[first], waiting = piece.max() + 1, [first]
        while waiting:
            one = waiting.pop()
            for other, shift in shifts[one].items():
                if piece[other] < 0:
                    piece[other], begin[other] = piece[one], begin[one] + shift
                    waiting.append(other)
        own = piece == piece[first]
        begin[own] -= begin[own].min()
    return piece, begin


def _shifts(recording: Recording) -> list[dict[int, int]]:
    """For each window those that share a measurement, and how many instants later they begin."""
    met: dict[bytes, tuple[int, int]] = {}
    shifts: list[dict[int, int]] = [{} for _ in range(len(recording))]
    for b, series in enumerate(recording.measurement):
        for t in np.flatnonzero(~np.isnan(series).all(axis=1)):
            other, then = met.setdefault(series[t].tobytes(), (b, int(t)))
            if other != b:
                shifts[other][b] = then - int(t)
                shifts[b][other] = int(t) - then
    return shifts
