"""The engine's filter over several steps, as one operation of torch with a gradient."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from kfenv.filters.engine import Engine, InPlace
from kfenv.filters.protocol import Knobs, Measurement
from kfenv.filters.results import Prediction, Update
from kfenv.models.model import Motion, Sensor

from .kernel import Given, Sweep

Array = NDArray[np.float64]


class Series(NamedTuple):
    """What T instants of B episodes bring, time first."""

    measurement: Array  # (T, B, m), NaN where nothing arrived
    sensor_inputs: Array  # (T, B, k)
    motion_inputs: Array  # (T, B, p) of the step to each instant
    dt: Array  # (T, B) s, of the same


class FilterWithGradient:
    """Batches of filters for one motion and one sensor.

    Args:
        motion, sensor: the models, written with the namespace.
        kappa: spread of the sigma points, as of `kfenv.filters.engine.Engine`.
    """

    def __init__(self, motion: Motion, sensor: Sensor, kappa: float = 1.0) -> None:
        self.engine = Engine(motion, sensor, kappa)
        self.sweep = Sweep(motion, sensor, float(kappa))

    def run(
        self, start: Prediction, series: Series, knobs: Tensor, told: Tensor
    ) -> tuple[Tensor, Tensor, NDArray[np.bool_]]:
        """Posteriors, whose gradients go back to the knobs and to the noise told.

        Args:
            start: the prediction that the first instant's update begins with.
            knobs: (T, B, 2 + n) variance factors fading and process scale, and for each state
                what its deviations of the process noise are multiplied by.
            told: (T, B, m) deviations of the measurement noise as the filter takes them.

        Returns:
            Means (T, B, n), covariances (T, B, n, n), and which of them are sound (T, B). From
            a filter's failure on they are meaningless, and no gradient passes through them.
        """
        sound = np.zeros(series.dt.shape, bool)
        given = knobs.contiguous(), told.contiguous()
        return *_Run.apply(*given, self, start, series, sound), sound


class _Run(Function):
    @staticmethod
    def forward(
        ctx: Any, knobs: Tensor, told: Tensor, filter: FilterWithGradient, start: Prediction,
        series: Series, sound: NDArray[np.bool_],
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        turned = knobs.detach().numpy(), told.detach().numpy()
        ctx.tape = tape = _run(filter.engine, start, series, *turned, sound)
        ctx.sweep, ctx.sound = filter.sweep, sound
        factor = torch.from_numpy(tape["factor"])
        return torch.from_numpy(tape["posterior"]), factor @ factor.mT

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_mean: Tensor, of_covariance: Tensor) -> tuple:
        symmetric = 0.5 * (of_covariance + of_covariance.mT)
        slopes = {"of_posterior": of_mean.numpy(), "of_covariance": symmetric.numpy()}
        given = {
            name: np.ascontiguousarray(array).reshape(*array.shape[:2], -1)
            for name, array in (ctx.tape | slopes).items()
        }
        found = ctx.sweep(Given(**given), ctx.sound.sum(axis=0))
        return *map(torch.from_numpy, found), None, None, None, None


def _run(
    engine: Engine, start: Prediction, series: Series, knobs: Array, told: Array,
    sound: NDArray[np.bool_],
) -> dict[str, Array]:  # fmt: skip
    """The engine's steps, by the names in `Given`; `sound` is written."""
    (steps, batch, channels), n = series.measurement.shape, start.mean.shape[1]
    shape, status = (steps, batch), np.zeros(batch, np.int64)
    predicted = Prediction(np.zeros((*shape, n)), *np.zeros((2, *shape, n, n)))
    found = Update(
        np.zeros((*shape, n)), np.zeros((*shape, n, n)),
        *np.full((3, *shape, channels), np.nan), *np.zeros((2, *shape)),
    )  # fmt: skip
    for t in range(steps):
        if t > 0:
            before = found.mean[t - 1], found.factor[t - 1]
            start = engine.predict(*before, series.motion_inputs[t], series.dt[t], status)
        prediction = Prediction(*(array[t] for array in predicted))
        for kept, given in zip(prediction, start, strict=True):
            kept[:] = given
        np.multiply(prediction.noise, knobs[t, :, 2:, None], out=prediction.noise)
        scales = Knobs(*knobs[t, :, :2].T.copy())
        seen = Measurement(series.sensor_inputs[t].copy(), series.measurement[t], told[t])
        update = Update(*(array[t] for array in found))
        place = InPlace(prediction.mean, prediction.root, prediction, scales, update, status)
        engine.update_in_place(place, seen)
        sound[t] = status == 0
    inputs = np.concatenate([series.motion_inputs, series.dt[:, :, None]], axis=2)
    return predicted._asdict() | {
        "posterior": found.mean, "factor": found.factor, "innovation": found.innovation,
        "knobs": knobs, "told": told, "motion_inputs": inputs,
        "sensor_inputs": series.sensor_inputs,
    }  # fmt: skip
