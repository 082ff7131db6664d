"""Faults of satellite navigation: of the receiver's clock and loops, of single satellites."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.scenarios.draft import Draft
from kfenv.scenarios.draws import Draws
from kfenv.scenarios.faults import (
    FAULTS,
    NoiseMisreport,
    Range,
    SignalLoss,
    Together,
    between,
    check_range,
    check_start,
    draw_start,
    log_between,
    log_uniform,
    place_start,
    uniform,
)

Array = NDArray[np.float64]

RANGES, RATES = slice(CHANNELS), slice(CHANNELS, None)
RATE_SHARE = 5.0 / 150.0  # 1/s: rate error over range error of a degraded clock; ours


@dataclass
class GnssDraft(Draft):
    """A draft that knows the satellites; channels are 12 pseudoranges, then 12 rates.

    Attributes:
        satellite: (T, 12) a number for the satellite in each channel, -1 where there is none.
        elevation: (T, 12) of it, rad; a right angle where there is none.
    """

    satellite: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, CHANNELS), np.int64))
    elevation: Array = field(default_factory=lambda: np.empty((0, CHANNELS)))


@dataclass(frozen=True)
class ClockDegradation(Together):
    """The receiver's clock jitters: a white error common to all satellites, unknown to the filter.

    The rates get a thirtieth of it per second, an error of their own draw. S0 tells no
    size; 150 m and 5 m/s are ours. Being common, it is not part of the channels' true noise.

    Attributes:
        duration: range of its length, s.
        range_error: range of its standard deviation, m, drawn log-uniformly.
        start: when it begins, s; None draws it at random.
    """

    label: ClassVar[str] = "clock degradation"
    duration: Range = (10.0, 30.0)
    range_error: Range = (15.0, 150.0)
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "duration")
        check_range(self, "range_error")
        check_start(self)

    def apply_all(self, draft: GnssDraft, rngs: Sequence[Generator]) -> None:
        drawn, error = [], []
        for rng in rngs:
            drawn.append(rng.random(3))
            error.append(rng.standard_normal((len(draft.time), 2)))
        duration, deviation, start = np.transpose(drawn)
        duration = between(self.duration, duration)
        deviation = log_between(self.range_error, deviation)[:, None] * [1.0, RATE_SHARE]
        start = place_start(self.start, duration, draft.time, start)
        for i, window in draft.windows(self.label, start, duration):
            jitter = deviation[i] * error[i][window]
            draft.exact[i, window] += np.repeat(jitter, CHANNELS, axis=1)


@dataclass(frozen=True)
class PllFailure(SignalLoss):
    """The receiver's loops lose lock: no satellite is received. Fields as of `SignalLoss`."""

    label: ClassVar[str] = "PLL failure"


@dataclass(frozen=True)
class RangeStep:
    """One satellite's pseudorange jumps and comes back, as under crude spoofing.

    The error is constant, so it is no noise: nothing but the innovation tells of it.

    Attributes:
        duration: range of its length, s.
        size: range of the jump, m, either sign, drawn log-uniformly.
        start: when it begins, s; None draws it at random.
    """

    label: ClassVar[str] = "range step"
    duration: Range = (10.0, 40.0)
    size: Range = (5.0, 50.0)
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "duration")
        check_range(self, "size")
        check_start(self)

    def apply(self, draft: GnssDraft, rng: Generator) -> None:
        duration = uniform(rng, self.duration)
        size = log_uniform(rng, self.size) * (-1.0, 1.0)[rng.integers(2)]
        inside = draft.window(self.label, draw_start(self.start, duration, draft, rng), duration)
        victim = _one_satellite(draft, inside, rng)
        draft.misplace(inside, RANGES, np.where(victim, size, 0.0))


@dataclass(frozen=True)
class RangeRamp:
    """One satellite's pseudorange is slowly drawn away, its rate in agreement, then let go.

    What a careful spoofer does. The error is no noise.

    Attributes:
        duration: range of its length, s.
        rate: range of the drift, m/s, either sign, drawn log-uniformly.
        start: when it begins, s; None draws it at random.
    """

    label: ClassVar[str] = "range ramp"
    duration: Range = (20.0, 60.0)
    rate: Range = (0.1, 1.0)
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "duration")
        check_range(self, "rate")
        check_start(self)

    def apply(self, draft: GnssDraft, rng: Generator) -> None:
        duration = uniform(rng, self.duration)
        rate = log_uniform(rng, self.rate) * (-1.0, 1.0)[rng.integers(2)]
        start = draw_start(self.start, duration, draft, rng)
        inside = draft.window(self.label, start, duration)
        victim = _one_satellite(draft, inside, rng)
        passed = (draft.time[inside] - start)[:, None]
        draft.misplace(inside, RANGES, np.where(victim, rate * passed, 0.0))
        draft.misplace(inside, RATES, np.where(victim, rate, 0.0))


@dataclass(frozen=True)
class MultipathBurst(Together):
    """Reflections raise the pseudorange noise of low satellites, unknown to the filter.

    Attributes:
        duration: range of its length, s.
        factor: range of the noise's multiplier, drawn log-uniformly.
        below: elevation up to which satellites suffer, deg.
        start: when it begins, s; None draws it at random.
    """

    label: ClassVar[str] = "multipath"
    duration: Range = (5.0, 30.0)
    factor: Range = (3.0, 30.0)
    below: float = 30.0
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "duration")
        check_range(self, "factor")
        check_start(self)
        if not is_number(self.below) or not 0.0 < self.below <= 90.0:
            raise ValueError(
                f"MultipathBurst.below must be an elevation in degrees, above 0 and up to 90, "
                f"got {self.below!r}."
            )

    def apply_all(self, draft: GnssDraft, rngs: Sequence[Generator]) -> None:
        duration, factor, start = Draws(rngs, 3).left.T
        duration, factor = between(self.duration, duration), log_between(self.factor, factor)
        start = place_start(self.start, duration, draft.time, start)
        for i, window in draft.windows(self.label, start, duration):
            low = draft.elevation[i, window] < np.radians(self.below)
            draft.noise_factor[i, window, :CHANNELS][low] *= factor[i]


@dataclass(frozen=True)
class ReceiverMisreport(NoiseMisreport):
    """A receiver that tells a wrong noise level, one for pseudoranges and one for rates.

    Attributes:
        factor: range of told over actual standard deviation, drawn log-uniformly.
    """

    def apply_all(self, draft: GnssDraft, rngs: Sequence[Generator]) -> None:
        factors = log_between(self.factor, Draws(rngs, 2).left)
        draft.told_factor *= np.repeat(factors, CHANNELS, axis=1)[:, None]
        draft.each_throughout(self.label)


def _one_satellite(draft: GnssDraft, inside: slice, rng: Generator) -> NDArray[np.bool_]:
    """Where (t, 12) a satellite, drawn from those in view at some time inside, is received."""
    satellite = draft.satellite[inside]
    seen = np.flatnonzero(np.bincount(satellite[satellite >= 0]))
    drawn = rng.random()  # drawn even if none is in view, so that what follows stays the same
    if not len(seen):
        return np.zeros(satellite.shape, bool)
    return satellite == seen[int(drawn * len(seen))]


GNSS_FAULTS: dict[str, type] = FAULTS | {
    "noise_misreport": ReceiverMisreport,
    "clock_degradation": ClockDegradation,
    "pll_failure": PllFailure,
    "range_step": RangeStep,
    "range_ramp": RangeRamp,
    "multipath_burst": MultipathBurst,
}
