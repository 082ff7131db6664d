"""How aircraft fly by their commands: heading rate, climb rate and speed, many aircraft at once.

Velocity and acceleration are closed formulas of the commands; position is the integral of
velocity, taken on a fixed inner grid so that it does not depend on the times asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INNER_STEP = 0.25  # s; position is then good to 1 mm


@dataclass(frozen=True)
class Commands:
    """C commands of each of B aircraft that move together between levels along raised-cosine edges.

    Attributes:
        begin: (B, K) when each edge begins, s.
        edge: (B, K) how long it lasts, s; it ends before the next begins.
        level: (C, B, K + 1) the values before, between and after the edges.
    """

    begin: Array
    edge: Array
    level: Array

    def at(self, time: Array) -> Legs:
        """The commands at each of the times (T,)."""
        # Before the first edge its phase stays 0, which leaves the first level.
        first = np.searchsorted(time, self.begin)
        first[:, 0] = 0
        instants = np.diff(first, append=time.size).ravel()
        legs = np.repeat(self._legs.reshape(len(self._legs), -1), instants, axis=1)
        begin, edge, *more = legs.reshape(len(legs), len(self.begin), time.size)
        integral, before, jump = np.reshape(more, (3, len(self.level), *begin.shape))
        since = time - begin
        phase = np.pi * np.clip(since / edge, 0.0, 1.0)
        return Legs(since, edge, phase, *_sine_and_cosine(phase), integral, before, jump)

    @cached_property
    def _legs(self) -> Array:
        """Begin and edge; per command integral and value at begin, and jump: (2 + 3C, B, K)."""
        before, jump = self.level[..., :-1], np.diff(self.level)
        missed = 0.5 * jump * self.edge  # by rising along the edge instead of at its begin
        gained = self.level[..., 1:-1] * np.diff(self.begin) - missed[..., :-1]
        integral = np.zeros_like(before)
        np.cumsum(gained, axis=-1, out=integral[..., 1:])
        return np.concatenate([self.begin[None], self.edge[None], integral, before, jump])


class Legs(NamedTuple):
    """Commands at instants.

    Attributes:
        since, edge: (B, T) time since the last edge began, and how long it lasts, s.
        phase, sine, cosine: (B, T) of the edge, from 0 to pi.
        before_edge, before, jump: (C, B, T) integral and value at its begin, and rise along it.
    """

    since: Array
    edge: Array
    phase: Array
    sine: Array
    cosine: Array
    before_edge: Array
    before: Array
    jump: Array

    def integral(self) -> Array:
        """From the first edge on, (C, B, T)."""
        half = (0.5 / np.pi) * self.edge * (self.phase - self.sine)
        area = np.maximum(self.since - self.edge, 0.0) + half
        return self.before_edge + self.before * self.since + self.jump * area

    def value(self) -> Array:
        """(C, B, T)."""
        return self.before + self.jump * (0.5 - 0.5 * self.cosine)

    def slope(self) -> Array:
        """(C, B, T) per second."""
        return self.jump * (0.5 * np.pi * self.sine / self.edge)


@dataclass(frozen=True)
class Flights:
    """The commands of B aircraft.

    Attributes:
        turns: heading rate, rad/s (C = 1).
        climbs_and_speeds: climb rate and speed along the path, m/s (C = 2).
        heading: (B,) at the time when the first turn's edge begins, rad.
    """

    turns: Commands
    climbs_and_speeds: Commands
    heading: Array

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Flights:
        """Those of the chosen aircraft."""
        turns, climbs = (
            Commands(given.begin[chosen], given.edge[chosen], given.level[:, chosen])
            for given in (self.turns, self.climbs_and_speeds)
        )
        return Flights(turns, climbs, self.heading[chosen])

    def motion(self, time: Array) -> Array:
        """Velocity and acceleration along the axes, (2, 3, B, T), in m/s and m/s^2."""
        turns, climbs_and_speeds = self.turns.at(time), self.climbs_and_speeds.at(time)
        (climb, speed), (climb_slope, speed_slope) = (
            climbs_and_speeds.value(), climbs_and_speeds.slope()
        )  # fmt: skip
        heading = turns.integral()[0] + self.heading[:, None]
        sine, cosine = np.sin(heading), np.cos(heading)
        ground = np.sqrt(speed * speed - climb * climb)
        along = (speed * speed_slope - climb * climb_slope) / ground
        across = ground * turns.value()[0]
        motion = np.empty((2, 3, *heading.shape))
        for to, given in zip(
            motion.reshape(6, *heading.shape),
            (
                ground * sine, ground * cosine, climb,
                along * sine + across * cosine, along * cosine - across * sine, climb_slope,
            ),
            strict=True,
        ):  # fmt: skip
            to[:] = given
        return motion

    def nodes(self, duration: float) -> Array:
        """Position from zero, velocity and acceleration at 0, 0.25, ... s.

        Returns:
            (3, 3, B, N): quantity, axis, aircraft, node; the last at the duration or just beyond.
        """
        time = INNER_STEP * np.arange(floor(duration / INNER_STEP) + 2)
        motion = self.motion(time)
        nodes = np.zeros((3, *motion.shape[1:]))
        nodes[1:] = motion
        steps = _travelled(INNER_STEP, nodes[1:, ..., :-1], nodes[1:, ..., 1:])
        np.cumsum(steps, axis=-1, out=nodes[0, ..., 1:])
        return nodes

    def states(self, nodes: Array, start: Array, time: Array) -> Array:
        """States (B, T, 9) at the times, in seconds from the first node.

        Args:
            nodes: of these flights, see `nodes`.
            start: (3, B) position at the first node, m.
            time: (T,) s.
        """
        k = (time / INNER_STEP).astype(int)
        motion = self.motion(time)
        node = nodes.take(k, axis=-1)
        travelled = _travelled(time - INNER_STEP * k, node[1:], motion)
        states = np.empty((*motion.shape[2:], 3, 3))  # aircraft, instant, axis, quantity
        states[..., 0] = np.moveaxis(node[0] + travelled + start[..., None], 0, -1)
        states[..., 1:] = np.moveaxis(motion, (0, 1), (-1, -2))
        return states.reshape(*states.shape[:2], 9)


def _sine_and_cosine(phase: Array) -> tuple[Array, Array]:
    """Of phases from 0 to pi, most of which are at an end."""
    ended = phase > 0.0
    sine, cosine = np.where(ended, np.sin(np.pi), 0.0), np.where(ended, -1.0, 1.0)
    rises = np.flatnonzero(ended & (phase < np.pi))
    rising = phase.ravel()[rises]
    sine.ravel()[rises], cosine.ravel()[rises] = np.sin(rising), np.cos(rising)
    return sine, cosine


def _travelled(step: Array | float, before: Array, after: Array) -> Array:
    """Integrate velocity over a step from its ends' velocity and acceleration (2, 3, ...).

    The trapezoid with its end correction, of fourth order.
    """
    return step * (0.5 * (before[0] + after[0]) + step / 12.0 * (before[1] - after[1]))
