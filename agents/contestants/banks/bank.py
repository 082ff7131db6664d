"""What the contestants that run a bank share."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from kfenv.envs.options import Options
from kfenv.filters.bank import Bank
from kfenv.filters.engine import Engine
from kfenv.filters.gaussian_sum import Mixture
from kfenv.filters.results import History
from kfenv.scenarios.recording import Recording

from ..agent import Array
from ..compiled import CompiledFilter
from ..fault_model import FaultModel, factors


class BankContestant(CompiledFilter):
    """A bank over the environment's compiled filter, drawn anew for each recording."""

    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """See `RecordingFilter.filter`."""
        engine = Engine(scenario.motion, scenario.sensor, options.kappa)
        return self.bank(engine, scenario).history(recording)

    @abstractmethod
    def bank(self, engine: Engine, scenario: Any) -> Bank:
        """The bank over an engine, for a scenario's faults."""


def glint_mixture(model: FaultModel) -> Mixture | None:
    """Outliers as the fault model knows them, None where it knows of none."""
    if model.glint_share == 0.0 or model.glint <= 0:
        return None
    return Mixture(model.glint_share, float(factors(model.glint)) ** 2)


def level_rates(count: int, up: float, down: float, hops: float) -> Array:
    """Switching rates (L, L), 1/s, of noise levels the first of which is undisturbed.

    Up to any disturbed level alike, down from each, and `hops` times up from a disturbed
    one to the others.
    """
    rates = np.zeros((count, count))
    disturbed = count - 1
    if disturbed:
        rates[0, 1:] = up / disturbed
        rates[1:, 0] = down
    if disturbed > 1:
        rates[1:, 1:] = hops * up / (disturbed - 1)
    return rates
