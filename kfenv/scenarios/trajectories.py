"""Aircraft trajectories about a radar: two for the papers' cases, and random ones for training.

A trajectory is an array (T, 9) of axis-major states [x, vx, ax, y, vy, ay, z, vz, az]
(x east, y north, z up, radar at the origin; SPEC section 1). Three commands fly the
aircraft: heading rate, climb rate and speed, each constant between smooth edges
(`kfenv.scenarios.flight`). Random flights are drawn together, each from its own generator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, radians
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from kfenv.models.model import Motion
from kfenv.models.namespaces import batch, scalar
from kfenv.names import unknown
from kfenv.scenarios.coverage import (
    CHECK_STEP,
    MAX_RANGE,
    MIN_RANGE,
    check_time,
    places,
    turn,
)
from kfenv.scenarios.draws import Draws, normal
from kfenv.scenarios.flight import INNER_STEP, Commands, Flights

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
    flight = Flights(
        turns=_windows(turns, PAPER_TURN_EDGE, base=(0.0,)),
        climbs_and_speeds=_windows(climbs, PAPER_CLIMB_EDGE, base=(0.0, PAPER_SPEED[name])),
        heading=np.array([np.pi / 2]),
    )
    start = np.array(PAPER_START[name])[:, None]
    return flight.states(flight.nodes(time[-1]), start, time)[0]


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


def accelerated_flights(
    rngs: Sequence[Generator], motion: Motion, start: Array, time: Array
) -> Array:
    """Flights (B, T, 9) of `constant_acceleration`: the bits of `drawn_trajectory`, all at once.

    Args:
        rngs: where the noise of each comes from.
        motion: that model.
        start: (9,) their state at the first time.
        time: (T,) increasing, s.
    """
    dt = np.diff(time)
    entries = motion.build(batch).noise_factor((np.zeros(dt.size),) * 9, (), dt)
    rows, columns = np.transpose(motion.noise_pattern)
    factor = np.zeros((dt.size, 9, 9))
    factor[:, rows, columns] = np.transpose(entries)
    noise = (factor @ normal(rngs, (dt.size, 9))[..., None])[..., 0]
    dt, half = dt[:, None], (0.5 * dt * dt)[:, None]
    acceleration = _summed(start[2::3], noise[..., 2::3])
    velocity = _summed(start[1::3], dt * acceleration[:, :-1], noise[..., 1::3])
    way = dt * velocity[:, :-1], half * acceleration[:, :-1]
    position = _summed(start[::3], *way, noise[..., ::3])
    flights = np.stack((position, velocity, acceleration), axis=-1)
    return flights.reshape(*flights.shape[:2], 9)


def _summed(start: Array, *terms: Array) -> Array:
    """Sums (B, T, 3) of terms (B, T - 1, 3) added in turn, from the start (3,) on."""
    steps = np.stack(terms, axis=2)
    begin = np.broadcast_to(start, (len(steps), 1, 3))
    values = np.concatenate([begin, steps.reshape(len(steps), -1, 3)], axis=1)
    return np.cumsum(values, axis=1)[:, :: len(terms)]


def random_trajectory(rng: Generator, time: ArrayLike, flights: str = "manoeuvring") -> Array:
    """One random flight (T, 9), see `random_trajectories`."""
    return random_trajectories([rng], time, flights)[0]


def random_trajectories(
    rngs: Sequence[Generator], time: ArrayLike, flights: str = "manoeuvring"
) -> Array:
    """Random flights that stay in the radar's coverage (`kfenv.scenarios.coverage`).

    Straight legs and turns follow one another, and independently of them level legs, climbs
    and descents with changes of speed. Height stays within 150 to 3000 m. The flight is
    then turned about the vertical and shifted at random; a flight that does not fit is
    redrawn, so long flights are those that turn more, or are slower.

    Args:
        rngs: where the B flights come from; the same state gives the same bits.
        time: (T,) increasing, s. Flights of one duration do not depend on the sampling.
        flights: "manoeuvring" (turns of 2 to 10 deg/s, climbs of 2 to 12 m/s, 35 to
            140 m/s), "smooth" (long legs, turns of up to 1.5 deg/s, climbs of up to
            5 m/s, 60 to 230 m/s), or "gentle" (in between), see `STYLES`.

    Returns:
        States (B, T, 9) in m, m/s, m/s^2.

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
    states, waiting = np.empty((len(rngs), time.size, 9)), np.arange(len(rngs))
    for _ in range(MAX_ATTEMPTS):
        fits, flown = _attempt([rngs[i] for i in waiting], duration, style, elapsed)
        if len(flown) == len(rngs):
            return flown
        states[waiting[fits]] = flown
        waiting = waiting[~fits]
        if not len(waiting):
            return states
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


