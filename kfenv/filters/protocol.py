"""The contract that every filter keeps, and the records that go into it; see `results` for out."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.results import Prediction, Run, Update
from kfenv.models.model import Motion, Sensor

Array = NDArray[np.float64]
Status = NDArray[np.int64]


class Knobs(NamedTuple):
    """Variance factors: the predicted covariance is fading F P F^T + process_scale Q."""

    fading: Array  # (B,)
    process_scale: Array  # (B,)

    @classmethod
    def nominal(cls, batch: int) -> Knobs:
        """Factors of one: the plain filter."""
        ones = np.ones(batch)
        return cls(ones, ones)


class Measurement(NamedTuple):
    """What arrives at one instant."""

    inputs: Array  # (B, k) known inputs of the sensor
    value: Array  # (B, m), NaN where nothing arrived
    noise: Array  # (B, m) standard deviations that the filter is told


class Episodes(Protocol):
    """B episodes of T instants to be filtered; a `kfenv.scenarios.recording.Recording` is one.

    The first instant is an update of the initial state without a prediction. A motion
    input at index t drives the step from t - 1 to t.
    """

    @property
    def time(self) -> Array:
        """Increasing, (T,), or each episode's own (B, T)."""

    @property
    def mean(self) -> Array:
        """Of the state at the first instant, (B, n)."""

    @property
    def factor(self) -> Array:
        """Lower factor of its covariance, (B, n, n)."""

    @property
    def motion_inputs(self) -> Array:
        """Known inputs of the motion, (B, T, p)."""

    @property
    def sensor_inputs(self) -> Array:
        """Known inputs of the sensor, (B, T, k)."""

    @property
    def measurement(self) -> Array:
        """Measured values, (B, T, m), NaN where nothing arrived."""

    @property
    def noise(self) -> Array:
        """Standard deviations that the filter is told, (B, T, m)."""


def measured(episodes: Episodes, t: int) -> Measurement:
    """What arrives at the instant of index t: copies, since an episode's own are read-only."""
    series = episodes.sensor_inputs, episodes.measurement, episodes.noise
    return Measurement(*(array[:, t].copy() for array in series))


def elapsed(episodes: Episodes) -> Array:
    """Seconds (B, T) since the instant before, zero at the first."""
    passed = np.diff(episodes.time, axis=-1, prepend=episodes.time[..., :1])
    return np.broadcast_to(passed, episodes.measurement.shape[:2])


class Filter(Protocol):
    """A batch of filters for one motion and one sensor.

    All arrays are float64 (a `ReferenceFilter` may be told float32) and batch first: means
    (B, n), lower factors (B, n, n), measurements (B, m) with NaN where nothing arrived. A
    filter that fails sets its entry of ``status`` (see `kfenv.filters.results.FAILURES`), its
    outputs are then meaningless, and the others do not notice.
    """

    motion: Motion
    sensor: Sensor

    def predict(
        self, mean: Array, factor: Array, inputs: Array, dt: Array, status: Status
    ) -> Prediction:
        """Time update over dt (B,) with known inputs of the motion (B, p)."""

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """Form the innovation and stop there: mean and factor are the predicted ones.

        The predicted covariance is fading root root^T + process_scale noise noise^T.
        """

    def update(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """Measurement update of what `innovate` returns."""

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """Filter whole episodes with constant knobs, nominal unless told otherwise."""
