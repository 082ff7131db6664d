"""Aircraft trajectories about a radar: two for the papers' cases, and random ones for training.

A trajectory is an array (T, 9) of axis-major states [x, vx, ax, y, vy, ay, z, vz, az]
(x east, y north, z up, radar at the origin; SPEC section 1). Three commands fly the
aircraft: heading rate, climb rate and speed, each constant between smooth edges.
Velocity and acceleration are closed formulas of the commands; position is the
integral of velocity, taken on a fixed inner grid so that it does not depend on
the times asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, radians
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from kfenv.models.model import Motion
from kfenv.models.namespaces import scalar
from kfenv.names import unknown
from kfenv.scenarios.coverage import (
    CHECK_STEP,
    MAX_RANGE,
    MIN_RANGE,
    Placement,
    check_time,
    place,
    turn,
)

Array = NDArray[np.float64]

# For the papers' cases (SPEC 7.1): no paper gives its trajectory, these are ours, drawn to fill
# the axes of the papers' figures: (begin s, end s, rate in deg/s or m/s).
PAPER_SPEED = {"A": 133.0, "B": 130.0}  # m/s
PAPER_START = {"A": (-10_000.0, 1_000.0, 300.0), "B": (-6_500.0, 6_500.0, 400.0)}  # m
PAPER_TURNS = {
    "A": ((20, 35, 1.0), (35, 50, -1.0), (110, 203, -2.0)),
    "B": ((15, 35, 1.5), (35, 55, -1.5), (75, 168, -2.0), (205, 235, 2.0)),
}
PAPER_CLIMBS = {
    "A": ((30, 120, 10.0), (150, 200, 8.0), (215, 245, -12.0)),
    "B": ((20, 120, 8.0), (150, 200, 6.0), (210, 245, -10.0)),
}
PAPER_TURN_EDGE, PAPER_CLIMB_EDGE = 3.0, 8.0  # s

MIN_ALTITUDE, MAX_ALTITUDE = 150.0, 3_000.0  # m above the radar
MAX_DURATION = 600.0  # s; a longer flight hardly ever stays in coverage
MAX_ATTEMPTS = 1_000

INNER_STEP = 0.25  # s; position is then good to 1 mm


@dataclass(frozen=True)
class Style:
    """What a random flight may do; pairs are the least and the greatest.

    Attributes:
        speed: m/s; speed_change: the most from one leg to the next, m/s.
        turn_rate: of a turn, either way, rad/s; climb: of a climb or descent, m/s.
        turn_leg, climb_leg: time from one edge to the next, s.
        turn_edge, climb_edge: how long an edge lasts, s.
        turning, climbing, accelerating: shares of the legs that do so.
    """

    speed: tuple[float, float]
    speed_change: float
    turn_rate: tuple[float, float]
    climb: tuple[float, float]
    turn_leg: tuple[float, float]
    turn_edge: tuple[float, float]
    climb_leg: tuple[float, float]
    climb_edge: tuple[float, float]
    turning: float
    climbing: float
    accelerating: float


STYLES = {
    "manoeuvring": Style(
        speed=(35.0, 140.0), speed_change=25.0,
        turn_rate=(radians(2.0), radians(10.0)), climb=(2.0, 12.0),
        turn_leg=(6.0, 25.0), turn_edge=(2.0, 5.0), climb_leg=(15.0, 40.0), climb_edge=(8.0, 12.0),
        turning=0.6, climbing=0.5, accelerating=0.6,
    ),
    "gentle": Style(
        speed=(45.0, 190.0), speed_change=20.0,
        turn_rate=(0.0, radians(3.5)), climb=(0.0, 8.0),
        turn_leg=(12.0, 60.0), turn_edge=(3.0, 9.0),
        climb_leg=(20.0, 60.0), climb_edge=(8.0, 16.0),
        turning=0.5, climbing=0.5, accelerating=0.5,
    ),
    "smooth": Style(
        speed=(60.0, 230.0), speed_change=10.0,
        turn_rate=(0.0, radians(1.5)), climb=(0.0, 5.0),
        turn_leg=(30.0, 90.0), turn_edge=(6.0, 12.0),
        climb_leg=(30.0, 90.0), climb_edge=(12.0, 20.0),
        turning=0.5, climbing=0.5, accelerating=0.3,
    ),
}  # fmt: skip


def paper_trajectory(name: Literal["A", "B"], time: ArrayLike) -> Array:
    """Return trajectory A or B of SPEC 7.1, ours: no paper tells how its aircraft flew.

    The raised-cosine edges (3 s of heading rate, 8 s of climb) lie inside the stated
    windows: a command leaves zero at a window's begin and is back there at its end.
    Only so do SPEC's figures come out, e.g. A's closest approach of 922 m at 75.1 s
    (edges centred on the ends of the windows give 895 m).

    Args:
        name: "A" (experiments E1, E2) or "B" (E3, E4).
        time: (T,) increasing, from 0 s on; after 250 s both fly straight on.

    Returns:
        States (T, 9) in m, m/s, m/s^2.

    Raises:
        ValueError: if the name is unknown or the times are unusable.
    """
    if name not in PAPER_START:
        raise ValueError(f"name must be 'A' or 'B', got {name!r}.")
    time = check_time(time)
    if time[0] < 0.0:
        raise ValueError(f"trajectory {name} begins at 0 s, time at {time[0]:g} s.")
    turns = [(begin, end, (np.radians(rate),)) for begin, end, rate in PAPER_TURNS[name]]
    climbs = [(begin, end, (rate, 0.0)) for begin, end, rate in PAPER_CLIMBS[name]]
    flight = Flight(
        turns=_windows(turns, PAPER_TURN_EDGE, base=(0.0,)),
        climbs_and_speeds=_windows(climbs, PAPER_CLIMB_EDGE, base=(0.0, PAPER_SPEED[name])),
        heading=np.pi / 2,
    )
    start = np.array(PAPER_START[name])
    return _states(flight, _fly(flight, time[-1]), start, time)


def drawn_trajectory(
    rng: Generator, motion: Motion, start: Array, time: Array, inputs: Array | None = None
) -> Array:
    """States (T, n) drawn from a motion model itself, its discrete noise included.

    Args:
        rng: where the noise comes from.
        motion: the model.
        start: (n,) state at the first time.
        time: (T,) increasing, s.
        inputs: (T, p), those at an index for the step that leads there; None if it takes none.
    """
    inputs = np.empty((len(time), 0)) if inputs is None else inputs
    angles = [state.angle for state in motion.states]
    model = motion.build(scalar)
    truth = np.zeros((len(time), len(start)))
    truth[0] = start
    factor = np.zeros((len(start), len(start)))
    rows, columns = np.array(motion.noise_pattern, int).reshape(-1, 2).T
    noise = rng.standard_normal((len(time) - 1, len(start)))
    for k, dt in enumerate(np.diff(time).tolist()):
        state = truth[k].tolist()
        known = inputs[k + 1].tolist()
        factor[rows, columns] = model.noise_factor(state, known, dt)
        truth[k + 1] = model.step(state, known, dt) + factor @ noise[k]
    truth[:, angles] -= 2.0 * np.pi * np.floor(truth[:, angles] / (2.0 * np.pi) + 0.5)
    return truth


def random_trajectory(rng: Generator, time: ArrayLike, flights: str = "manoeuvring") -> Array:
    """Return a random flight that stays in the radar's coverage (`kfenv.scenarios.coverage`).

    Straight legs and turns follow one another, and independently of them level legs, climbs
    and descents with changes of speed. Height stays within 150 to 3000 m. The flight is
    then turned about the vertical and shifted at random; a flight that does not fit is
    redrawn, so long flights are those that turn more, or are slower.

    Args:
        rng: where the flight comes from; the same state gives the same bits.
        time: (T,) increasing, s. Flights of one duration do not depend on the sampling.
        flights: "manoeuvring" (turns of 2 to 10 deg/s, climbs of 2 to 12 m/s, 35 to
            140 m/s), "smooth" (long legs, turns of up to 1.5 deg/s, climbs of up to
            5 m/s, 60 to 230 m/s), or "gentle" (in between), see `STYLES`.

    Returns:
        States (T, 9) in m, m/s, m/s^2.

    Raises:
        ValueError: if the times are unusable or span more than 600 s, or flights are unknown.
        RuntimeError: if no flight stayed in coverage (none seen up to 600 s, smooth 400 s).
    """
    style, time = style_of(flights), check_time(time)
    elapsed = time - time[0]
    duration = round(float(elapsed[-1]), 6)  # 0.1 * 1200 and 0.5 * 240 are the same flight
    if duration > MAX_DURATION:
        raise ValueError(
            f"a random trajectory lasts at most {MAX_DURATION:g} s, time spans {duration:g} s; "
            "split it into episodes."
        )
    for _ in range(MAX_ATTEMPTS):
        flight = _random_flight(rng, duration, style)
        nodes = _fly(flight, duration)
        start = _random_start(rng, nodes)
        if start is not None:
            placement, height = start
            turned = Flight(
                flight.turns, flight.climbs_and_speeds, flight.heading + placement.angle
            )
            nodes[:, :2] = turn(nodes[:, :2], placement.angle)
            return _states(turned, nodes, np.append(placement.shift, height), elapsed)
    raise RuntimeError(
        f"no random flight of {duration:g} s stayed in coverage; ask for a shorter one."
    )


def style_of(flights: str) -> Style:
    """The style of that name.

    Raises:
        ValueError: if there is none.
    """
    if flights not in STYLES:
        raise ValueError(unknown("flights", flights, STYLES))
    return STYLES[flights]


@dataclass(frozen=True)
class Commands:
    """C commands that move together between levels along raised-cosine edges.

    Attributes:
        begin: (K,) when each edge begins, s.
        edge: (K,) how long it lasts, s; it ends before the next begins.
        level: (C, K + 1) the values before, between and after the edges.
    """

    begin: Array
    edge: Array
    level: Array

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """Return integral (from the first edge on), value and slope, each (C, T)."""
        # Before the first edge its phase stays 0, which leaves the first level.
        leg = np.maximum(np.searchsorted(self.begin, time, side="right") - 1, 0)
        begin, edge, *legs = self._legs.take(leg, axis=1)
        integral, before, jump = np.reshape(legs, (3, -1, time.size))
        since = time - begin
        phase = np.pi * np.clip(since / edge, 0.0, 1.0)
        sine = np.sin(phase)
        risen = 0.5 - 0.5 * np.cos(phase)
        area = np.maximum(since - edge, 0.0) + (0.5 / np.pi) * edge * (phase - sine)
        return (
            integral + before * since + jump * area,
            before + jump * risen,
            jump * (0.5 * np.pi * sine / edge),
        )

    @cached_property
    def _legs(self) -> Array:
        """Begin and edge; then, per command, integral and value at begin, and jump: (2+3C, K)."""
        before, jump = self.level[:, :-1], np.diff(self.level)
        missed = 0.5 * jump * self.edge  # by rising along the edge instead of at its begin
        gained = self.level[:, 1:-1] * np.diff(self.begin) - missed[:, :-1]
        integral = np.zeros_like(before)
        np.cumsum(gained, axis=1, out=integral[:, 1:])
        return np.vstack([self.begin, self.edge, integral, before, jump])


@dataclass(frozen=True)
class Flight:
    """An aircraft's commands.

    Attributes:
        turns: heading rate, rad/s (C = 1).
        climbs_and_speeds: climb rate and speed along the path, m/s (C = 2).
        heading: at the time when the first turn's edge begins, rad.
    """

    turns: Commands
    climbs_and_speeds: Commands
    heading: float

    def motion(self, time: Array) -> Array:
        """Return velocity and acceleration along the axes, (2, 3, T), in m/s and m/s^2."""
        (heading,), (turn_rate,), _ = self.turns.evaluate(time)
        _, (climb, speed), (climb_slope, speed_slope) = self.climbs_and_speeds.evaluate(time)
        heading = heading + self.heading
        sine, cosine = np.sin(heading), np.cos(heading)
        ground = np.sqrt(speed * speed - climb * climb)
        along = (speed * speed_slope - climb * climb_slope) / ground
        across = ground * turn_rate
        motion = np.empty((2, 3, time.size))
        motion[0] = ground * sine, ground * cosine, climb
        motion[1] = along * sine + across * cosine, along * cosine - across * sine, climb_slope
        return motion


def _fly(flight: Flight, duration: float) -> Array:
    """Return the nodes: position from zero, velocity and acceleration at 0, 0.25, ... s.

    Returns:
        (3, 3, N): quantity, axis, node; the last at the duration or just beyond.
    """
    time = INNER_STEP * np.arange(floor(duration / INNER_STEP) + 2)
    nodes = np.zeros((3, 3, time.size))
    nodes[1:] = flight.motion(time)
    np.cumsum(
        _travelled(INNER_STEP, nodes[1:, :, :-1], nodes[1:, :, 1:]), axis=1, out=nodes[0, :, 1:]
    )
    return nodes


def _travelled(step: Array | float, before: Array, after: Array) -> Array:
    """Integrate velocity over a step from its ends' velocity and acceleration (2, 3, ...).

    The trapezoid with its end correction, of fourth order.
    """
    return step * (0.5 * (before[0] + after[0]) + step / 12.0 * (before[1] - after[1]))


def _states(flight: Flight, nodes: Array, start: Array, time: Array) -> Array:
    """Return the states (T, 9) at the times, in seconds from the first node."""
    k = (time / INNER_STEP).astype(int)
    motion = flight.motion(time)
    node = nodes.take(k, axis=2)
    states = np.empty((3, 3, time.size))
    states[0] = node[0] + _travelled(time - INNER_STEP * k, node[1:], motion) + start[:, None]
    states[1:] = motion
    return states.transpose(2, 1, 0).reshape(time.size, 9)


def _windows(
    windows: list[tuple[float, float, tuple[float, ...]]], edge: float, base: tuple[float, ...]
) -> Commands:
    """Make commands that leave their base for (begin, end, added values), edges inside."""
    begin = np.array([start for low, high, _ in windows for start in (low, high - edge)])
    level = np.tile(np.array(base, dtype=float)[:, None], begin.size + 1)
    level[:, 1::2] += np.array([values for _, _, values in windows]).T
    return Commands(begin, np.full(begin.size, edge), level)


def _random_flight(rng: Generator, duration: float, style: Style) -> Flight:
    begin, edge = _random_legs(rng, duration, style.turn_leg, style.turn_edge)
    rate = _either_way(rng, style.turn_rate, style.turning, begin.size + 1)
    turns = Commands(begin, edge, rate[None, :])

    begin, edge = _random_legs(rng, duration, style.climb_leg, style.climb_edge)
    climb = _either_way(rng, style.climb, style.climbing, begin.size + 1)
    change = _either_way(rng, (0.0, style.speed_change), style.accelerating, begin.size + 1)
    slowest, span = style.speed[0], style.speed[1] - style.speed[0]
    change[0] = rng.uniform(0.0, span)
    speed = slowest + _folded(np.cumsum(change), span)
    return Flight(turns, Commands(begin, edge, np.stack([climb, speed])), heading=0.0)


def _random_legs(
    rng: Generator, duration: float, leg: tuple[float, float], edge: tuple[float, float]
) -> tuple[Array, Array]:
    """Draw when edges begin and how long they last, from before 0 s to the duration."""
    count = ceil((duration + leg[1]) / leg[0])
    begin = np.cumsum(rng.uniform(*leg, count)) - leg[1]
    return begin, rng.uniform(*edge, count)


def _either_way(rng: Generator, size: tuple[float, float], share: float, count: int) -> Array:
    """Draw values of a size within the pair, of either sign; all but a share are 0."""
    size = rng.uniform(*size, count)
    sign = np.where(rng.random(count) < 0.5, -1.0, 1.0)
    return np.where(rng.random(count) < share, sign * size, 0.0)


def _folded(values: Array, most: float) -> Array:
    """Reflect values into 0 to most, as a ball between two walls; no step gets longer."""
    return most - np.abs(values % (2.0 * most) - most)


def _random_start(rng: Generator, nodes: Array) -> tuple[Placement, float] | None:
    """Draw the placement and first height that keep a flight in coverage, if there are any."""
    every = round(CHECK_STEP / INNER_STEP)
    path = np.hstack([nodes[0, :, ::every], nodes[0, :, -1:]])
    low, high = nodes[0].min(axis=1), nodes[0].max(axis=1)
    least, most = MIN_ALTITUDE - low[2], MAX_ALTITUDE - high[2]
    if most < least:
        return None
    height = rng.uniform(least, most)
    path[2] += height
    placement = place(rng, path, 0.5 * (low + high)[:2], (MIN_RANGE, MAX_RANGE))
    return None if placement is None else (placement, height)
