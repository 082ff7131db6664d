"""Who takes part in a contest: agents, which see observations and set knobs a batch at a
time, and filters that go through whole recordings by themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import (
    CHANNEL_NOISE,
    FADING,
    MEASUREMENT_NOISE,
    PROCESS_NOISE,
    WIDEST_FADING,
    Knob,
    actions_for,
)
from kfenv.envs.options import Options
from kfenv.filters.results import History
from kfenv.models.model import Sensor
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Briefing:
    """What an agent is told before the episodes begin.

    Attributes:
        knobs: those that the action sets.
        scenario: what the episodes are drawn from: its sensor, and for the rules that know
            them its motion and its faults.
        batch: number of episodes in lock-step.
        seed: for agents that draw.
        recording: the episodes, for the clairvoyant alone; None for everyone else.
        decision_interval: filter steps per action.
        first, episodes: which of all episodes of the contest the first of these is, and how many
            all are, for agents that draw; None if these are all.
    """

    knobs: tuple[Knob, ...]
    scenario: TrackingScenario
    batch: int
    seed: int
    recording: Recording | None
    decision_interval: int = 1
    first: int = 0
    episodes: int | None = None

    @property
    def sensor(self) -> Sensor:
        """Channels and their groups."""
        return self.scenario.sensor


@dataclass(frozen=True)
class Parameter:
    """A number of an agent that tuning may choose, between low and high (log scale)."""

    name: str
    low: float
    high: float
    default: float


class Contestant:
    """Base of all that can be scored on recordings.

    Class attributes:
        parameters: what tuning may choose.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __init__(self, name: str, values: Mapping[str, float] | None = None) -> None:
        self.name = name
        self.values = {p.name: p.default for p in self.parameters} | dict(values or {})

    def tunable(self, scenario: TrackingScenario, knobs: Sequence[Knob]) -> tuple[Parameter, ...]:
        """What tuning may choose, given the scenario and the knobs that the agent can turn."""
        return self.parameters

    def with_values(self, values: Mapping[str, float]) -> Self:
        """The same contestant with other parameters."""
        return type(self)(self.name, values)

    def suited_to(self, scenario: TrackingScenario) -> Contestant:
        """Who plays in a scenario: itself, unless it stands for several."""
        return self

    def check(self, scenario: Any, options: Options, recording: Recording | None) -> None:
        """Complain, before a contest begins, if the contestant does not suit it.

        Args:
            scenario, options: of the environment.
            recording: some episode of it; None for agents, where there is none yet.

        Raises:
            ValueError: in one sentence.
        """


class RecordingFilter(Contestant, ABC):
    """Base of filters that turn a whole recording into a history, without knobs or decisions."""

    @abstractmethod
    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """Filter every episode of a recording, whose truth and faults are not shown."""


class Agent(Contestant, ABC):
    """Base of all agents: reset once per briefing, then one action per decision.

    Class attributes:
        all_knobs: whether the agent wants every knob, whatever the environment exposes.
        single_channels: whether it wants a noise knob for each channel besides.
        clairvoyant: whether it may look into the recording.
        sees: what it decides by and so must pay for: "observation", the pending "innovation"
            and what else `act` finds in info, or "nothing" of both.
    """

    all_knobs: ClassVar[bool] = True
    single_channels: ClassVar[bool] = False
    clairvoyant: ClassVar[bool] = False
    sees: ClassVar[str] = "innovation"

    def reset(self, briefing: Briefing) -> None:
        """Forget the last briefing."""
        self.briefing = briefing

    @property
    def own_options(self) -> dict[str, Any]:
        """Options of the environment that belong to the agent."""
        if self.single_channels:
            return {"actions": (FADING, PROCESS_NOISE.name, MEASUREMENT_NOISE, CHANNEL_NOISE)}
        return {"actions": None, "most_fading": WIDEST_FADING} if self.all_knobs else {}

    @abstractmethod
    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        """Actions (B, K) for observations (B, D) and the arrays of the info dictionary.

        They are `Core.information`'s, less what needs the truth: in channels that are missing
        ``innovation`` and ``innovation_variance`` are NaN, where the ``info`` that a user of
        ``env.step`` gets has zero and infinity.
        """


def knob_actions(
    briefing: Briefing,
    fading: Array | float = 1.0,
    process_noise: Array | float = 1.0,
    channel_noise: Array | None = None,
) -> Array:
    """The actions (B, K) that set these factors.

    Args:
        fading, process_noise: (B,) or one number.
        channel_noise: (B, m) factors of the channels' noise deviation, NaN for channels
            that did not arrive. Where channels have knobs these take them; else the
            others of a group share its knob, which takes their root mean square.
    """
    factors = {"fading": fading, "process_noise": process_noise}
    if channel_noise is not None:
        names = [channel.name for channel in briefing.sensor.channels]
        if any(knob.name in names for knob in briefing.knobs):
            own = np.where(np.isnan(channel_noise), 1.0, channel_noise)
            factors |= dict(zip(names, own.T, strict=True))
        else:
            factors |= _shared(briefing.sensor, channel_noise)
    columns = [
        np.broadcast_to(factors.get(knob.name, 1.0), briefing.batch) for knob in briefing.knobs
    ]
    return actions_for(np.stack(columns, axis=1), briefing.knobs)


def _shared(sensor: Sensor, channel_noise: Array) -> dict[str, Array]:
    """The groups' knobs: the root mean square of the channels that arrived."""
    factors = {}
    for group, channels in channels_of(sensor).items():
        square = channel_noise[:, channels] ** 2
        count = np.sum(~np.isnan(square), axis=1)
        mean = np.nansum(square, axis=1) / np.maximum(count, 1)
        factors[f"{group}_noise"] = np.where(count > 0, np.sqrt(mean), 1.0)
    return factors


def channels_of(sensor: Sensor) -> dict[str, Sequence[int]]:
    """The channel indices of each group."""
    return {
        group: [c for c, g in enumerate(sensor.group_of_channel) if g == i]
        for i, group in enumerate(sensor.groups)
    }
