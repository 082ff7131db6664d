"""Classical rules that adapt the knobs to the pending innovation (SPEC 6, 10).

They see what every agent sees: the innovation nu, its variance S under the nominal
knobs, and the noise R that the filter was told; H P H^T is S - R. Channels that did
not arrive are NaN and leave a rule's memory as it was; the ``info`` of ``env.step`` has zero
and infinity there, so that who calls a rule from it must put NaN back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.fading import Fading, fading_factor, second_moment

from .agent import Agent, Array, Briefing, Parameter, knob_actions

PROCESS_NOISE = Parameter("process_noise", 0.05, 200.0, 1.0)
REACQUIRE_AFTER = 5  # consecutive rejections of a channel, then the gate opens once
REJECTED = 1e3  # noise factor of a rejected channel: beyond any knob's range


class InnovationFading(Agent):
    """One fading factor from the innovations' second moment, as `kfenv.filters.fading` has it.

    V_1 = nu nu^T, V_k = (rho V_{k-1} + nu nu^T) / (1 + rho);
    lambda = max(1, tr R^-1 (V - beta R) / tr R^-1 H P H^T), as far as the knob goes.
    """

    normalised: ClassVar[bool] = True

    parameters = (
        Parameter("forgetting", 0.5, 1.0, 0.95),
        Parameter("weakening", 1.0, 1e6, 1.5),
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._moment = np.full((briefing.batch, len(briefing.sensor.channels)), np.nan)
        rho, beta = self.values["forgetting"], self.values["weakening"]
        # Tuning works on logarithms, and may miss the ends of a range by a rounding.
        self._rule = Fading(min(rho, 1.0), beta=max(beta, 1.0), norm=self.normalised)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        variance = info["innovation_variance"]
        self._moment = second_moment(self._rule, self._moment, info["innovation"], variance)
        factor = fading_factor(self._rule, self._moment, variance, info["noise"])
        return knob_actions(self.briefing, factor, self.values["process_noise"])


class InnovationFadingPrinted(InnovationFading):
    """The printed lambda: traces that add m^2 to rad^2, and S where H P H^T belongs (SPEC 6).

    What the paper then does with lambda (eq 40 to 42: on the raw second moment, and a
    second time) is beyond the knobs; here it multiplies the propagated covariance once.
    """

    normalised = False


class HuberGate(Agent):
    """Huber weights from the pending innovation, and rejection beyond a gate.

    e = nu / sqrt(S) per channel; the noise variance is divided by w = min(1, k / |e|),
    and the channel rejected where |e| exceeds the gate, until it has been rejected
    five times running.
    """

    parameters = (
        Parameter("threshold", 0.5, 6.0, 1.345),
        Parameter("gate", 3.0, 1000.0, 30.0),
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._rejections = np.zeros((briefing.batch, len(briefing.sensor.channels)), np.int64)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        size = np.abs(info["innovation"]) / np.sqrt(info["innovation_variance"])
        size = np.nan_to_num(size)
        factor = np.sqrt(np.maximum(1.0, size / self.values["threshold"]))
        rejected = (size > self.values["gate"]) & (self._rejections < REACQUIRE_AFTER)
        counted = np.where(rejected, self._rejections + 1, 0)
        arrived = ~np.isnan(info["innovation"])
        self._rejections = np.where(arrived, counted, self._rejections)
        factor = np.where(rejected, REJECTED, np.where(arrived, factor, np.nan))
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)


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
        told = info["noise"] ** 2
        explained = np.maximum(info["innovation_variance"] - told, 0.0)
        squared, gate = info["innovation"] ** 2, self.values["gate"] ** 2
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
        return np.clip(mean_square - explained, 0.04 * told, 1e4 * told)
