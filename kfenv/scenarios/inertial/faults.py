"""Faults of inertial navigation: outlying fixes, and an inertial unit that goes wrong.

All serve every scenario whose measurements are fixes and whose motion inputs are
inertial samples (specific force, m/s^2, and angular rate, rad/s, along body axes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.names import unknown
from kfenv.scenarios.faults import (
    Draft,
    Range,
    check_range,
    check_start,
    draw_start,
    log_uniform,
    uniform,
)

Array = NDArray[np.float64]

CONTAMINATION = ("vector", "channel")
OUTLIER_SHARE, VARIANCE_RATIO = 0.15, 500.0  # epsilon and U of the paper's mixture


@dataclass(frozen=True)
class Outliers:
    """A Gaussian mixture: in a window some fixes have a multiple of the noise (SPEC 4.4).

    The noise is (1 - share) N(0, R) + share N(0, variance_ratio R).

    Attributes:
        start, duration: of the window, s.
        share: of outliers, epsilon.
        variance_ratio: of an outlier's noise, U.
        by: ``"vector"``: a fix is hit as a whole; ``"channel"``: each of its numbers by itself.
    """

    label: ClassVar[str] = "outliers"
    start: float = 7.0
    duration: float = 19.0
    share: float = OUTLIER_SHARE
    variance_ratio: float = VARIANCE_RATIO
    by: str = "vector"

    def __post_init__(self) -> None:
        check_start(self)
        for name in ("start", "duration", "variance_ratio"):
            value = getattr(self, name)
            if not is_number(value) or (value <= 0.0 and name != "start"):
                raise ValueError(f"Outliers.{name} must be a positive number, got {value!r}.")
        if not is_number(self.share) or not 0.0 <= self.share <= 1.0:
            raise ValueError(f"Outliers.share must be a number in [0, 1], got {self.share!r}.")
        check_contamination(self.by)

    def apply(self, draft: Draft, rng: Generator) -> None:
        hit = draw_hits(rng, draft, self.share, self.by)
        window = draft.window(self.label, self.start, self.duration)
        draft.noise_factor[window][hit[window]] *= np.sqrt(self.variance_ratio)


@dataclass(frozen=True)
class Interference:
    """Bursts of outliers, each of a mixture of its own: more or fewer, wilder or milder.

    Where bursts overlap, or meet noise that was raised before, the strongest counts.

    Attributes:
        bursts: least and greatest number of bursts.
        duration: range of a burst's length, s.
        share: range of the share of outliers.
        factor: range of their noise's multiplier, drawn log-uniformly.
        by: ``"vector"``, ``"channel"``, or ``"either"``, drawn for each burst.
    """

    label: ClassVar[str] = "interference"
    bursts: tuple[int, int] = (1, 3)
    duration: Range = (4.0, 15.0)
    share: Range = (0.05, 0.6)
    factor: Range = (3.0, 31.0)
    by: str = "either"

    def __post_init__(self) -> None:
        check_range(self, "bursts", lowest=0)
        if any(value != int(value) for value in self.bursts):
            raise ValueError(f"Interference.bursts must be whole numbers, got {self.bursts!r}.")
        for name in ("duration", "share", "factor"):
            check_range(self, name)
        if self.share[1] > 1.0:
            raise ValueError(f"Interference.share must lie in [0, 1], got {self.share!r}.")
        check_contamination(self.by, "either")

    def apply(self, draft: Draft, rng: Generator) -> None:
        raised = np.maximum(draft.noise_factor, 1.0, out=draft.noise_factor)
        for _ in range(rng.integers(self.bursts[0], self.bursts[1], endpoint=True)):
            duration = uniform(rng, self.duration)
            share, factor = uniform(rng, self.share), log_uniform(rng, self.factor)
            start = draw_start(None, duration, draft, rng)
            whole = rng.random() < 0.5 if self.by == "either" else self.by == "vector"
            hit = draw_hits(rng, draft, share, "vector" if whole else "channel")
            burst = draft.window(self.label, start, duration)
            own = np.where(hit[burst], factor, 1.0)
            np.maximum(raised[burst], own, out=raised[burst])


@dataclass(frozen=True)
class InertialStep:
    """For a while the inertial unit adds a constant to what it measures, unknown to the filter.

    Attributes:
        probability: of an episode having it at all.
        size: range of the constant, in the unit of what it is added to.
        duration: range of its length, s.
        start: when it begins, s; None draws it at random.
        axes: body axes (0 forward, 1 right, 2 down) that get the constant with a plus;
            empty draws one axis and a sign.
    """

    probability: float = 0.5
    size: Range = (0.5, 5.0)
    duration: Range = (3.0, 12.0)
    start: float | None = None
    axes: tuple[int, ...] = ()

    first_input: ClassVar[int]  # of the three that it acts on
    unit: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        check_range(self, "size")
        check_range(self, "duration")
        check_start(self)
        name, chance = type(self).__name__, self.probability
        if not is_number(chance) or not 0.0 <= chance <= 1.0:
            raise ValueError(f"{name}.probability must be a number in [0, 1], got {chance!r}.")
        axes = self.axes
        right = isinstance(axes, tuple | list) and all(axis in (0, 1, 2) for axis in axes)
        if not right or any(isinstance(axis, bool) for axis in axes):
            raise ValueError(
                f"{name}.axes must list body axes, 0 forward, 1 right, 2 down, got {axes!r}."
            )

    def apply(self, draft: Draft, rng: Generator) -> None:
        present = rng.random() < self.probability
        size, duration = uniform(rng, self.size), uniform(rng, self.duration)
        start = draw_start(self.start, duration, draft, rng)
        axis, sign = rng.integers(3), (-1.0, 1.0)[rng.integers(2)]
        if not present:
            return
        window = draft.window(self.label, start, duration)
        for place in self.axes or (axis,):
            step = self.unit * size * (1.0 if self.axes else sign)
            draft.motion_inputs[window, self.first_input + place] += step


@dataclass(frozen=True)
class AccelerationStep(InertialStep):
    """A step in the specific force, m/s^2."""

    label: ClassVar[str] = "acceleration step"
    first_input: ClassVar[int] = 0


@dataclass(frozen=True)
class RateStep(InertialStep):
    """A step in the angular rate, deg/s."""

    label: ClassVar[str] = "rate step"
    first_input: ClassVar[int] = 3
    unit: ClassVar[float] = float(np.pi / 180.0)


def draw_hits(rng: Generator, draft: Draft, share: float, by: str) -> NDArray[np.bool_]:
    """Which numbers (T, m) of an episode are outliers."""
    steps, channels = draft.noise_factor.shape
    hit = rng.random((steps, channels if by == "channel" else 1)) < share
    return np.broadcast_to(hit, (steps, channels))


def check_contamination(by: object, *more: str) -> None:
    """Complain of an unknown kind of contamination.

    Raises:
        ValueError: naming the known ones.
    """
    known = (*CONTAMINATION, *more)
    if by not in known:
        raise ValueError(unknown("contamination by", by, known))
