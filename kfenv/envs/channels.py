"""What single channels tell beside the others: for agents that turn a knob for each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.statistics import BOUND
from kfenv.filters.matrices import cholesky
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Update
from kfenv.models.model import Sensor
from kfenv.models.namespaces import batch as numpy_batch

Array = NDArray[np.float64]

WINDOWS = (10.0, 30.0)  # of the means, in arrivals; the first one also serves the RMS
PER_CHANNEL = len(WINDOWS) + 3
AXES = 3  # as many channels of a group are told one by one


class Channels:
    """The pending innovations of B filters, each channel's seen beside all others.

    Args:
        scenario: gives the sensor.
        chosen: (K,) the channels whose knobs are exposed, those that are observed.
        batch: B.
        kappa: of the filter's sigma points.
    """

    def __init__(self, scenario: Any, chosen: NDArray[np.int64], batch: int, kappa: float) -> None:
        self._spread = np.sqrt(len(scenario.motion.states) + kappa)
        channels = scenario.sensor.channels
        self._chosen, self._names = chosen, [channels[c].name for c in chosen]
        self._measure = scenario.sensor.build(numpy_batch)
        self._angle = np.array([channel.angle for channel in channels])
        self.covariance = np.zeros((batch, len(channels), len(channels)))
        self._beside = np.full((batch, len(channels)), np.nan)
        self._mean = np.zeros((batch, len(channels), len(WINDOWS)))
        self._square = np.ones((batch, len(channels)))

    def restart(self, chosen: NDArray[np.int64]) -> None:
        """Forget the episodes of these filters."""
        self._mean[chosen] = 0.0
        self._square[chosen] = 1.0

    def collect(self, pending: Update, told: Measurement, active: NDArray[np.bool_]) -> None:
        """Take the pending innovations of the active filters into the statistics."""
        missing = np.isnan(pending.innovation)
        self._beside[active] = np.nan
        self.covariance[active] = 0.0
        heard = np.flatnonzero(active & ~missing.all(axis=1))
        if not len(heard):
            return
        self.covariance[heard] = self.covariances(pending, told, missing, heard)
        residual, deviation = beside_others(pending.innovation[heard], self.covariance[heard])
        self._beside[heard] = residual / deviation
        arrived, value = ~np.isnan(self._beside), np.nan_to_num(self._beside)
        arrived &= active[:, None]
        step = (value[..., None] - self._mean) / np.array(WINDOWS)
        self._mean += np.where(arrived[..., None], step, 0.0)
        self._square += np.where(arrived, (value**2 - self._square) / WINDOWS[0], 0.0)

    def covariances(
        self, pending: Update, told: Measurement, missing: NDArray[np.bool_], heard: NDArray
    ) -> Array:
        """Of the innovations (H, m, m) at the places heard, see `innovation_covariance`."""
        return innovation_covariance(
            self._measure, self._angle, self._spread, *(x[heard] for x in (
                pending.mean, pending.factor, told.inputs, pending.variance, told.noise, missing)),
        )  # fmt: skip

    def observe(self, pends: NDArray[np.bool_]) -> Array:
        """The features (B, K PER_CHANNEL) of the exposed channels."""
        now = np.where(pends[:, None], self._beside, np.nan)[:, self._chosen]
        mean, square = self._mean[:, self._chosen], self._square[:, self._chosen]
        signed = [np.nan_to_num(now), *np.moveaxis(mean, -1, 0)]
        features = [np.sign(value) * np.log1p(np.abs(value)) for value in signed]
        features += [0.5 * np.log(square + 1e-4), ~np.isnan(now)]
        stacked = np.stack(features, axis=-1).reshape(len(now), -1)
        return np.clip(stacked, -BOUND, BOUND)

    def state(self) -> dict[str, Array]:
        """What is remembered, by name: arrays (B, ...) to be read or set."""
        return {"channel_mean": self._mean, "channel_square": self._square}

    def feature_names(self) -> Sequence[str]:
        """What each of them is."""
        return [f"{name} beside the others: {what}" for name in self._names
                for what in channel_features()]  # fmt: skip


def channel_features() -> tuple[str, ...]:
    """What is told of each channel's v."""
    return (
        "sign(v) log(1 + abs(v))",
        *(f"the same of its mean over {window:g} arrivals" for window in WINDOWS),
        f"log of its RMS over {WINDOWS[0]:g}",
        "whether the channel arrived",
    )


def told_channels(sensor: Sensor) -> str:
    """The channels in words, group by group, with their units."""
    told = []
    for group in sensor.groups:
        channels = [channel for channel in sensor.channels if channel.group == group]
        names, unit = [channel.name for channel in channels], channels[0].unit
        if len(names) <= AXES:
            told.append(f"{', '.join(names)} ({unit})")
        else:
            told.append(f"{names[0]} to {names[-1]} ({group}, {unit})")
    return ", ".join(told)


def innovation_covariance(
    measure: Any, angle: NDArray[np.bool_], spread: float, mean: Array, factor: Array,
    inputs: Array, variance: Array, noise: Array, missing: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """The covariance (B, m, m) of the innovations, zero in rows and columns of missing channels.

    H P H^T with H by statistical linearisation at the filter's sigma points; on the diagonal the
    filter's own variance, with noise and curvature. Positive definite whatever the filter: what
    its variance has beyond H P H^T counts as the noise at least.

    Args:
        measure: the sensor's function for arrays.
        angle: (m,) which channels are angles.
        spread: of the sigma points, in deviations.
        mean, factor: (B, n), (B, n, n) of the predicted state.
        inputs: (B, k) of the sensor.
        variance: (B, m) of the innovations.
        noise: (B, m) deviations that the filter is told.
        missing: (B, m) which channels did not arrive.
    """
    known = tuple(inputs.T[..., None])
    points = ((mean[..., None] + side * factor).swapaxes(0, 1) for side in (spread, -spread))
    high, low = (np.broadcast_arrays(*measure(tuple(states), known)) for states in points)
    slope = np.stack(high, axis=1) - np.stack(low, axis=1)
    slope[:, angle] = np.arctan2(np.sin(slope[:, angle]), np.cos(slope[:, angle]))
    slope[missing] = 0.0
    slope /= 2.0 * spread
    covariance = slope @ slope.transpose(0, 2, 1)
    places = np.arange(covariance.shape[1])
    rest = np.maximum(variance - covariance[:, places, places], noise**2)
    covariance[:, places, places] += np.where(missing, 0.0, rest)
    return covariance


def beside_others(innovation: Array, covariance: Array) -> tuple[Array, Array]:
    """What of each innovation (B, m) the other channels do not explain, and its deviation.

    (S^-1 nu)_i / (S^-1)_ii and 1 / sqrt((S^-1)_ii): their ratio is the w-test of Baarda (1968),
    standard normal where nothing is wrong. NaN in channels that are missing.
    """
    missing = np.isnan(innovation)
    scale = np.sqrt(np.where(missing, 1.0, np.diagonal(covariance, axis1=1, axis2=2)))
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    places = np.arange(covariance.shape[1])
    correlation[:, places, places] = 1.0
    eye = np.broadcast_to(np.eye(len(places)), correlation.shape)
    root = np.linalg.solve(cholesky(correlation), eye)
    whitened = root @ (np.where(missing, 0.0, innovation) / scale)[..., None]
    weight = np.sum(root**2, axis=1)
    residual, deviation = scale * np.sum(root * whitened, axis=1) / weight, scale / np.sqrt(weight)
    return tuple(np.where(missing, np.nan, value) for value in (residual, deviation))
