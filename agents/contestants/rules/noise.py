"""Rules that learn the noise of the measurements from the innovations that they have met.

The learning rules of the literature use the update's residuals; as in `robust` they are
found here before it, on each channel by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..agent import Agent, Array, Briefing, Parameter, knob_actions
from .innovation import PROCESS_NOISE, share_of_noise, split

ITERATIONS = 5
LOWEST, HIGHEST = 0.04, 1e4  # variance of the noise over the told one


class InnovationNoise(Agent):
    """Measurement noise from the innovations' running mean square, behind an outlier gate.

    Per channel C <- C + (min(nu^2, g^2 S') - C) / window with S' = H P H^T + R', and
    R' = C - H P H^T, kept within [R / 25, 10^4 R]. An innovation beyond the gate g has its
    own noise raised until it lies on the gate.
    """

    parameters = (
        Parameter("window", 2.0, 100.0, 10.0),
        Parameter("gate", 1.5, 10.0, 3.0),
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._mean_square = np.full((briefing.batch, len(briefing.sensor.channels)), np.nan)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, told = split(info)
        squared, gate = innovation**2, self.values["gate"] ** 2
        before = np.where(np.isnan(self._mean_square), told + explained, self._mean_square)
        believed = explained + self._noise(before, explained, told)
        step = (np.minimum(squared, gate * believed) - before) / self.values["window"]
        arrived = ~np.isnan(squared)
        self._mean_square = np.where(arrived, before + step, self._mean_square)
        noise = self._noise(before + step, explained, told)
        noise = np.maximum(noise, squared / gate - explained)
        factor = np.where(arrived, np.sqrt(noise / told), np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)

    @staticmethod
    def _noise(mean_square: Array, explained: Array, told: Array) -> Array:
        return np.clip(mean_square - explained, LOWEST * told, HIGHEST * told)


class PooledNoise(Agent):
    """One level of the noise for all channels, and a slow scale of each channel's own.

    R = r s F with told variance r, h = R / (a + R), a = H P H^T, m = min(nu^2, g^2 (a + R)),
    e = (m - a) / R, rho = sum h^2 e / sum h^2:
    F *= 1 + mean h^2 (rho - 1) / w_fast, s *= 1 + h^2 (e - rho) / w_slow, and R is raised until
    the innovation lies on the gate g (CONTEST section 2).
    """

    parameters = (
        Parameter("gate", 1.5, 10.0, 2.45),
        Parameter("fast_window", 1.0, 30.0, 2.02),
        Parameter("slow_window", 3.0, 300.0, 35.3),
        Parameter("process_noise", 0.05, 200.0, 5.41),
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._level = np.ones((briefing.batch, 1))
        self._scale = np.ones((briefing.batch, len(briefing.sensor.channels)))

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, told = split(info)
        gate, arrived = self.values["gate"] ** 2, ~np.isnan(innovation)
        noise = told * self._scale * self._level
        squared = np.minimum(innovation**2, gate * (explained + noise))
        share = np.where(arrived, share_of_noise(noise, explained) ** 2, 0.0)
        excess = np.where(arrived, (squared - explained) / noise, 1.0)
        total = np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        common = (share * excess).sum(axis=1, keepdims=True) / total
        count = np.maximum(arrived.sum(axis=1, keepdims=True), 1)
        self._level *= 1.0 + total / count * (common - 1.0) / self.values["fast_window"]
        self._scale *= 1.0 + share * (excess - common) / self.values["slow_window"]
        self._level = np.clip(self._level, LOWEST, HIGHEST)
        self._scale = np.clip(self._scale, LOWEST, 1.0 / LOWEST)
        noise = np.maximum(told * self._scale * self._level, innovation**2 / gate - explained)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], np.sqrt(noise / told))


class SageHusa(Agent):
    """The noise estimator of Sage and Husa (1969), in residual form, which keeps it positive.

    R <- (1 - d) R + d (e^2 + H P+ H^T) with d = (1 - b) / (1 - b^k) at the k-th arrival, e what
    the update leaves of the innovation (SPEC 10); learnt from the pending innovation, so that
    its own update has the new R already. R is kept relative to the told variance.
    """

    parameters = (Parameter("forgetting", 0.5, 0.999, 0.95), PROCESS_NOISE)

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._ratio = np.ones((briefing.batch, len(briefing.sensor.channels)))
        self._arrivals = np.zeros(self._ratio.shape)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, told = split(info)
        arrived, b = ~np.isnan(innovation), self.values["forgetting"]
        self._arrivals += arrived
        gain = (1.0 - b) / (1.0 - b ** (self._arrivals + 1.0))
        left = share_of_noise(told * self._ratio, explained)
        learnt = ((innovation * left) ** 2 + explained * left) / told
        learnt = np.clip((1.0 - gain) * self._ratio + gain * learnt, LOWEST, HIGHEST)
        self._ratio = np.where(arrived, learnt, self._ratio)
        factor = np.where(arrived, np.sqrt(self._ratio), np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)


class VbNoise(Agent):
    """The variational Bayes filter with an inverse-gamma noise (Sarkka and Nummenmaa 2009).

    Per channel a <- rho a, b <- rho b; a <- a + 1/2; then five times R = b / a and
    b <- b- + e^2 / 2 + H P+ H^T / 2 with e and P+ of the update with that R, the last of which
    the filter makes. b is kept relative to the told variance; R is r at the beginning.
    """

    parameters = (
        Parameter("forgetting", 0.5, 0.999, 0.951),
        Parameter("shape", 0.6, 100.0, 5.3),
        Parameter("process_noise", 0.05, 200.0, 6.4),
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        channels = len(briefing.sensor.channels)
        self._shape = np.full((briefing.batch, channels), self.values["shape"])
        self._rate = self._shape.copy()

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        innovation, explained, told = split(info)
        arrived, forgetting = ~np.isnan(innovation), self.values["forgetting"]
        shape, before = forgetting * self._shape + 0.5, forgetting * self._rate
        rate = before
        for _ in range(ITERATIONS):
            ratio = rate / shape
            left = share_of_noise(told * ratio, explained)
            rate = before + 0.5 * ((innovation * left) ** 2 + explained * left) / told
        self._shape = np.where(arrived, shape, self._shape)
        self._rate = np.where(arrived, rate, self._rate)
        factor = np.where(arrived, np.sqrt(ratio), np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)
