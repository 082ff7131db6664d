"""Agents that are shown what only a simulation knows: limits, not contestants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.models.namespaces import batch
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario

from .agent import Agent, Array, Briefing, Parameter, knob_actions


class Clairvoyant(Agent):
    """Knows R, the noise that each measurement was drawn with, and holds one constant q.

    That is no bound: what adapts q as well can be better. The deviation is each channel's
    own: errors common to several channels, and constant ones, are not in it.
    """

    parameters = (Parameter("process_noise", 0.05, 200.0, 1.0),)
    clairvoyant = True
    sees = "nothing"

    def reset(self, briefing: Briefing) -> None:
        """See also `Agent.reset`.

        Raises:
            ValueError: if the recording does not know its true noise.
        """
        super().reset(briefing)
        if briefing.recording is None or briefing.recording.true_noise is None:
            raise ValueError("The clairvoyant needs a recording that knows its true noise.")
        recording = briefing.recording
        ratio = self._level(recording) / recording.noise
        self._ratio = np.where(np.isnan(recording.measurement), np.nan, ratio)
        self._index = 0

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        now = min(self._index, self._ratio.shape[1] - 1)
        self._index += self.briefing.decision_interval
        return knob_actions(self.briefing, 1.0, self._process_noise(now), self._ratio[:, now])

    def _level(self, recording: Recording) -> Array:
        return recording.true_noise

    def _process_noise(self, now: int) -> Array | float:
        return self.values["process_noise"]


class ClairvoyantChannels(Clairvoyant):
    """Knows of each channel its error budget, and turns each one's own knob.

    The budget's variance is that of the noise plus the square of the error that is no noise
    (a stepped or ramped range). Still no bound, and one constant q.
    """

    single_channels = True

    def _level(self, recording: Recording) -> Array:
        bias = 0.0 if recording.true_bias is None else recording.true_bias
        return np.hypot(recording.true_noise, bias)


class ClairvoyantRq(Clairvoyant):
    """Knows R and how hard the target manoeuvres: q = floor + gain * `unexplained`, in each step.

    Nearest to a bound for what the knobs can do, but none either: q follows the truth by one
    formula, and the best filter may want another.
    """

    parameters = (
        Parameter("floor", 1e-3, 10.0, 0.01),
        Parameter("gain", 0.01, 1000.0, 10.0),
    )

    def reset(self, briefing: Briefing) -> None:
        """See also `Clairvoyant.reset`.

        Raises:
            ValueError: if the recording does not know its true noise or its truth.
        """
        super().reset(briefing)
        if briefing.recording.truth is None:
            raise ValueError("clairvoyant-rq needs a recording that knows its truth.")
        self._unexplained = unexplained(briefing.scenario, briefing.recording)

    def _process_noise(self, now: int) -> Array | float:
        steps = self._unexplained[:, now : now + self.briefing.decision_interval]
        return self.values["floor"] + self.values["gain"] * steps.mean(axis=1)


def unexplained(scenario: TrackingScenario, recording: Recording) -> Array:
    """How far (B, T) the truth departs from its prediction by the motion model, in its noise.

    The mean over the three velocities (or, where none are told, over all states that have
    process noise) of the squared departure from one instant's truth to
    the next over its variance under nominal process noise: one on the average if the truth
    moves as the model does, and zero at the first instant, which nothing predicts.
    """
    motion = scenario.motion
    functions = motion.build(batch)
    state = tuple(np.moveaxis(recording.truth[:, :-1], -1, 0))
    inputs = tuple(np.moveaxis(recording.motion_inputs[:, 1:], -1, 0))
    dt = np.broadcast_to(np.diff(recording.times), state[0].shape)
    predicted = np.stack(np.broadcast_arrays(*functions.step(state, inputs, dt)))
    variance = np.zeros_like(predicted)
    entries = functions.noise_factor(state, inputs, dt)
    for (row, _), entry in zip(motion.noise_pattern, entries, strict=True):
        variance[row] += entry**2
    departure = np.moveaxis(recording.truth[:, 1:], -1, 0) - predicted
    driven = [i for i in range(len(variance)) if np.all(variance[i] > 0.0)]
    velocity = list(scenario.yardstick.rates) or driven
    result = np.zeros(recording.truth.shape[:2])
    result[:, 1:] = np.mean(departure[velocity] ** 2 / variance[velocity], axis=0)
    return result
