"""A log of plots on the instants of a filter, cut into windows that are Recordings.

The filter steps from plot to plot, however irregular they come, and in between where they are
more than a second or several usual intervals apart. A window begins with what the plots before
it tell of the target; its first plot is spent on that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.model import Sensor
from kfenv.scenarios.measured import measured_positions, measured_spreads
from kfenv.scenarios.radar.plots import Plots
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import MIN_RATE
from kfenv.scenarios.smoothing import off_neighbours
from kfenv.scenarios.windows import PARTS, no_room, withheld

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

MAX_STEP = 1.25  # s: a radar's plots that come once a second, more or less, are stepped to at once
MAX_GAP = 60.0  # s without a plot
MISSED = 2.0  # s without plots that judge a filter: in longer ones how it turns outweighs all else
FIRST, LEARNT = 5, 5.0  # plots at least, and s of them, that tell where a window begins
FASTEST, HARDEST = 300.0, 5.0  # m/s and m/s^2, of a target that nothing is known of, 1 sigma
FINEST = 0.01  # m: no plot is better, straight above a radar least of all
JERK = 10.0  # m^2/s^5: how fast older plots lose their word on that
PASSES, OUTLYING = 5, 3.0  # of the fit, and deviations from which on a plot counts less
USUAL = 1.538  # median length of three normal numbers
NORMAL = 1.4826  # deviation over median of the absolute value
STATES = 9


@dataclass(frozen=True, eq=False)
class PlotLog:
    """Plots on N instants, with what is known of the truth there.

    Attributes:
        path: of the file.
        begin: the first instant, s of the file's clock.
        time: (N,) s since then.
        steps_per_plot: instants from one plot to the next, as a rule.
        measurement, noise: (N, m), NaN where nothing was detected.
        position, spread: (N, 3) as measured, NaN where a channel is missing, and (N, m, 3) how
            far each channel's deviation moves it, m.
        truth: states (N, 9), where nobody told them those that the plots suggest.
        known: (N,) whether the truth counts there.
        told: whether the truth was told; otherwise plots that the filter misses stand for it.
    """

    path: str
    begin: float
    time: Array
    steps_per_plot: int
    measurement: Array
    noise: Array
    position: Array
    spread: Array
    truth: Array
    known: Mask
    told: bool

    @property
    def rate(self) -> float:
        """Usual number of instants per second."""
        return max(1.0 / float(np.median(np.diff(self.time))), MIN_RATE)

    @cached_property
    def plots(self) -> Indices:
        """The instants at which every channel was detected."""
        return np.flatnonzero(~np.isnan(self.position).any(axis=1))

    def steps(self, duration: float) -> int:
        """Instants of a window of about so many seconds."""
        return round(duration * self.rate) + 1

    def random_starts(self, rngs: Sequence[Generator], duration: float, part: str) -> Indices:
        """Draw from each generator at which instant a window of that part begins."""
        possible = _possible(self, duration, part)
        return np.array([possible[rng.integers(len(possible))] for rng in rngs], np.int64)

    def starts(self, duration: float, part: str) -> Indices:
        """The instants at which that part's windows begin, as many as fit without overlap.

        Raises:
            ValueError: if not even two fit.
        """
        chosen: list[int] = []
        for instant in _possible(self, duration, part):
            if not chosen or instant >= chosen[-1] + self.steps(duration):
                chosen.append(int(instant))
        if len(chosen) < 2:
            raise no_room(self.path, self.time[-1], part, duration, "two windows")
        return np.array(chosen)

    def recording(self, starts: Indices, steps: int, missing: bool = True) -> Recording:
        """The windows of so many instants that begin at the given ones.

        Args:
            starts: of `plots`, with `FIRST` - 1 of these before.
            steps: T.
            missing: whether plots are withheld where no truth was told, see
                `kfenv.scenarios.windows`; the truth then counts only there.
        """
        instants = starts[:, None] + np.arange(steps)
        time = self.time[instants] - self.time[starts][:, None]
        measurement, noise = self.measurement[instants], self.noise[instants]
        scored = self.known[instants]
        if not self.told and missing:
            missed = withheld(time, self._interval, MISSED)
            measurement[missed] = np.nan
            scored &= missed
        measurement[:, 0] = np.nan
        mean, factor = map(np.stack, zip(*map(self.start, starts), strict=True))
        none = np.empty((*instants.shape, 0))
        return Recording(
            time, measurement, noise, mean, factor, none, none, self.truth[instants],
            scored=None if scored.all() else scored,
        )  # fmt: skip

    def start(self, instant: int) -> tuple[Array, Array]:
        """Mean (9,) and factor (9, 9) of the state at an instant, from the plots up to it.

        Least squares of a motion with constant acceleration, of which only the order of
        magnitude is known; the target may have left it by white jerk meanwhile. Plots that lie
        further off than their deviations say weigh less, all of them or the odd one.
        """
        used = self.plots[: int(np.searchsorted(self.plots, instant, side="right"))]
        recent = used[self.time[used] >= self.time[instant] - LEARNT]
        used = recent if len(recent) >= FIRST else used[-FIRST:]
        origin = self.position[used[-1]]
        rows, sides = _whitened(
            self.time[used] - self.time[instant], self.position[used] - origin, self.spread[used]
        )
        less = np.ones(len(used))
        for _ in range(PASSES):
            mean, factor = _solved(rows / less[:, None, None], sides / less[:, None])
            off = np.linalg.norm(rows @ mean - sides, axis=1)
            usual = max(1.0, float(np.median(off)) / USUAL)
            less = usual * np.maximum(1.0, off / (usual * OUTLYING))
        mean[[0, 3, 6]] += origin
        return mean, factor

    @property
    def _interval(self) -> float:
        """Usual time from plot to plot, s."""
        return self.steps_per_plot / self.rate

    def judged(self, start: int, steps: int) -> bool:
        """Whether the truth counts at any instant of a window."""
        known = self.known[start : start + steps]
        if self.told:
            return bool(known.any())
        time = self.time[start : start + steps] - self.time[start]
        return bool((known & withheld(time, self._interval, MISSED)).any())


@lru_cache(maxsize=64)
def _possible(log: PlotLog, duration: float, part: str) -> Indices:
    """Instants at which windows may begin that lie, with the plots before, in a part.

    Raises:
        ValueError: if there is none.
    """
    low, high = (share * log.time[-1] for share in PARTS[part])
    steps = log.steps(duration)
    start, before = log.plots[FIRST - 1 :], log.plots[: 1 - FIRST]
    inside = (start + steps <= len(log.time)) & (log.time[before] >= low)
    inside[inside] &= log.time[start[inside] + steps - 1] <= high + 1e-9
    if not inside.any():
        raise no_room(log.path, log.time[-1], part, duration, "a window")
    judged = [log.judged(instant, steps) for instant in start[inside]]
    if not any(judged):
        raise ValueError(
            f"{log.path}: no window of {duration:g} s in the part for {part} has an instant "
            "whose truth is known; give a longer duration."
        )
    return start[inside][judged]


def _whitened(since: Array, position: Array, spread: Array) -> tuple[Array, Array]:
    """Rows (k, 3, 9) and right sides (k, 3) of plots at times (k,), of unit covariance each."""
    along = np.stack([np.ones_like(since), since, 0.5 * since**2], axis=1)
    rows = np.einsum("ij,kl->kijl", np.eye(3), along).reshape(len(since), 3, STATES)
    left = np.sqrt(JERK * np.abs(since) ** 5 / 20.0 + FINEST**2)[:, None, None] * np.eye(3)
    root = np.linalg.qr(np.concatenate([spread, left], axis=1), mode="r")
    both = np.concatenate([rows, position[:, :, None]], axis=2)
    both = np.linalg.solve(root.swapaxes(1, 2), both)
    return both[..., :STATES], both[..., STATES]


def _solved(rows: Array, sides: Array) -> tuple[Array, Array]:
    """Mean (9,) and lower factor (9, 9) by these rows, and by how fast and hard targets move."""
    known = np.zeros((6, STATES))
    known[range(3), [1, 4, 7]], known[range(3, 6), [2, 5, 8]] = 1.0 / FASTEST, 1.0 / HARDEST
    q, r = np.linalg.qr(np.vstack([known, rows.reshape(-1, STATES)]))
    right = q.T @ np.concatenate([np.zeros(6), sides.ravel()])
    solved = np.linalg.solve(r, np.column_stack([right, np.eye(STATES)]))
    upper = np.linalg.qr(solved[:, 1:].T, mode="r")
    return solved[:, 0].copy(), (np.sign(np.diagonal(upper))[:, None] * upper).T


def make_log(
    plots: Plots, sensor: Sensor, deviation: Array, truth: tuple[Array, Mask] | None,
    instants: tuple[Array, Indices, int],
) -> PlotLog:  # fmt: skip
    """Lay plots on a filter's instants.

    Args:
        plots: N of them.
        sensor: whose channels they tell.
        deviation: (N, m) that the filter is told.
        truth: states and whether they are known, at the instants; None if nobody told.
        instants: from `instants_of`.
    """
    time, row, every = instants
    shape = (len(time), deviation.shape[1])
    measurement, noise = np.full(shape, np.nan), np.empty(shape)
    measurement[row], noise[:] = plots.value, np.nanmedian(deviation, axis=0)
    noise[row] = np.where(np.isnan(deviation), noise[row], deviation)
    turns = [i for i, channel in enumerate(sensor.channels) if channel.angle]
    angles = measurement[:, turns]
    measurement[:, turns] = np.where(np.abs(angles) > np.pi, wrapped(angles), angles)
    position = measured_positions(sensor, measurement)
    told = truth is not None
    states, known = truth if told else suggested(time, position)
    return PlotLog(
        plots.path, float(plots.time[0]), time - time[0], every, measurement, noise, position,
        measured_spreads(sensor, np.nan_to_num(measurement), noise), states, known, told,
    )  # fmt: skip


def wrapped(angle: Array) -> Array:
    """Angles within (-pi, pi]."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def instants_of(time: Array, path: str) -> tuple[Array, Indices, int]:
    """Instants (K,) of a filter for plots at times (N,), the plots' rows and their usual stride.

    Each interval counts as so many usual ones, and each of these as so many steps.

    Raises:
        ValueError: if plots are too long apart.
    """
    gap = np.diff(time)
    usual = float(np.median(gap))
    widest = int(gap.argmax())
    if gap[widest] > MAX_GAP:
        raise ValueError(
            f"{path}: no plot for {gap[widest]:.4g} s after t = {time[widest]:.15g} s, and at most "
            f"{MAX_GAP:g} s are bridged; cut the log there and use the longer part."
        )
    every = int(np.ceil(usual / MAX_STEP - 1e-6))
    scans = np.maximum(np.rint(gap / usual), np.ceil(gap / (every * MAX_STEP) - 1e-6))
    pieces = every * np.maximum(scans, 1.0).astype(np.int64)
    row = np.append(0, np.cumsum(pieces))
    instants = np.interp(np.arange(row[-1] + 1), row, time)
    instants[row] = time
    return instants, row, every


def suggested(time: Array, position: Array) -> tuple[Array, Mask]:
    """States (N, 9) on straight lines between measured positions, and where these are."""
    known = ~np.isnan(position).any(axis=1)
    path = np.stack([np.interp(time, time[known], axis) for axis in position[known].T], axis=-1)
    states = np.zeros((len(time), STATES))
    states[:, [0, 3, 6]] = path
    states[:, [1, 4, 7]] = np.gradient(path, time, axis=0)
    return states, known


def measured_noise(time: Array, value: Array, angles: Sequence[int]) -> Array:
    """Standard deviations (m,) of channels (N, m): how far each plot lies off its neighbours.

    Off the cubic through the two before and the two after, of which targets stay within noise.
    """
    deviations = []
    for channel in range(value.shape[1]):
        seen = ~np.isnan(value[:, channel])
        series = value[seen, channel]
        series = np.unwrap(series) if channel in angles else series
        off, gain = off_neighbours(time[seen], series[:, None])
        deviations.append(NORMAL * float(np.nanmedian(np.abs(off[:, 0]) / gain)))
    return np.array(deviations)
