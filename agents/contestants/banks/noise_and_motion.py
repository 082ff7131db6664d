"""The bank over noise levels and process noise, with glint and each channel's misreport."""

from __future__ import annotations

from math import exp, log
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.filters.bank import Bank, Components, Mode, markov
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Prediction

from ..agent import Array, Parameter
from ..fault_model import FaultModel, factors
from ..rules.hidden_markov import HOPS
from .bank import BankContestant, glint_mixture, level_rates

DISTURBED = 3  # noise levels beside the undisturbed one
NEGLIGIBLE = 1e-3  # weight of a component that teaches nothing about a misreport


class ImmRq(BankContestant):
    """Four noise levels times two process noises, glint, and each channel's misreport.

    Eight predictions and sixteen updates a step (CONTEST section 2). The told noise is
    multiplied by the exponential of the misreport's mean log.
    """

    parameters = (
        Parameter("lowest", 1.2, 6.0, 2.2),
        Parameter("highest", 8.0, 200.0, 28.0),
        Parameter("up", 0.002, 0.5, 0.018),
        Parameter("down", 0.001, 0.5, 0.058),
        Parameter("glint_share", 0.005, 0.5, 0.072),
        Parameter("leak", 1e-6, 1e-2, 7e-5),
        Parameter("process_noise", 0.002, 5.0, 0.0507),
        Parameter("manoeuvre", 10.0, 5000.0, 335.0),
        Parameter("begin", 0.01, 1.0, 0.14),
        Parameter("end", 0.001, 0.5, 0.0143),
    )

    def bank(self, engine: Engine, scenario: Any) -> Bank:
        """See `BankContestant.bank`."""
        v = self.values
        model = FaultModel.of(scenario).with_glint_share(v["glint_share"])
        levels = [1.0, *np.geomspace(v["lowest"], v["highest"], DISTURBED)]
        scales = (v["process_noise"], v["process_noise"] * v["manoeuvre"])
        modes = [Mode(float(level), scale) for scale in scales for level in levels]
        noise = level_rates(len(levels), v["up"], v["down"], HOPS)
        motion = np.array([[0.0, v["begin"]], [v["end"], 0.0]])
        rates = np.kron(np.eye(2), noise) + np.kron(motion, np.eye(len(levels)))
        return MisreportBank(
            engine, modes, markov(rates), glint_mixture(model), model.misreport, v["leak"]
        )


class MisreportBank(Bank):
    """A bank that learns for each channel by how much the told noise is wrong.

    Args:
        powers: the misreports that are possible, see `fault_model.factors`.
        leak: share of what was learned that each arrival makes forgotten.
    """

    def __init__(self, engine, modes, transition, mixture, powers, leak: float) -> None:
        super().__init__(engine, modes, transition, mixture)
        self._grid, self._leak = factors(powers), leak

    def start(self, mean: Array, factor: Array) -> Prediction:
        """See `Bank.start`; what was learned is forgotten."""
        shape = (len(mean), len(self.tier.sensor.channels), len(self._grid))
        self._belief = np.full(shape, 1.0 / len(self._grid))
        return super().start(mean, factor)

    def update(
        self,
        prediction: Prediction,
        probability: Array,
        measurement: Measurement,
        status: NDArray[np.int64],
        log_likelihood: Array | None = None,
    ) -> Components:
        """See `Bank.update`."""
        believed = measurement.noise * np.exp(self._belief @ np.log(self._grid))
        corrected = measurement._replace(noise=believed)
        components = super().update(prediction, probability, corrected, status, log_likelihood)
        if len(self._grid) > 1:
            _learn(
                components.innovation, components.variance, components.weight, believed,
                self.noise_factors, measurement.noise, self._grid, self._leak, self._belief,
            )  # fmt: skip
        return components


@njit(cache=True, error_model="numpy")
def _learn(innovation, variance, weight, believed, level, told, grid, leak, belief):
    """Take a measurement into each channel's misreport; a missing one changes nothing.

    Args:
        innovation, variance: of the components, (B, C, m).
        weight: of the components, (B, C).
        believed, told: (B, m) noise deviations, the former with the misreport's mean.
        level: (C,) factors of the components' noise.
        grid: (M,) factors that a misreport may be.
        belief: (B, m, M) their probabilities, changed in place.
    """
    count = len(grid)
    density, posterior = np.empty(count), np.empty(count)
    for b in range(weight.shape[0]):
        for c in range(told.shape[1]):
            posterior[:] = 0.0
            for i in range(len(level)):
                if weight[b, i] < NEGLIGIBLE or np.isnan(innovation[b, i, c]):
                    continue
                used = believed[b, c] * level[i]
                explained = max(variance[b, i, c] - used * used, 0.0)
                _likelihoods(innovation[b, i, c], explained, told[b, c] * level[i], grid, density)
                total = 0.0
                for k in range(count):
                    density[k] *= belief[b, c, k]
                    total += density[k]
                if total > 0.0:
                    for k in range(count):
                        posterior[k] += weight[b, i] * density[k] / total
            known = posterior.sum()
            if known > 0.0:
                for k in range(count):
                    belief[b, c, k] = (1.0 - leak) * posterior[k] / known + leak / count


@njit(cache=True, error_model="numpy")
def _likelihoods(innovation, explained, deviation, grid, density):
    """N(nu; 0, explained + (grid deviation)^2), but for a factor that keeps the greatest at 1."""
    most = -np.inf
    for k in range(len(grid)):
        spread = explained + (grid[k] * deviation) ** 2
        density[k] = -0.5 * (innovation * innovation / spread + log(spread))
        most = max(most, density[k])
    for k in range(len(grid)):
        density[k] = exp(density[k] - most)
