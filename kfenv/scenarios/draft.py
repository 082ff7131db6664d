"""An episode before its measurements are drawn: what faults change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.recording import FaultInterval

Array = NDArray[np.float64]


@dataclass
class Draft:
    """An episode of T instants and m channels before its measurements are drawn.

    That of many episodes has arrays with the episodes in front (but for the time), and a list
    of intervals for each.

    Attributes:
        time: (T,) s.
        noise_factor: (T, m) multiplies the noise that is drawn.
        told_factor: (T, m) multiplies the noise that the filter is told.
        available: (T, m) whether the channel arrives.
        exact: (T, m) the measurements without noise; a fault may add errors of its own.
        bias: (T, m) those of these errors that are single channels' own: told to the
            clairvoyant, and not added to anything.
        motion_inputs, sensor_inputs: (T, p), (T, k) the inputs as the filter is told them.
        intervals: what happened when.
    """

    time: Array
    noise_factor: Array
    told_factor: Array
    available: NDArray[np.bool_]
    exact: Array
    bias: Array
    motion_inputs: Array
    sensor_inputs: Array
    intervals: list[FaultInterval] = field(default_factory=list)

    @classmethod
    def clean(cls, time: Array, channels: int, **more: object) -> Draft:
        """An episode without faults; measurements of zero and no inputs unless given."""
        lead = np.shape(more.get("exact", ()))[:-2]
        shape, none = (*lead, len(time), channels), np.empty((*lead, len(time), 0))
        given = {
            "exact": np.zeros(shape), "bias": np.zeros(shape), "motion_inputs": none,
            "sensor_inputs": none, "intervals": [[] for _ in range(lead[0])] if lead else [],
        }  # fmt: skip
        return cls(time, np.ones(shape), np.ones(shape), np.ones(shape, bool), **given | more)

    def episodes(self) -> Iterator[Self]:
        """Each episode of many in turn, whose arrays are views, to be changed until the next."""
        arrays = self._arrays()
        for i, intervals in enumerate(self.intervals):
            views = {name: array[i] for name, array in arrays.items()}
            one = object.__new__(type(self))
            vars(one).update(vars(self), intervals=intervals, **views)
            yield one
            for name, view in views.items():
                if getattr(one, name) is not view:
                    arrays[name][i] = getattr(one, name)

    def alone(self) -> Self:
        """This one episode as the only one of many; its arrays are views."""
        views = {name: array[None] for name, array in self._arrays().items()}
        return replace(self, intervals=[self.intervals], **views)

    def _arrays(self) -> dict[str, Array]:
        return {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray) and k != "time"}

    def misplace(self, inside: slice, channels: slice, error: Array) -> None:
        """Add errors (t, c) to channels' measurements of a time, and note them as a bias."""
        self.exact[inside, channels] += error
        self.bias[inside, channels] += error

    def window(self, label: str, start: float, duration: float) -> slice:
        """Label the interval, as far as it lies in the episode, and return its time indices."""
        stop = start + duration
        inside = slice(*self.time.searchsorted((start, stop)))
        if inside.stop > inside.start:
            first, last = max(start, self.time[0]), min(stop, self.time[-1])
            self.intervals.append(FaultInterval(label, float(first), float(last)))
        return inside

    def throughout(self, label: str) -> None:
        """Label the whole episode."""
        self.intervals.append(FaultInterval(label, float(self.time[0]), float(self.time[-1])))

    def windows(
        self, label: str, start: Array, duration: Array, episode: Sequence[int] | None = None
    ) -> list[tuple[int, slice]]:
        """Label intervals (N,) of many episodes, as far as they lie in them.

        Args:
            episode: (N,) to which each belongs; None for one of each.

        Returns:
            Each one's episode and time indices.
        """
        episode = range(len(start)) if episode is None else episode
        stop = start + duration
        inside = self.time.searchsorted((start, stop)).T.tolist()
        first, last = np.maximum(start, self.time[0]), np.minimum(stop, self.time[-1])
        windows = []
        for i, *ends, (begin, end) in zip(
            episode, first.tolist(), last.tolist(), inside, strict=True
        ):
            windows.append((i, slice(begin, end)))
            if end > begin:
                self.intervals[i].append(FaultInterval(label, *ends))
        return windows

    def each_throughout(self, label: str, which: Sequence[bool] | None = None) -> None:
        """Label the whole of many episodes, or of those that are chosen."""
        interval = FaultInterval(label, float(self.time[0]), float(self.time[-1]))
        for i, intervals in enumerate(self.intervals):
            if which is None or which[i]:
                intervals.append(interval)


def split(values: Array) -> tuple[Array, ...]:
    """Views (...) of the parts along the last axis."""
    return tuple(values[..., i] for i in range(values.shape[-1]))
