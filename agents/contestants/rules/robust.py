"""Rules that answer large innovations by more noise in the measurements that have them.

The robust filters of the literature iterate the update. A knob is turned before it, so the
iteration runs here, on each channel by itself: with noise R the update leaves
nu R / (H P H^T + R) of its innovation and H P H^T R / (H P H^T + R) of its variance, which is
exact where the channels' innovations are independent of each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..agent import Agent, Array, Briefing, Parameter, knob_actions
from .innovation import NOISE, PROCESS_NOISE, share_of_noise, split

REACQUIRE_AFTER = 5  # consecutive rejections, then the gate opens
REJECTED = 1e3  # noise factor of a rejected channel: beyond any knob's range
ITERATIONS = 5


class HuberGate(Agent):
    """Huber weights from the pending innovation, and rejection beyond a gate.

    e = nu / sqrt(S) per channel; the noise variance is divided by w = min(1, k / |e|),
    and the channel rejected where |e| exceeds the gate, until it has been rejected
    five times running.
    """

    parameters = (
        Parameter("threshold", 0.5, 6.0, 1.345),
        Parameter("gate", 3.0, 1000.0, 30.0),
        NOISE,
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._rejections = np.zeros((briefing.batch, len(briefing.sensor.channels)), np.int64)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        scale = self.values["noise"]
        innovation, explained, noise = split(info, scale)
        size = np.nan_to_num(np.abs(innovation) / np.sqrt(explained + noise))
        factor = scale * np.sqrt(np.maximum(1.0, size / self.values["threshold"]))
        rejected = (size > self.values["gate"]) & (self._rejections < REACQUIRE_AFTER)
        arrived, counted = ~np.isnan(innovation), np.where(rejected, self._rejections + 1, 0)
        self._rejections = np.where(arrived, counted, self._rejections)
        factor = np.where(rejected, REJECTED, np.where(arrived, factor, np.nan))
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)


class NisGate(Agent):
    """A measurement rejected as a whole where its NIS is beyond chance, at most five times running.

    NIS = sum nu^2 / S over the channels that arrived, against `gate` times the chi-square
    quantile that one in a hundred exceeds (Bar-Shalom, Li and Kirubarajan 2001, sec 5.4). After
    five rejections running the gate stays open until a measurement lies in it again, so that a
    track that strayed is found. Correlations between the channels' innovations are not seen.
    """

    parameters = (
        Parameter("gate", 0.5, 200.0, 10.0),
        Parameter("noise", 0.05, 50.0, 4.5),
        Parameter("process_noise", 0.05, 200.0, 3.5),
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._rejections = np.zeros(briefing.batch, np.int64)
        channels = np.arange(1, len(briefing.sensor.channels) + 1)
        self._gate = self.values["gate"] * np.append(0.0, chi2.isf(0.01, channels))

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        scale = self.values["noise"]
        innovation, explained, noise = split(info, scale)
        arrived = ~np.isnan(innovation)
        nis = np.nansum(innovation**2 / (explained + noise), axis=1)
        beyond = nis > self._gate[arrived.sum(axis=1)]
        rejected = beyond & (self._rejections < REACQUIRE_AFTER)
        counted = np.where(beyond, self._rejections + 1, 0)
        self._rejections = np.where(arrived.any(axis=1), counted, self._rejections)
        factor = np.where(rejected, REJECTED, scale)[:, None]
        factor = np.where(arrived, factor, np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)


class StudentT(Agent):
    """Noise of a Student-t distribution common to all channels, by variational iteration.

    R / w with w = (v + m) / (v + sum (e^2 + H P+ H^T) / R), e what the update leaves of the
    innovation, three times from w = 1 (Piche, Sarkka and Hartikainen 2012, algorithm 1;
    SPEC 10). Joint: one w for the m channels that arrived.
    """

    parameters = (
        Parameter("freedom", 1.0, 1000.0, 7.96),
        Parameter("noise", 0.05, 50.0, 3.63),
        Parameter("process_noise", 0.05, 200.0, 8.4),
    )

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, noise = split(info, self.values["noise"])
        freedom, arrived = self.values["freedom"], np.sum(~np.isnan(innovation), axis=1)
        weight = np.ones(len(innovation))
        for _ in range(3):
            left = share_of_noise(noise / weight[:, None], explained)
            expected = np.nansum(((innovation * left) ** 2 + explained * left) / noise, axis=1)
            weight = (freedom + arrived) / (freedom + expected)
        factor = np.sqrt(noise / weight[:, None]) / info["noise"]
        factor = np.where(np.isnan(innovation), np.nan, factor)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)


class Correntropy(Agent):
    """The maximum correntropy filter on each channel by itself (Chen, Liu, Zhao and Principe 2017).

    Kernels G = exp(-e^2 / 2 width^2) of the residuals of measurement and prediction, each in
    its deviation, divide R and H P H^T; by fixed-point iteration from G = 1. A knob cannot
    divide the prediction's covariance channel by channel: R gets the ratio of both kernels,
    which gives the same gain; the covariance after the update is that of the nominal P.
    """

    parameters = (Parameter("width", 0.5, 1000.0, 3.0), NOISE, PROCESS_NOISE)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, noise = split(info, self.values["noise"])
        steepness, ratio = 0.5 / self.values["width"] ** 2, np.ones_like(innovation)
        for _ in range(ITERATIONS):
            left = share_of_noise(noise * ratio, explained)
            measured = (innovation * left) ** 2 / noise
            predicted = (innovation * (1.0 - left)) ** 2 / np.maximum(explained, 1e-12 * noise)
            ratio = np.exp(np.clip(steepness * (measured - predicted), -20.0, 20.0))
        factor = np.sqrt(noise * ratio) / info["noise"]
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)
