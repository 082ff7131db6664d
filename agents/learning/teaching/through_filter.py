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
from .gradients.filtering import FilterWithGradient, Series
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
    """The filter of a scenario with its gradient, and the loss of a chunk.

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
        self.filter = FilterWithGradient(motion, sensor, kappa)
        self._consistency, self._largest = consistency, largest_error * scenario.error_scale
        self._least = rewards.least_square(scenario.error_scale)
        self._scored = ScoredTensors(scenario.yardstick)
        self._group = torch.tensor(sensor.group_of_channel)
        places = places_of_states(motion, sensor.groups)
        self._states = torch.tensor(list(places), dtype=torch.long)
        self._state_knobs = torch.tensor(list(places.values()), dtype=torch.long)

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
        recording, interval = roll.recording, roll.core.interval
        first = begin * interval
        instants = slice(first, min(first + len(factors) * interval, recording.time.shape[-1]))
        decision = np.arange(instants.stop - first) // interval
        knobs, told = self._turned(roll, instants, factors[decision])
        means, covariances, sound = self.filter.run(
            roll.predictions[begin], _series(recording, instants), knobs, told
        )
        alive = np.logical_and.accumulate(sound & roll.running[begin + decision], axis=0)
        mean, covariance = means.flatten(0, 1), covariances.flatten(0, 1)
        truth = torch.from_numpy(_time_first(recording.truth, instants)).flatten(0, 1)
        off = self._scored.off(mean, truth)
        nees = self._nees(off.detach(), mean, covariance)
        known = recording.scored
        scored = alive.astype(float) if known is None else alive * _time_first(known, instants)
        error = (off**2).sum(dim=1)
        return error.view(alive.shape), nees.view(alive.shape), torch.from_numpy(scored)

    def _turned(
        self, roll: Roll, instants: slice, factors: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Knobs (T, B, 2 + n) and deviations (T, B, m) of the noise told at each instant.

        See `kfenv.envs.statistics.apply_knobs`.
        """
        scenario, channels = roll.core.scenario, len(self._group)
        due = torch.arange(instants.start, instants.stop) % scenario.steps_per_measurement == 0
        fading = torch.where(due[:, None, None], factors[:, :, :1], 1.0)
        deviations = torch.ones(*factors.shape[:2], len(scenario.motion.states)).double()
        turned = factors[:, :, self._state_knobs].sqrt()
        deviations = deviations.index_copy(2, self._states, turned)
        noise = torch.from_numpy(_time_first(roll.recording.noise, instants))
        told = noise * factors[:, :, 2 + self._group] * factors[:, :, -channels:]
        return torch.cat([fading, factors[:, :, 1:2], deviations], dim=2), told

    def _nees(
        self, off: torch.Tensor, mean: torch.Tensor, covariance: torch.Tensor
    ) -> torch.Tensor:
        if not self._consistency:
            return torch.zeros(len(off), dtype=off.dtype)
        return self._scored.nees(off, mean, covariance)


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


def _series(recording: Recording, instants: slice) -> Series:
    given = recording.measurement, recording.sensor_inputs, recording.motion_inputs
    return Series(*(_time_first(array, instants) for array in (*given, elapsed(recording))))


def _time_first(array: np.ndarray, instants: slice) -> np.ndarray:
    """Some instants of an array (B, T, ...), as (T, B, ...)."""
    return np.ascontiguousarray(array[:, instants].swapaxes(0, 1))


def _inconsistency(nees: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """How far the mean NEES of each episode in the chunk is from one, on a log scale."""
    number = counts.sum(dim=0)
    mean = torch.where(counts > 0.0, nees, 0.0).sum(dim=0) / number.clamp(min=1.0)
    off = torch.log(mean + CALM)
    each = 2.0 * torch.nn.functional.smooth_l1_loss(off, torch.zeros_like(off), reduction="none")
    some = number > 0.0
    return torch.where(some, each, 0.0).sum() / some.sum().clamp(min=1.0)
