"""How aircraft fly by their commands: heading rate, climb rate and speed, many aircraft at once.

Velocity and acceleration are closed formulas of the commands; position is the integral of
velocity, taken on a fixed inner grid so that it does not depend on the times asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, floor, pi, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.kernel_cache import INNER_KERNEL, KERNEL

Array = NDArray[np.float64]

INNER_STEP = 0.25  # s; position is then good to 1 mm
SINE_AT_THE_END, COSINE_AT_THE_END = sin(pi), cos(pi)  # of an edge


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

    @cached_property
    def legs(self) -> Array:
        """Begin and edge; per command integral and value at begin, and jump: (2 + 3C, B, K)."""
        before, jump = self.level[..., :-1], np.diff(self.level)
        missed = 0.5 * jump * self.edge  # by rising along the edge instead of at its begin
        gained = self.level[..., 1:-1] * np.diff(self.begin) - missed[..., :-1]
        integral = np.zeros_like(before)
        np.cumsum(gained, axis=-1, out=integral[..., 1:])
        return np.concatenate([self.begin[None], self.edge[None], integral, before, jump])


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

    def motion(self, time: Array, out: Array | None = None) -> Array:
        """Velocity and acceleration along the axes, (2, 3, B, T), in m/s and m/s^2."""
        motion = np.empty((2, 3, len(self.heading), time.size)) if out is None else out
        _fly(self.turns.legs, self.climbs_and_speeds.legs, self.heading, time, motion)
        return motion

    def nodes(self, duration: float) -> Array:
        """Position from zero, velocity and acceleration at 0, 0.25, ... s.

        Returns:
            (3, 3, B, N): quantity, axis, aircraft, node; the last at the duration or just beyond.
        """
        time = INNER_STEP * np.arange(floor(duration / INNER_STEP) + 2)
        nodes = np.empty((3, 3, len(self.heading), time.size))
        velocity, acceleration = self.motion(time, out=nodes[1:])
        nodes[0, ..., 0] = 0.0
        np.cumsum(_travelled(velocity, acceleration), axis=-1, out=nodes[0, ..., 1:])
        return nodes

    def states(self, nodes: Array, start: Array, time: Array) -> Array:
        """States (B, T, 9) at the times, in seconds from the first node.

        Args:
            nodes: of these flights, see `nodes`.
            start: (3, B) position at the first node, m.
            time: (T,) s.
        """
        motion = self.motion(time)
        states = np.empty((*motion.shape[2:], 9))
        _move(nodes, motion, np.ascontiguousarray(start), time, states)
        return states


def _travelled(velocity: Array, acceleration: Array) -> Array:
    """The way (..., N - 1) from each node to the next.

    The trapezoid of velocity with its end correction, of fourth order.
    """
    bend = acceleration[..., :-1] - acceleration[..., 1:]
    bend *= INNER_STEP / 12.0
    way = velocity[..., :-1] + velocity[..., 1:]
    way *= 0.5
    way += bend
    way *= INNER_STEP
    return way


@njit(**KERNEL)
def _move(nodes, motion, start, time, states):
    """Write the states (B, T, 9), see `Flights.states`: position as by `_travelled`."""
    for b in range(states.shape[0]):
        for t in range(time.size):
            k = int(time[t] / INNER_STEP)
            step = time[t] - INNER_STEP * k
            for axis in range(3):
                velocity, acceleration = motion[0, axis, b, t], motion[1, axis, b, t]
                mean = 0.5 * (nodes[1, axis, b, k] + velocity)
                bend = step / 12.0 * (nodes[2, axis, b, k] - acceleration)
                position = nodes[0, axis, b, k] + step * (mean + bend) + start[axis, b]
                states[b, t, 3 * axis] = position
                states[b, t, 3 * axis + 1] = velocity
                states[b, t, 3 * axis + 2] = acceleration


@njit(**KERNEL)
def _fly(turns, climbs, heading, time, motion):
    """Write velocity and acceleration (2, 3, B, T), see `Flights.motion`."""
    for b in range(heading.size):
        i = j = 0
        for t in range(time.size):
            while i + 1 < turns.shape[2] and turns[0, b, i + 1] <= time[t]:
                i += 1
            while j + 1 < climbs.shape[2] and climbs[0, b, j + 1] <= time[t]:
                j += 1
            since, edge, phase, sine, cosine = _along(turns, b, i, time[t])
            level = since - edge if since > edge else 0.0
            area = level + 0.5 / pi * edge * (phase - sine)
            angle = turns[2, b, i] + turns[3, b, i] * since + turns[4, b, i] * area + heading[b]
            rate = turns[3, b, i] + turns[4, b, i] * (0.5 - 0.5 * cosine)
            since, edge, phase, sine, cosine = _along(climbs, b, j, time[t])
            risen, rise = 0.5 - 0.5 * cosine, 0.5 * pi * sine / edge
            climb = climbs[4, b, j] + climbs[6, b, j] * risen
            speed = climbs[5, b, j] + climbs[7, b, j] * risen
            climb_slope, speed_slope = climbs[6, b, j] * rise, climbs[7, b, j] * rise
            ground = sqrt(speed * speed - climb * climb)
            along = (speed * speed_slope - climb * climb_slope) / ground
            across = ground * rate
            sine, cosine = sin(angle), cos(angle)
            motion[0, 0, b, t], motion[0, 1, b, t] = ground * sine, ground * cosine
            motion[1, 0, b, t] = along * sine + across * cosine
            motion[1, 1, b, t] = along * cosine - across * sine
            motion[0, 2, b, t], motion[1, 2, b, t] = climb, climb_slope


@njit(**INNER_KERNEL)
def _along(legs, b, leg, now):
    """Time since an edge began, its length, and its phase (0 to pi) with sine and cosine."""
    since, edge = now - legs[0, b, leg], legs[1, b, leg]
    if since <= 0.0:  # before the first edge, which leaves the first level
        return since, edge, 0.0, 0.0, 1.0
    if since >= edge:  # most of the time: no functions are called for what is known
        return since, edge, pi, SINE_AT_THE_END, COSINE_AT_THE_END
    phase = pi * (since / edge)
    return since, edge, phase, sin(phase), cos(phase)
