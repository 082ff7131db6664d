"""What static noise is chosen by: sums over the blocks of a log, and the cost they make."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.options import Options
from kfenv.scenarios.recording import Recording

from ..contest.rollout import check_scored
from ..contest.tuning_costs import ERROR, WITHHELD, foreseen_costs, withhold
from .innovations import instants

Array = NDArray[np.float64]

LIKELIHOOD, CONSISTENCY = "likelihood", "consistency"
STATIC = LIKELIHOOD, WITHHELD, CONSISTENCY, ERROR
FAILED = -100.0  # log-likelihood per channel that a filter which failed is given
AT_ONCE = 20_000_000  # numbers that the series of all settings may hold


class Criterion:
    """A cost of static noise over blocks of a log, each counted with a weight.

    Args:
        on: one of `STATIC`. ``"likelihood"`` is the filter's
            own; ``"consistency"`` the sum over channel groups of (log RMS)^2 + (lag-1
            correlation)^2 of the whitened innovations; the others are as for agents.
        scenario, options: of the environment.
        recording: the log's windows.
        blocks: (B, T) the block of each instant.

    Raises:
        ValueError: if errors are asked for and an episode has no truth.
    """

    def __init__(
        self, on: str, scenario: Any, options: Options, recording: Recording,
        blocks: NDArray[np.int64],
    ) -> None:  # fmt: skip
        if on == ERROR:
            check_scored(recording)
        self.on, self.scenario, self.options, self.blocks = on, scenario, options, blocks
        self.count = int(blocks.max()) + 1
        self.recording, self._kept = recording, None
        if on == WITHHELD:
            self.recording, self._kept = withhold(recording)

    def sums(self, left: Array, noise: Array) -> Array:
        """Of settings L (S, n, n), r (S, m): what adds up over blocks (S, K, F)."""
        states, channels = left.shape[-1], noise.shape[-1]
        each = self.blocks.size * (states + channels + 2)
        chunk = max(1, AT_ONCE // each)
        parts = [
            self._sums(left[i : i + chunk], noise[i : i + chunk])
            for i in range(0, len(left), chunk)
        ]
        return np.concatenate(parts)

    def cost(self, sums: Array, weight: Array) -> Array:
        """Costs (..., S) of sums (S, K, F) under weights (..., K)."""
        total = np.tensordot(weight, sums, axes=([-1], [1]))  # (..., S, F)
        if self.on != CONSISTENCY:
            return total[..., 0] / np.maximum(total[..., 1], 1e-12)
        square, lagged, count = np.split(total, 3, axis=-1)
        square = square / np.maximum(count, 1.0) + 1e-12
        correlation = lagged / np.maximum(count, 1.0) / square
        return np.sum((0.5 * np.log(square)) ** 2 + correlation**2, axis=-1)

    def _sums(self, left: Array, noise: Array) -> Array:
        if self.on == CONSISTENCY:
            return self._by_block(*self._consistency(left, noise))
        if self.on == LIKELIHOOD:
            return self._by_block(*self._likelihood(left, noise))
        series = self._series(left, noise)
        if self.on == ERROR:
            return self._errors(series)
        shape = self.recording.measurement.shape
        inputs, told, kept = self.recording.sensor_inputs, self.recording, self._kept
        assert kept is not None and inputs.shape[:2] == shape[:2]
        each = np.zeros((len(left), self.count, 2))
        for k in range(self.count):
            here = np.where((self.blocks == k)[..., None], kept, np.nan)
            rows = np.flatnonzero((~np.isnan(here)).any(axis=(1, 2)))
            if len(rows):
                for s in range(len(left)):
                    costs = foreseen_costs(
                        self.scenario.sensor, told[rows], here[rows], series[s][rows]
                    )
                    each[s, k] = costs.sum(), len(rows)
        return each

    def _likelihood(self, left: Array, noise: Array) -> list[Array]:
        """Minus log-likelihoods, and channels that arrived (S, B, T)."""
        shape = (len(left), *self.blocks.shape)
        cost, count = np.zeros((2, *shape))
        arrived = (~np.isnan(self.recording.measurement)).sum(axis=2)
        for t, update, _, sound in instants(
            self.scenario, self.options, self.recording, left, noise
        ):
            here = np.where(sound, update.log_likelihood, 0.0).reshape(shape[:2])
            failed = ~sound.reshape(shape[:2])
            cost[..., t] = -np.where(failed, FAILED * arrived[:, t], here)
            count[..., t] = arrived[:, t]
        return [cost, count]

    def _consistency(self, left: Array, noise: Array) -> list[Array]:
        """Per group: squares and lag products of whitened innovations, and their count."""
        sensor, shape = self.scenario.sensor, (len(left), *self.blocks.shape)
        membership = np.eye(len(sensor.groups))[np.array(sensor.group_of_channel)]
        square, lagged, count = np.zeros((3, len(sensor.groups), *shape))
        last = np.zeros((len(left) * shape[1], len(sensor.groups)))
        for t, update, _, sound in instants(
            self.scenario, self.options, self.recording, left, noise
        ):
            present = ~np.isnan(update.whitened) & sound[:, None]
            whitened = np.where(present, update.whitened, 0.0)
            with np.errstate(over="ignore"):
                squares = np.minimum(whitened**2, 1e12) @ membership
            n = present @ membership
            value = whitened @ membership / np.sqrt(np.maximum(n, 1.0))
            for g in range(len(sensor.groups)):
                share = np.maximum(n[:, g], 1.0)
                square[g, ..., t] = (squares[:, g] / share).reshape(shape[:2])
                lagged[g, ..., t] = (value[:, g] * last[:, g]).reshape(shape[:2])
                count[g, ..., t] = (n[:, g] > 0.0).reshape(shape[:2])
            last = np.where(n > 0.0, value, last)
        return [*square, *lagged, *count]

    def _series(self, left: Array, noise: Array) -> Array:
        """Means (S, B, T, n): of errors the updated ones, of withheld data the predicted ones."""
        predicted = self.on == WITHHELD
        shape = (len(left), *self.blocks.shape, left.shape[-1])
        series = np.full(shape, np.nan)
        for t, update, before, sound in instants(
            self.scenario, self.options, self.recording, left, noise
        ):
            mean = np.where(sound[:, None], before if predicted else update.mean, np.nan)
            series[..., t, :] = mean.reshape(*shape[:2], -1)
        return series

    def _errors(self, series: Array) -> Array:
        """Log RMS position error of each block, and one (S, K, 2)."""
        squared, known = squared_errors(self.scenario, self.recording, series)
        sums = self._by_block(squared, np.broadcast_to(known, squared.shape))
        counted = sums[..., 1] > 0.0
        cost = 0.5 * np.log(sums[..., 0] / np.maximum(sums[..., 1], 1.0) + 1e-12)
        return np.stack([np.where(counted, cost, 0.0), counted.astype(float)], axis=-1)

    def _by_block(self, *series: Array) -> Array:
        """Sums (S, K, F) over blocks of series (S, B, T)."""
        flat = np.stack([each.reshape(len(each), -1) for each in series], axis=-1)
        place = np.eye(self.count)[self.blocks.ravel()]  # (B T, K)
        return np.einsum("sif,ik->skf", flat, place, optimize=True)


def squared_errors(scenario: Any, recording: Recording, series: Array) -> tuple[Array, Array]:
    """Squared position errors (S, B, T), lost at the loss distance, and what is scored (B, T)."""
    far = scenario.lost_distance
    assert recording.truth is not None
    with np.errstate(invalid="ignore", over="ignore"):
        squared = np.sum(scenario.yardstick.off(series, recording.truth) ** 2, axis=-1)
    known = np.ones(recording.truth.shape[:2]) if recording.scored is None else recording.scored
    failed = np.isnan(squared)
    gone = failed | ((squared > far**2) & (known > 0.0))
    gone = np.maximum.accumulate(gone, axis=-1)
    return np.where(gone, far**2, np.where(failed, 0.0, squared)) * known, known
