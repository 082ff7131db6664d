"""Agents that do not adapt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import Knob, actions_for
from kfenv.scenarios.scenario import TrackingScenario

from .agent import Agent, Array, Briefing, Parameter


class Fixed(Agent):
    """The nominal filter: all knobs at one."""

    sees = "nothing"

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        return np.zeros((self.briefing.batch, len(self.briefing.knobs)))


class FixedTuned(Agent):
    """One setting of all knobs, optimised on training episodes and then held."""

    sees = "nothing"

    def tunable(self, scenario: TrackingScenario, knobs: Sequence[Knob]) -> tuple[Parameter, ...]:
        """Every knob, over its whole range."""
        return tuple(Parameter(knob.name, knob.low, knob.high, 1.0) for knob in knobs)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        knobs = self.briefing.knobs
        factors = np.array([self.values.get(knob.name, 1.0) for knob in knobs])
        return np.tile(actions_for(factors, knobs), (self.briefing.batch, 1))


class Random(Agent):
    """Uniform actions: the floor. An episode's are the same in whatever block it is run."""

    all_knobs = False
    sees = "nothing"

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._rng = np.random.default_rng(briefing.seed)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        batch, knobs = self.briefing.batch, len(self.briefing.knobs)
        before, episodes = self.briefing.first, self.briefing.episodes or batch
        self._rng.bit_generator.advance(before * knobs)  # a draw for each number
        actions = self._rng.uniform(-1.0, 1.0, (batch, knobs))
        self._rng.bit_generator.advance((episodes - before - batch) * knobs)
        return actions