def _windows(
    windows: list[tuple[float, float, tuple[float, ...]]], edge: float, base: tuple[float, ...]
) -> Commands:
    """Make commands that leave their base for (begin, end, added values), edges inside."""
    begin = np.array([[start for low, high, _ in windows for start in (low, high - edge)]])
    level = np.tile(np.array(base, dtype=float)[:, None], begin.size + 1)
    level[:, 1::2] += np.array([values for _, _, values in windows]).T
    return Commands(begin, np.full(begin.shape, edge), level[:, None])


def _attempt(
    rngs: Sequence[Generator], duration: float, style: Style, time: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Draw a flight from each generator: which (B,) stay in coverage, and their states."""
    flights = _random_flights(rngs, duration, style)
    nodes = flights.nodes(duration)
    fits, angle, start = _random_starts(rngs, nodes)
    if not fits.all():
        flights, nodes = flights[fits], nodes[:, :, fits]
    flights = replace(flights, heading=flights.heading + angle)
    level = np.moveaxis(nodes[:, :2], 2, 0)
    nodes[:, :2] = np.moveaxis(turn(level, angle[:, None]), 0, 2)
    return fits, flights.states(nodes, start, time)


def _random_flights(rngs: Sequence[Generator], duration: float, style: Style) -> Flights:
    turns, climbs = (_most_legs(duration, leg) for leg in (style.turn_leg, style.climb_leg))
    draws = Draws(rngs, 2 * turns + 3 * (turns + 1) + 2 * climbs + 6 * (climbs + 1) + 1)
    edges = _random_legs(draws, turns, style.turn_leg, style.turn_edge)
    rate = _either_way(draws, style.turn_rate, style.turning, turns + 1)
    turning = Commands(*edges, rate[None])

    edges = _random_legs(draws, climbs, style.climb_leg, style.climb_edge)
    climb = _either_way(draws, style.climb, style.climbing, climbs + 1)
    change = _either_way(draws, (0.0, style.speed_change), style.accelerating, climbs + 1)
    slowest, span = style.speed[0], style.speed[1] - style.speed[0]
    change[:, :1] = draws.uniform(0.0, span, 1)
    speed = slowest + _folded(np.cumsum(change, axis=1), span)
    climbing = Commands(*edges, np.stack([climb, speed]))
    return Flights(turning, climbing, heading=np.zeros(len(rngs)))


def _most_legs(duration: float, leg: tuple[float, float]) -> int:
    return ceil((duration + leg[1]) / leg[0])


def _random_legs(
    draws: Draws, count: int, leg: tuple[float, float], edge: tuple[float, float]
) -> tuple[Array, Array]:
    """Draw when edges (B, count) begin, from before 0 s on, and how long they last."""
    begin = np.cumsum(draws.uniform(*leg, count), axis=1) - leg[1]
    return begin, draws.uniform(*edge, count)


def _either_way(draws: Draws, size: tuple[float, float], share: float, count: int) -> Array:
    """Draw values (B, count) of a size within the pair, of either sign; all but a share are 0."""
    size = draws.uniform(*size, count)
    sign = np.where(draws.uniform(0.0, 1.0, count) < 0.5, -1.0, 1.0)
    return np.where(draws.uniform(0.0, 1.0, count) < share, sign * size, 0.0)


def _folded(values: Array, most: float) -> Array:
    """Reflect values into 0 to most, as a ball between two walls; no step gets longer."""
    return most - np.abs(values % (2.0 * most) - most)


def _random_starts(
    rngs: Sequence[Generator], nodes: Array
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Draw placements and first heights that keep flights in coverage, if there are any.

    Returns:
        Whether each flight has one (B,); of those that have, the turn (b,) and start (3, b).
    """
    every = round(CHECK_STEP / INNER_STEP)
    path = np.concatenate([nodes[0, ..., ::every], nodes[0, ..., -1:]], axis=-1)
    low, high = nodes[0].min(axis=-1), nodes[0].max(axis=-1)
    least, most = MIN_ALTITUDE - low[2], MAX_ALTITUDE - high[2]
    fits = most >= least
    drawn, path = [rngs[i] for i in np.flatnonzero(fits)], path[:, fits]
    least, most, middle = least[fits], most[fits], 0.5 * (low + high)[:2, fits]
    height = Draws(drawn, 1).uniform(least[:, None], most[:, None], 1)[:, 0]
    path[2] += height[:, None]
    found, angle, shift = places(drawn, path, middle, (MIN_RANGE, MAX_RANGE))
    fits[fits] = found
    return fits, angle[found], np.concatenate([shift, height[None]])[:, found]
