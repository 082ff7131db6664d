"""What a filter said of one log or episode, step by step, as arrays to be written and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.models.yardstick import Yardstick
from kfenv.scenarios.measured import measured_positions
from kfenv.scenarios.recording import Whole

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Estimates:
    """K instants of a filter that may have begun several times.

    Attributes:
        scenario: motion, sensor, frames.
        origin: (3,) where pictures have theirs, in the state's frame.
        time: (K,) by the log's clock, s.
        stretch: (K,) how often the filter had begun, 1 at first.
        step: (K,) filter steps since it began.
        mean: (K, n) of the states.
        covariance: (K, n, n).
        nis: (K,) NaN where nothing arrived.
        channels: (K,) how many arrived.
        factors: (K, F) of the knobs.
        truth: (K, n) true states, NaN where what is scored of them is not known.
        measured: (K, 3) measured positions, east, north and up of the origin, NaN likewise.
        knobs: names of the F that were turned; none of a filter that turns none.
        ended: why the filter stopped before the log did, a sentence each time.
    """

    scenario: Any
    origin: Array
    time: Array
    stretch: Indices
    step: Indices
    mean: Array
    covariance: Array
    nis: Array
    channels: Indices
    factors: Array
    truth: Array
    measured: Array
    knobs: tuple[str, ...]
    ended: tuple[str, ...]

    @property
    def has_position(self) -> bool:
        """Whether what is scored is a position, which has a map."""
        return self.scenario.yardstick == Yardstick.position(self.scenario.motion)

    @property
    def error(self) -> Array:
        """What the yardstick says of the estimate (K,), NaN where the truth is not known."""
        return np.linalg.norm(self.scenario.yardstick.off(self.mean, self.truth), axis=1)

    @property
    def position(self) -> Array:
        """(K, 3) in the state's frame."""
        return self.scenario.yardstick.values(self.mean)

    @property
    def true_position(self) -> Array:
        """(K, 3) in the state's frame."""
        return self.scenario.yardstick.values(self.truth)

    @property
    def spread(self) -> Array:
        """Covariances (K, 3, 3) of the position, east, north and up."""
        place = list(self.scenario.motion.position)
        _, rotation = self.scenario.local_frame(self.origin)
        return rotation @ self.covariance[:, place][:, :, place] @ rotation.T

    @property
    def due(self) -> Indices:
        """The instants at which a measurement is due, whether it arrived or not."""
        return np.flatnonzero(self.step % self.scenario.steps_per_measurement == 0)

    def local(self, position: Array) -> Array:
        """Positions (k, 3) of the state's frame as east, north and up of the origin."""
        return _local(self.scenario, self.origin, position)

    def stretches(self, rows: Indices) -> list[Indices]:
        """Places in rows of instants, those of each stretch by themselves."""
        edges = np.flatnonzero(np.diff(self.stretch[rows])) + 1
        return np.split(np.arange(len(rows)), edges)

    def summary(self) -> dict[str, Any]:
        """How long and consistent it is, and how far off where that is known."""
        arrived = self.channels > 0
        known = self.error[np.isfinite(self.error)]
        return {
            "begin": float(self.time[0]),
            "seconds": float(np.ptp(self.time)),
            "instants": len(self.mean),
            "measurements": int(arrived.sum()),
            "nis": float(np.nansum(self.nis) / max(1, self.channels[~np.isnan(self.nis)].sum())),
            "unit": self.scenario.yardstick.unit,
            "rmse": float(np.sqrt(np.mean(known**2))) if len(known) else None,
            "ended": list(self.ended),
        }


def estimates(
    scenario: Any, whole: Whole, origin: Array, mean: Array, covariance: Array, nis: Array,
    knobs: tuple[str, ...], factors: Array,
) -> Estimates:  # fmt: skip
    """Lay what a filter said at K instants beside the T >= K that it was to go through."""
    recording, count = whole.recording, len(mean)
    arrived = (~np.isnan(recording.measurement[0, :count])).sum(axis=1)
    truth = np.full(mean.shape, np.nan)
    if recording.truth is not None:
        truth = recording.truth[0, :count].copy()
        if recording.scored is not None:
            truth[recording.scored[0, :count] == 0.0] = np.nan
    measured = measured_positions(scenario.sensor, recording.measurement[0, :count])
    if whole.fixes is not None:
        measured = _local(scenario, origin, whole.fixes[:count])
    return Estimates(
        scenario, origin, clock(whole)[:count], np.ones(count, np.int64), np.arange(count), mean,
        covariance, nis, arrived, factors, truth,
        np.full((count, 3), np.nan) if measured is None else measured, knobs, (),
    )  # fmt: skip


def joined(runs: Sequence[Estimates]) -> Estimates:
    """Those of a filter that began anew, in their order."""
    arrays = {
        item.name: np.concatenate([getattr(run, item.name) for run in runs])
        for item in fields(Estimates)[2:-2]
    }
    arrays["stretch"] = np.repeat(np.arange(len(runs)) + 1, [len(run.mean) for run in runs])
    return replace(runs[0], **arrays, ended=tuple(said for run in runs for said in run.ended))


def clock(whole: Whole) -> Array:
    """All instants (T,) by the log's clock, s."""
    times = whole.recording.times[0]
    return whole.begin + (times - times[0])


def _local(scenario: Any, origin: Array, position: Array) -> Array:
    centre, rotation = scenario.local_frame(origin)
    return (position - centre) @ rotation.T
