"""Learning by gradients through the filter: truncated backpropagation of the position error.

Episodes are rolled by the network, then taken apart into chunks. Through each the filter is run
again, differentiably, from where the roll had it; what the network sees is the roll's, so that
gradients flow through mean, covariance and the network's memory alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from kfenv.envs import rewards
from kfenv.envs.state_knobs import places_of_states
from kfenv.filters.protocol import elapsed
from kfenv.scenarios.recording import Recording

from ..channelwise import Network
from .differentiable import DifferentiableFilter, Posterior, Predicted
from .rolling import Roll
from .scored import ScoredTensors

ROBUSTNESS = 20.0  # squared errors that are so many times an episode's mean count ever less
LONGEST = 5.0  # times the median gradient that an episode's may be long
CALM = 0.02  # keeps the logarithm of a mean NEES finite


@dataclass(frozen=True)
class Chunk:
    """Decisions from `begin` to `end` of a roll."""

    roll: Roll
    begin: int
    end: int


def chunks(decisions: int, length: int, first: int) -> list[tuple[int, int]]:
    """Where chunks begin and end: the first has `first` decisions, the others `length`."""
    edges = [0, *range(first, decisions, length), decisions]
    return [(a, b) for a, b in pairwise(edges) if b > a]


class Refinery:
    """The differentiable filter of a scenario, and the loss of a chunk.

    Args:
        scenario: gives motion, sensor, what is scored and its scale.
        kappa: of the environment's filter.
        consistency: weight of the term that brings the NEES to what it should be.
        largest_error: an episode's RMS error counts as this at most, in scales.
    """

    def __init__(
        self, scenario: Any, kappa: float, consistency: float, largest_error: float
    ) -> None:
        motion, sensor = scenario.motion, scenario.sensor
        self.filter = DifferentiableFilter(motion, sensor, kappa)
        self._consistency, self._largest = consistency, largest_error * scenario.error_scale
        self._least = rewards.least_square(scenario.error_scale)
        self._scored = ScoredTensors(scenario.yardstick)
        self._group = torch.tensor(sensor.group_of_channel)
        self._states = places_of_states(motion, sensor.groups)

    def loss(self, network: Network, chunk: Chunk) -> torch.Tensor:
        """Mean over the chunk's instants of the robust log of the squared error.

        1/2 k log(1 + (e^2 / m) / k) with an episode's mean squared error m: its gradient is
        about that of the log of the episode's RMSE, and a lost track does not rule it.
        """
        roll, begin, end = chunk.roll, chunk.begin, chunk.end
        told = torch.from_numpy(roll.observations[begin:end])
        logs, _ = network(told, torch.from_numpy(roll.memories[begin]))
        if logs.requires_grad:
            logs.register_hook(no_lane_rules)
        error, nees, counts = self._run(roll, begin, self._factors(roll, logs.double()))
        scale = torch.from_numpy(np.clip(roll.squared_error, self._least, self._largest**2))
        robust = 0.5 * ROBUSTNESS * torch.log1p(error / scale / ROBUSTNESS)
        number = counts.sum().clamp(min=1.0)
        loss = torch.where(counts > 0.0, robust, 0.0).sum() / number
        if self._consistency:
            loss = loss + self._consistency * _inconsistency(nees, counts)
        return loss

    def _factors(self, roll: Roll, logs: torch.Tensor) -> torch.Tensor:
        """All factors (L, B, A) of the filter, one where a knob is not the network's."""
        core = roll.core
        everything = torch.zeros(*logs.shape[:2], core.factors.shape[1], dtype=logs.dtype)
        place = torch.from_numpy(core.knob_place)
        return everything.index_copy(2, place, logs).exp()

    def _run(
        self, roll: Roll, begin: int, factors: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Squared errors, NEES per axis and whether they count, each (instants, B)."""
        core, recording = roll.core, roll.recording
        channels = len(self._group)
        noise = factors[:, :, 2 + self._group] * factors[:, :, -channels:]
        mean, root, added = map(torch.from_numpy, roll.predictions[begin])
        sound = torch.zeros(len(mean), dtype=torch.bool)
        predicted = Predicted(mean, root @ root.mT, added @ added.mT, sound)
        series = _Series(recording)
        alive = torch.from_numpy(roll.running[begin])
        errors, consistency, counts = [], [], []
        last = recording.time.shape[-1] - 1
        for step in range(len(factors) * core.interval):
            decision, i = step // core.interval, begin * core.interval + step
            alive = alive & torch.from_numpy(roll.running[begin + decision])
            due = i % core.scenario.steps_per_measurement == 0
            fading = factors[decision, :, 0] if due else torch.ones(len(mean), dtype=mean.dtype)
            posterior = self.filter.update(
                self._turned(predicted, factors[decision]), fading, factors[decision, :, 1],
                series.sensor_inputs[:, i], series.measurement[:, i],
                series.noise[:, i] * noise[decision],
            )  # fmt: skip
            alive = alive & ~posterior.failed
            off = self._scored.off(posterior.mean, series.truth[:, i])
            errors.append((off**2).sum(dim=1))
            consistency.append(self._nees(off.detach(), posterior))
            counts.append(torch.where(alive, series.scored[:, i], 0.0))
            if i == last:
                break
            predicted = self.filter.predict(
                posterior.mean, posterior.covariance, series.motion_inputs[:, i + 1],
                series.dt[:, i + 1],
            )  # fmt: skip
            alive = alive & ~predicted.failed
        return torch.stack(errors), torch.stack(consistency), torch.stack(counts)

    def _turned(self, predicted: Predicted, factors: torch.Tensor) -> Predicted:
        """See `kfenv.envs.statistics.apply_knobs`."""
        if not self._states:
            return predicted
        columns = [
            factors[:, self._states[i]].sqrt() if i in self._states else torch.ones_like(column)
            for i, column in enumerate(predicted.mean.unbind(1))
        ]
        deviation = torch.stack(columns, dim=1)
        return predicted._replace(
            noise=predicted.noise * deviation[:, :, None] * deviation[:, None, :]
        )

    def _nees(self, off: torch.Tensor, posterior: Posterior) -> torch.Tensor:
        if not self._consistency:
            return torch.zeros(len(off), dtype=off.dtype)
        return self._scored.nees(off, posterior.mean, posterior.covariance)


def no_lane_rules(gradient: torch.Tensor) -> torch.Tensor:
    """Shorten the gradient of each episode to a few times the median episode's.

    Through a filter that is about to lose its track gradients grow without bound, and one such
    episode would drown all others.

    Args:
        gradient: (L, B, K).
    """
    length = torch.nan_to_num(gradient, 0.0, 0.0, 0.0).norm(dim=(0, 2))
    some = length[length > 0.0]
    if not len(some):
        return gradient
    most = LONGEST * some.median()
    share = torch.where(length > most, most / length.clamp(min=1e-30), 1.0)
    return torch.nan_to_num(gradient, 0.0, 0.0, 0.0) * share[:, None]


class _Series:
    """A recording's arrays as tensors."""

    def __init__(self, recording: Recording) -> None:
        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(np.array(array))

        self.measurement, self.noise = tensor(recording.measurement), tensor(recording.noise)
        self.sensor_inputs = tensor(recording.sensor_inputs)
        self.motion_inputs = tensor(recording.motion_inputs)
        self.truth = tensor(recording.truth)
        self.dt = tensor(elapsed(recording))
        known = recording.scored
        self.scored = tensor(np.ones(recording.truth.shape[:2]) if known is None else known)


def _inconsistency(nees: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """How far the mean NEES of each episode in the chunk is from one, on a log scale."""
    number = counts.sum(dim=0)
    mean = torch.where(counts > 0.0, nees, 0.0).sum(dim=0) / number.clamp(min=1.0)
    off = torch.log(mean + CALM)
    each = 2.0 * torch.nn.functional.smooth_l1_loss(off, torch.zeros_like(off), reduction="none")
    some = number > 0.0
    return torch.where(some, each, 0.0).sum() / some.sum().clamp(min=1.0)
