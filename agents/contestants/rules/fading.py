"""Rules that answer large innovations by fading: the prediction is trusted less."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.fading import Fading, fading_factor, second_moment

from ..agent import Agent, Array, Briefing, Parameter, knob_actions
from .innovation import NOISE, PROCESS_NOISE, split

FORGETTING = 0.95  # of strong tracking, as published


class InnovationFading(Agent):
    """One fading factor from the innovations' second moment, as `kfenv.filters.fading` has it.

    V_1 = nu nu^T, V_k = (rho V_{k-1} + nu nu^T) / (1 + rho);
    lambda = max(1, tr R^-1 (V - beta R) / tr R^-1 H P H^T), as far as the knob goes.
    """

    normalised: ClassVar[bool] = True

    parameters = (
        Parameter("forgetting", 0.5, 1.0, 0.95),
        Parameter("weakening", 1.0, 1e6, 1.5),
        NOISE,
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._moment = np.full((briefing.batch, len(briefing.sensor.channels)), np.nan)
        rho, beta = self.values.get("forgetting", FORGETTING), self.values["weakening"]
        # Tuning works on logarithms, and may miss the ends of a range by a rounding.
        self._rule = Fading(min(rho, 1.0), beta=max(beta, 1.0), norm=self.normalised)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        scale = self.values["noise"]
        innovation, explained, noise = split(info, scale)
        variance = explained + noise
        self._moment = second_moment(self._rule, self._moment, innovation, variance)
        factor = fading_factor(self._rule, self._moment, variance, np.sqrt(noise))
        channel_noise = np.where(np.isnan(innovation), np.nan, scale)
        return knob_actions(self.briefing, factor, self.values["process_noise"], channel_noise)


class InnovationFadingPrinted(InnovationFading):
    """The printed lambda: traces that add m^2 to rad^2, and S where H P H^T belongs (SPEC 6).

    What the paper then does with lambda (eq 40 to 42: on the raw second moment, and a
    second time) is beyond the knobs; here it multiplies the propagated covariance once.
    """

    normalised = False


class StrongTracking(InnovationFading):
    """One fading factor that keeps the innovations orthogonal (Zhou and Frank 1996, eq 22 to 26).

    lambda = max(1, tr N / tr M), N = V - H Q H^T - beta R, M = H P H^T - H Q H^T, P the
    predicted covariance, V as in `InnovationFading` with rho = 0.95, traces normalised by R. No
    agent sees H Q H^T, so it stays in P, of which it is a ten-thousandth in RadarTracking:
    the rule is `InnovationFading` with the published rho. Several factors, one for each state
    (SPEC 10), are beyond the knobs.
    """

    parameters = (Parameter("weakening", 1.0, 1e6, 1.5), NOISE, PROCESS_NOISE)
