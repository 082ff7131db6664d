"""Episodes rolled by a network, and all that is learnt from them afterwards."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.knobs import Knob, actions_for
from kfenv.filters.results import Prediction, Update
from kfenv.scenarios.recording import Recording

from ...contest.rollout import without_truth
from ...contestants.agent import Agent, Briefing
from ..channelwise import Network
from .worlds import Part

Array = NDArray[np.float64]


@dataclass
class Roll:
    """N decisions of B episodes in lock-step.

    Attributes:
        core: with the last state, for its knobs and scenario.
        recording: the episodes.
        observations: (N, B, D) float32.
        running: (N, B) whether the episode was on.
        memories: (N, B, H) the network's, before each decision.
        predictions: of the filter, before the decisions that were asked for.
        squared_error: (B,) mean over the instants that count until the end, or the loss, m^2.
        labels, valid: (N, B, K) the teacher's log factors, NaN-free, and which of them count.
    """

    core: Core
    recording: Recording
    observations: NDArray[np.float32]
    running: NDArray[np.bool_]
    memories: NDArray[np.float32]
    predictions: dict[int, Prediction]
    squared_error: Array
    labels: NDArray[np.float32]
    valid: NDArray[np.bool_]


class Watched:
    """A filter that tells from which prediction the pending innovation was formed.

    Attributes:
        prediction: with the process noise as it is before knobs of single states turn it.
    """

    def __init__(self, filter: Any) -> None:
        self._filter, self.prediction = filter, None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._filter, name)

    def innovate(self, prediction: Prediction, *rest: Any) -> Update:
        """As the filter's."""
        self.prediction = prediction
        return self._filter.innovate(prediction, *rest)


def roll(
    network: Network,
    part: Part,
    recording: Recording,
    *,
    teacher: Agent | None = None,
    jitter: tuple[Generator, float] | None = None,
    keep: Collection[int] = (),
) -> Roll:
    """Roll a network over all episodes of a recording.

    Args:
        teacher: says at each decision what it would have done.
        jitter: roll the teacher itself, with this deviation added to its log factors.
        keep: decisions before which the filter's prediction is kept.
    """
    options = replace(part.options, recording=recording, reward="rmse")
    core = Core(part.scenario, options, len(recording), recording.time, has_truth=True)
    watched = Watched(core.filter)
    if keep:  # by itself the engine writes in place
        core.filter = watched
    core.load(np.arange(len(recording)), recording)
    if teacher is not None:
        shown = recording if teacher.clairvoyant else None
        briefing = Briefing(core.knobs, part.scenario, core.batch, 0, shown, core.interval)
        teacher.reset(briefing)
    running, memory = np.ones(core.batch, bool), network.start(core.batch)
    seen, on, memories, labels, predictions = [], [], [], [], {}
    while running.any():
        observation = core.observation()
        seen.append(observation)
        on.append(running.copy())
        memories.append(memory.numpy())
        if teacher is not None:
            labels.append(log_factors(teacher.act(observation, without_truth(core)), core.knobs))
        if jitter is None:
            with torch.no_grad():
                wanted, memory = network(torch.from_numpy(observation)[None], memory)
            logs = wanted[0].numpy().astype(np.float64)
        else:
            rng, deviation = jitter
            logs = labels[-1] + deviation * rng.standard_normal(labels[-1].shape)
        if len(on) - 1 in keep:
            predictions[len(on) - 1] = Prediction(*(part.copy() for part in watched.prediction))
        _, lost, ended = core.step(actions_for(np.exp(logs), core.knobs), running)
        running = running & ~(lost | ended)
    stacked = np.array(labels, np.float32) if labels else np.zeros((len(on), 0, 0), np.float32)
    valid = _valid(core, recording, teacher, np.array(on)) if labels else stacked.astype(bool)
    mean = core.total_squared_error / np.maximum(core.total_scored, 1.0)
    return Roll(
        core, recording, np.array(seen), np.array(on), np.array(memories), predictions, mean,
        stacked, valid,
    )  # fmt: skip


def log_factors(actions: Array, knobs: tuple[Knob, ...]) -> Array:
    """What actions (..., K) set, as logarithms."""
    high = np.log([knob.high for knob in knobs])
    low = np.log([knob.low for knob in knobs])
    return np.where(actions >= 0.0, actions * high, -actions * low)


def _valid(
    core: Core, recording: Recording, teacher: Agent, running: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which labels (N, B, K) count: of a clairvoyant not those of channels that are missing."""
    valid = np.repeat(running[:, :, None], len(core.knobs), axis=2)
    if not teacher.clairvoyant:
        return valid
    instants = np.minimum(np.arange(len(running)) * core.interval, recording.time.shape[-1] - 1)
    arrived = ~np.isnan(recording.measurement[:, instants]).swapaxes(0, 1)  # (N, B, m)
    channels = core.scenario.sensor.channels
    for k, knob in enumerate(core.knobs):
        own = [
            c for c, channel in enumerate(channels)
            if knob.name in (channel.name, f"{channel.group}_noise")
        ]  # fmt: skip
        if own:
            valid[:, :, k] &= arrived[:, :, own].any(axis=2)
    return valid
