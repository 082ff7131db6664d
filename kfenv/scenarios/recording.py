"""The Recording: everything random about a batch of episodes, as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class FaultInterval(NamedTuple):
    """A labelled stretch of an episode, seconds."""

    label: str
    start: float
    stop: float


@dataclass(frozen=True, eq=False)
class Recording:
    """B episodes of T instants; float64, SI units, radians.

    The first instant is an update of the initial state without a prediction. A
    motion input at index t drives the step from t - 1 to t.

    Attributes:
        time: (T,), increasing, or (B, T) where each episode has its own times.
        measurement: (B, T, m), NaN where nothing arrived.
        noise: (B, T, m) standard deviations that the filter is told.
        mean, factor: initial state (B, n) and lower factor of its covariance (B, n, n).
        motion_inputs, sensor_inputs: known inputs (B, T, p), (B, T, k).
        truth: (B, T, n), or None for a real log without one.
        true_noise: (B, T, m) standard deviations the noise was drawn with, or None.
        true_bias: (B, T, m) errors of single channels that are no noise, or None.
        scored: (B, T) one where the truth counts in scores and zero where it is only a guess
            to be drawn; None if it counts everywhere.
        faults: for each episode its labelled intervals.

    Raises:
        ValueError: if a shape is wrong, times do not increase, a noise is not
            positive, or NaN stands anywhere but in `measurement`.
    """

    time: Array
    measurement: Array
    noise: Array
    mean: Array
    factor: Array
    motion_inputs: Array
    sensor_inputs: Array
    truth: Array | None = None
    true_noise: Array | None = None
    true_bias: Array | None = None
    scored: Array | None = None
    faults: tuple[tuple[FaultInterval, ...], ...] = ()

    def __post_init__(self) -> None:
        for field in fields(self)[:-1]:
            value = getattr(self, field.name)
            if value is not None:
                # A view, so that the array given stays as writeable as it was.
                value = np.ascontiguousarray(value, dtype=np.float64).view()
                value.flags.writeable = False
                object.__setattr__(self, field.name, value)
        if not self.faults:
            object.__setattr__(self, "faults", ((),) * len(self.measurement))
        self._check_shapes()
        self._check_values()

    def __len__(self) -> int:
        return len(self.measurement)

    def __getitem__(self, episodes: slice | Sequence[int] | NDArray) -> Recording:
        """The chosen episodes, as a Recording."""
        chosen = np.arange(len(self))[episodes]
        if chosen.ndim == 0:
            chosen = chosen[None]
        arrays = {
            field.name: value if value is None or value.ndim == 1 else value[chosen]
            for field in fields(self)[:-1]
            for value in [getattr(self, field.name)]
        }
        return Recording(**arrays, faults=tuple(self.faults[i] for i in chosen))

    @property
    def times(self) -> Array:
        """The instants (B, T) of each episode."""
        return np.broadcast_to(self.time, self.measurement.shape[:2])

    @property
    def scored_instants(self) -> Array:
        """Number of instants (B,) at which the truth counts."""
        if self.scored is None:
            return np.full(len(self), float(self.time.shape[-1]))
        return self.scored.sum(axis=1)

    def _check_shapes(self) -> None:
        if self.measurement.ndim != 3 or self.mean.ndim != 2:
            raise ValueError(
                "A Recording is batch first: measurement must have shape (episodes, times, "
                f"channels) and mean (episodes, states), got {self.measurement.shape} and "
                f"{self.mean.shape}."
            )
        batch, steps, m = self.measurement.shape
        n = self.mean.shape[1]
        expected = {
            "time": (steps,) if self.time.ndim == 1 else (batch, steps),
            "noise": (batch, steps, m),
            "mean": (batch, n),
            "factor": (batch, n, n),
            "motion_inputs": (batch, steps, None),
            "sensor_inputs": (batch, steps, None),
            "truth": (batch, steps, n),
            "true_noise": (batch, steps, m),
            "true_bias": (batch, steps, m),
            "scored": (batch, steps),
        }
        for name, shape in expected.items():
            value = getattr(self, name)
            if value is None:
                continue
            right = len(value.shape) == len(shape) and all(
                want in (None, have) for want, have in zip(shape, value.shape, strict=True)
            )
            if not right:
                raise ValueError(
                    f"Recording.{name} has shape {value.shape}, but the measurement's "
                    f"{self.measurement.shape} and {n} states call for {shape}."
                )
        if batch == 0 or steps < 2:
            raise ValueError("A Recording needs at least one episode and two times.")
        if len(self.faults) != batch:
            raise ValueError(
                f"Recording.faults lists {len(self.faults)} episodes, the measurement {batch}."
            )

    def _check_values(self) -> None:
        if not np.all(np.diff(self.time) > 0.0):
            raise ValueError("Recording.time must increase strictly: drop duplicate times.")
        finite = ("time", "noise", "mean", "factor", "motion_inputs", "truth", "true_noise")
        for name in (*finite, "true_bias", "scored"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                raise ValueError(
                    f"Recording.{name} holds NaN or infinity; only `measurement` and the sensor "
                    "inputs of missing channels may hold NaN."
                )
        if np.isinf(self.measurement).any():
            raise ValueError("Recording.measurement holds infinity; mark what is missing by NaN.")
        if self.scored is not None and not np.all((self.scored == 0.0) | (self.scored == 1.0)):
            raise ValueError("Recording.scored must hold nothing but ones and zeros.")
        for name in ("noise", "true_noise"):
            value = getattr(self, name)
            if value is not None and not (value > 0.0).all():
                raise ValueError(
                    f"Recording.{name} must be positive everywhere: it holds standard deviations."
                )
        diagonal = np.diagonal(self.factor, axis1=1, axis2=2)
        if np.any(np.triu(self.factor, 1)) or not np.all(diagonal > 0.0):
            raise ValueError(
                "Recording.factor must be lower triangular with a positive diagonal: "
                "give the Cholesky factor of the initial covariance."
            )


class Whole(NamedTuple):
    """All of a real log as one episode, from where a filter can begin; nothing is withheld.

    Attributes:
        recording: of the one episode; it has a truth where one was told.
        begin: its first instant by the log's clock, s.
        fixes: (T, 3) positions solved from the measurements, in the state's frame, NaN where
            there is none; None where the sensor's channels tell them.
    """

    recording: Recording
    begin: float
    fixes: Array | None = None


def stack(recordings: Sequence[Recording]) -> Recording:
    """Join recordings over the same times into one batch.

    Raises:
        ValueError: if there is none, their times differ, or some lack what others have.
    """
    if not recordings:
        raise ValueError("stack needs at least one Recording.")
    first = recordings[0]
    if len(recordings) == 1:
        return first
    if any(not np.array_equal(first.time, other.time) for other in recordings[1:]):
        raise ValueError("Recordings with different times cannot be stacked.")
    joined = {}
    for field in fields(Recording)[1:-1]:
        values = [getattr(recording, field.name) for recording in recordings]
        if len({value is None for value in values}) > 1:
            raise ValueError(
                f"Recordings with and without {field.name} cannot be stacked: drop it from all."
            )
        joined[field.name] = None if values[0] is None else np.concatenate(values)
    faults = tuple(intervals for recording in recordings for intervals in recording.faults)
    return Recording(first.time, **joined, faults=faults)
