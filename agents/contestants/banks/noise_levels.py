"""Banks over the level of the measurement noise alone."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from kfenv.filters.bank import Bank, Mode, markov
from kfenv.filters.engine import Engine
from kfenv.filters.gaussian_sum import Mixture

from ..agent import Parameter
from ..fault_model import FaultModel
from .bank import BankContestant, glint_mixture


class Imm(BankContestant):
    """An interacting multiple model over noise levels, any of which may follow any other.

    Blom and Bar-Shalom (1988). The levels are spaced evenly in the logarithm.
    """

    count: ClassVar[int] = 4
    parameters = (
        Parameter("lowest", 0.1, 5.0, 0.96),
        Parameter("highest", 5.0, 500.0, 92.0),
        Parameter("switching", 0.01, 2.0, 0.228),
        Parameter("process_noise", 0.05, 200.0, 6.6),
    )

    def bank(self, engine: Engine, scenario: Any) -> Bank:
        """See `BankContestant.bank`."""
        v = self.values
        levels = np.geomspace(v["lowest"], v["highest"], self.count)
        rates = np.full((self.count, self.count), v["switching"] / (self.count - 1))
        modes = [Mode(float(level), v["process_noise"]) for level in levels]
        return Bank(engine, modes, markov(rates), self._outliers(scenario))

    def _outliers(self, scenario: Any) -> Mixture | None:
        return None


class Imm8(Imm):
    """`Imm` over eight levels."""

    count = 8
    parameters = (
        Parameter("lowest", 0.1, 5.0, 0.35),
        Parameter("highest", 5.0, 500.0, 113.0),
        Parameter("switching", 0.01, 2.0, 0.328),
        Parameter("process_noise", 0.05, 200.0, 4.9),
    )


class ImmGlint(Imm):
    """`Imm`, each of whose modes takes a measurement for sound or a glint, by its likelihood."""

    parameters = (*Imm.parameters, Parameter("glint_share", 0.005, 0.5, 0.083))

    def _outliers(self, scenario: Any) -> Mixture | None:
        return glint_mixture(FaultModel.of(scenario).with_glint_share(self.values["glint_share"]))
