"""Agents that do not adapt, and the one that knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import Knob, actions_for

from .agent import Agent, Array, Briefing, Parameter, knob_actions


class Fixed(Agent):
    """The nominal filter: all knobs at one."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        return np.zeros((self.briefing.batch, len(self.briefing.knobs)))


class FixedTuned(Agent):
    """One setting of all knobs, optimised on training episodes and then held."""

    def tunable(self, knobs: Sequence[Knob]) -> tuple[Parameter, ...]:
        """Every knob, over its whole range."""
        return tuple(Parameter(knob.name, knob.low, knob.high, 1.0) for knob in knobs)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        knobs = self.briefing.knobs
        factors = np.array([self.values.get(knob.name, 1.0) for knob in knobs])
        return np.tile(actions_for(factors, knobs), (self.briefing.batch, 1))


class Clairvoyant(Agent):
    """Knows the deviation each measurement's noise was drawn with: the bound for noise tuning.

    The deviation is each channel's own: errors common to several channels, and constant
    ones, are not in it.
    """

    parameters = (Parameter("process_noise", 0.05, 200.0, 1.0),)
    clairvoyant = True

    def reset(self, briefing: Briefing) -> None:
        """See also `Agent.reset`.

        Raises:
            ValueError: if the recording does not know its true noise.
        """
        super().reset(briefing)
        if briefing.recording is None or briefing.recording.true_noise is None:
            raise ValueError("The clairvoyant needs a recording that knows its true noise.")
        recording = briefing.recording
        ratio = recording.true_noise / recording.noise
        self._ratio = np.where(np.isnan(recording.measurement), np.nan, ratio)
        self._index = 0

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        ratio = self._ratio[:, min(self._index, self._ratio.shape[1] - 1)]
        self._index += self.briefing.decision_interval
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], ratio)


class Random(Agent):
    """Uniform actions: the floor."""

    all_knobs = False

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._rng = np.random.default_rng(briefing.seed)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        return self._rng.uniform(-1.0, 1.0, (self.briefing.batch, len(self.briefing.knobs)))
