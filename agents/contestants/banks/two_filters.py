"""Two filters of different process noise, each with a hidden Markov model of the noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.bank import Bank, Components, Mixed, Mode, markov
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Prediction

from ..agent import Array, Parameter
from ..fault_model import FaultModel
from ..rules.hidden_markov import grid, hear, prior
from .bank import BankContestant


class Hmm2q(BankContestant):
    """A calm and a manoeuvring filter; `HmmNoise` in each, whose normaliser weighs the filter.

    The beliefs mix as the filters do (CONTEST section 2).
    """

    parameters = (
        Parameter("up", 0.002, 0.5, 0.052),
        Parameter("down", 0.001, 0.5, 0.010),
        Parameter("glint_share", 0.005, 0.5, 0.083),
        Parameter("leak", 1e-6, 1e-2, 1.8e-5),
        Parameter("process_noise", 0.001, 5.0, 0.01),
        Parameter("manoeuvre", 10.0, 10_000.0, 2160.0),
        Parameter("begin", 0.01, 1.0, 0.0905),
        Parameter("end", 0.001, 0.5, 0.0268),
    )

    def bank(self, engine: Engine, scenario: Any) -> Bank:
        """See `BankContestant.bank`."""
        v = self.values
        q = v["process_noise"]
        modes = [Mode(process_noise=q), Mode(process_noise=q * v["manoeuvre"])]
        rates = np.array([[0.0, v["begin"]], [v["end"], 0.0]])
        model = FaultModel.of(scenario).with_glint_share(v["glint_share"])
        return HearingBank(engine, modes, markov(rates), model, v["up"], v["down"], v["leak"])


class HearingBank(Bank):
    """A bank each of whose filters holds a belief about the noise, see `hidden_markov`.

    Args:
        model: of the faults.
        up, down, leak: of `hidden_markov.hear`.
    """

    def __init__(
        self, engine, modes, transition, model: FaultModel, up: float, down: float, leak: float
    ) -> None:
        super().__init__(engine, modes, transition)
        self._model, self._grid, self._rates = model, grid(model), (up, down, leak)

    def start(self, mean: Array, factor: Array) -> Prediction:
        """See `Bank.start`; beliefs are forgotten."""
        rows, channels = len(mean) * len(self.modes), len(self.tier.sensor.channels)
        self._belief, self._passed = prior(self._model, rows, channels), np.zeros(rows)
        return super().start(mean, factor)

    def predict(
        self, mixed: Mixed, inputs: Array, dt: Array, status: NDArray[np.int64]
    ) -> Prediction:
        """See `Bank.predict`."""
        self._passed = np.repeat(dt, len(self.modes))
        return super().predict(mixed, inputs, dt, status)

    def update(
        self,
        prediction: Prediction,
        probability: Array,
        measurement: Measurement,
        status: NDArray[np.int64],
        log_likelihood: Array | None = None,
    ) -> Components:
        """See `Bank.update`; the noise is what each filter's belief says."""
        count = len(self.modes)
        repeated = Measurement(*(np.repeat(array, count, axis=0) for array in measurement))
        knobs = self.knobs(len(status))
        work = np.where(np.isfinite(prediction.mean[:, 0]), 0, 1)
        looked = self.tier.innovate(prediction, knobs, repeated, work)
        innovation = np.where(work[:, None] == 0, looked.innovation, np.nan)
        factor, evidence = hear(
            innovation, looked.variance, repeated.noise, self._passed, *self._rates,
            self._grid, self._belief,
        )  # fmt: skip
        noise = repeated.noise * np.where(np.isnan(factor), 1.0, factor)
        heard = measurement._replace(noise=noise.reshape(len(status), count, -1))
        return super().update(
            prediction, probability, heard, status, evidence.reshape(len(status), count)
        )

    def mix(self, components: Components, transition: Array) -> Mixed:
        """See `Bank.mix`; beliefs are weighed means of those that a mode may come from."""
        mixed = super().mix(components, transition)
        joint = components.weight[:, :, None] * transition
        with np.errstate(invalid="ignore"):
            weights = joint / joint.sum(axis=1, keepdims=True)
        batch, count = components.weight.shape
        for old in self._belief:
            by_filter = old.reshape(batch, count, *old.shape[1:])
            by_filter[:] = np.einsum("bij,bi...->bj...", weights, by_filter)
        return mixed
