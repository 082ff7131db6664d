"""What a motion and a sensor are: component functions and a description of their axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple


@dataclass(frozen=True)
class Component:
    """One state or one measured channel.

    Attributes:
        name: what it is, e.g. ``"x"`` or ``"azimuth"``.
        unit: its SI unit, e.g. ``"m"`` or ``"rad"``.
        group: channels of one group share a noise knob; states of one share a knob of their
            process noise, and those without a group have none of their own.
        angle: whether differences of it are wrapped to (-pi, pi].
    """

    name: str
    unit: str
    group: str = ""
    angle: bool = False


class MotionFunctions(NamedTuple):
    """A motion model's arithmetic on one backend; x, u are tuples of components.

    step(x, u, dt) gives the n components of the state dt later.
    noise_factor(x, u, dt) gives the entries of a lower factor of the discrete
    process-noise covariance at the positions ``Motion.noise_pattern``.
    """

    step: Callable
    noise_factor: Callable


@dataclass(frozen=True)
class Motion:
    """How the state moves.

    Attributes:
        name: e.g. ``"variable-turn"``.
        states: the n state components.
        position, velocity: indices of the three position and velocity components of a target;
            () where a `kfenv.models.yardstick.Yardstick` says what counts.
        noise_pattern: (row, column) of each entry that ``noise_factor`` returns.
        build: makes the arithmetic for a module of `kfenv.models.namespaces`.
        inputs: names of the known inputs u of a step (e.g. inertial rates).
    """

    name: str
    states: tuple[Component, ...]
    position: tuple[int, ...]
    velocity: tuple[int, ...]
    noise_pattern: tuple[tuple[int, int], ...]
    build: Callable[[ModuleType], MotionFunctions]
    inputs: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of states whose process noise has a knob of its own."""
        return tuple(dict.fromkeys(state.group for state in self.states if state.group))


@dataclass(frozen=True)
class Sensor:
    """What is measured.

    Attributes:
        name: e.g. ``"radar"``.
        channels: the m measured channels.
        build: makes measure(x, s) -> m components for a module of
            `kfenv.models.namespaces`.
        inputs: names of the known inputs s of a measurement (e.g. satellite positions).
    """

    name: str
    channels: tuple[Component, ...]
    build: Callable[[ModuleType], Callable]
    inputs: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """The channel groups, in the order of their first channel."""
        return tuple(dict.fromkeys(channel.group for channel in self.channels))

    @property
    def group_of_channel(self) -> tuple[int, ...]:
        """For each channel the index of its group."""
        return tuple(self.groups.index(channel.group) for channel in self.channels)
