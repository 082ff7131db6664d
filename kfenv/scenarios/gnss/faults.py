"""Faults of satellite navigation: of the receiver's clock and loops, of single satellites."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.scenarios.faults import (
    FAULTS,
    Draft,
    NoiseMisreport,
    Range,
    SignalLoss,
    check_range,
    check_start,
    draw_start,
    log_uniform,
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
class ClockDegradation:
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

    def apply(self, draft: GnssDraft, rng: Generator) -> None:
        duration = uniform(rng, self.duration)
        deviation = log_uniform(rng, self.range_error) * np.array([1.0, RATE_SHARE])
        inside = draft.window(self.label, draw_start(self.start, duration, draft, rng), duration)
        error = deviation * rng.standard_normal((len(draft.time), 2))
        draft.exact[inside] += np.repeat(error[inside], CHANNELS, axis=1)


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
        size = log_uniform(rng, self.size) * rng.choice((-1.0, 1.0))
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
        rate = log_uniform(rng, self.rate) * rng.choice((-1.0, 1.0))
        start = draw_start(self.start, duration, draft, rng)
        inside = draft.window(self.label, start, duration)
        victim = _one_satellite(draft, inside, rng)
        passed = (draft.time[inside] - start)[:, None]
        draft.misplace(inside, RANGES, np.where(victim, rate * passed, 0.0))
        draft.misplace(inside, RATES, np.where(victim, rate, 0.0))


@dataclass(frozen=True)
class MultipathBurst:
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

    def apply(self, draft: GnssDraft, rng: Generator) -> None:
        duration = uniform(rng, self.duration)
        factor = log_uniform(rng, self.factor)
        inside = draft.window(self.label, draw_start(self.start, duration, draft, rng), duration)
        low = draft.elevation[inside] < np.radians(self.below)
        draft.noise_factor[inside, :CHANNELS][low] *= factor


@dataclass(frozen=True)
class ReceiverMisreport(NoiseMisreport):
    """A receiver that tells a wrong noise level, one for pseudoranges and one for rates.

    Attributes:
        factor: range of told over actual standard deviation, drawn log-uniformly.
    """

    def apply(self, draft: GnssDraft, rng: Generator) -> None:
        factors = [log_uniform(rng, self.factor) for _ in range(2)]
        draft.told_factor *= np.repeat(factors, CHANNELS)
        draft.throughout(self.label)


def _one_satellite(draft: GnssDraft, inside: slice, rng: Generator) -> NDArray[np.bool_]:
    """Where (t, 12) a satellite, drawn from those in view at some time inside, is received."""
    satellite = draft.satellite[inside]
    seen = np.unique(satellite[satellite >= 0])
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
