"""Faults: small objects that spoil an episode before its measurements are drawn.

A fault is anything with a ``label`` and a method ``apply(draft, rng)`` that changes
the `Draft`. Those here serve every scenario; a range (low, high) is drawn from anew
in each episode.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.names import unknown
from kfenv.scenarios.recording import FaultInterval

Array = NDArray[np.float64]
Range = tuple[float, float]


@dataclass
class Draft:
    """An episode of T instants and m channels before its measurements are drawn.

    That of many episodes has arrays with the episodes in front (but for the time).

    Attributes:
        time: (T,) s.
        noise_factor: (T, m) multiplies the noise that is drawn.
        told_factor: (T, m) multiplies the noise that the filter is told.
        available: (T, m) whether the channel arrives.
        exact: (T, m) the measurements without noise; a fault may add errors of its own.
        bias: (T, m) those of these errors that are single channels' own: told to the
            clairvoyant, and not added to anything.
        motion_inputs, sensor_inputs: (T, p), (T, k) the inputs as the filter is told them.
        intervals: what happened when.
    """

    time: Array
    noise_factor: Array
    told_factor: Array
    available: NDArray[np.bool_]
    exact: Array
    bias: Array
    motion_inputs: Array
    sensor_inputs: Array
    intervals: list[FaultInterval] = field(default_factory=list)

    @classmethod
    def clean(cls, time: Array, channels: int, **more: object) -> Draft:
        """An episode without faults; measurements of zero and no inputs unless given."""
        lead = np.shape(more.get("exact", ()))[:-2]
        shape, none = (*lead, len(time), channels), np.empty((*lead, len(time), 0))
        given = {
            "exact": np.zeros(shape), "bias": np.zeros(shape), "motion_inputs": none,
            "sensor_inputs": none,
        }  # fmt: skip
        return cls(time, np.ones(shape), np.ones(shape), np.ones(shape, bool), **given | more)

    def episodes(self) -> Iterator[Self]:
        """Each episode of many in turn, whose arrays are views, to be changed until the next."""
        arrays = {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray) and k != "time"}
        for i in range(len(self.exact)):
            views = {name: array[i] for name, array in arrays.items()}
            one = object.__new__(type(self))
            vars(one).update(vars(self), intervals=[], **views)
            yield one
            for name, view in views.items():
                if getattr(one, name) is not view:
                    arrays[name][i] = getattr(one, name)

    def misplace(self, inside: slice, channels: slice, error: Array) -> None:
        """Add errors (t, c) to channels' measurements of a time, and note them as a bias."""
        self.exact[inside, channels] += error
        self.bias[inside, channels] += error

    def window(self, label: str, start: float, duration: float) -> slice:
        """Label the interval, as far as it lies in the episode, and return its time indices."""
        stop = start + duration
        inside = slice(*self.time.searchsorted((start, stop)))
        if inside.stop > inside.start:
            first, last = max(start, self.time[0]), min(stop, self.time[-1])
            self.intervals.append(FaultInterval(label, float(first), float(last)))
        return inside

    def throughout(self, label: str) -> None:
        """Label the whole episode."""
        self.intervals.append(FaultInterval(label, float(self.time[0]), float(self.time[-1])))


class Fault(Protocol):
    """What a scenario asks of a fault."""

    label: str

    def apply(self, draft: Draft, rng: Generator) -> None:
        """Change the draft; every random choice comes from `rng`."""


@dataclass(frozen=True)
class Jamming:
    """Bursts that raise the noise of all channels, unknown to the filter.

    Where bursts overlap the strongest counts.

    Attributes:
        bursts: least and greatest number of bursts.
        duration: range of a burst's length, s.
        factor: range of the noise's multiplier, drawn log-uniformly.
        start: when every burst begins, s; None draws each at random.
    """

    label: ClassVar[str] = "jamming"
    bursts: tuple[int, int] = (1, 3)
    duration: Range = (5.0, 25.0)
    factor: Range = (2.0, 31.0)
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "bursts", lowest=0)
        if any(value != int(value) for value in self.bursts):
            raise ValueError(f"Jamming.bursts must be whole numbers, got {self.bursts!r}.")
        check_range(self, "duration")
        check_range(self, "factor")
        check_start(self)

    def apply(self, draft: Draft, rng: Generator) -> None:
        raised = np.ones(len(draft.time))
        for _ in range(rng.integers(self.bursts[0], self.bursts[1], endpoint=True)):
            duration = uniform(rng, self.duration)
            factor = log_uniform(rng, self.factor)
            start = draw_start(self.start, duration, draft, rng)
            burst = draft.window(self.label, start, duration)
            raised[burst] = np.maximum(raised[burst], factor)
        inside = np.flatnonzero(raised != 1.0)
        draft.noise_factor[inside] *= raised[inside, None]


@dataclass(frozen=True)
class SignalLoss:
    """A gap in which nothing arrives.

    Attributes:
        duration: range of its length, s.
        start: when it begins, s; None draws it at random.
    """

    label: ClassVar[str] = "signal loss"
    duration: Range = (2.0, 8.0)
    start: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "duration")
        check_start(self)

    def apply(self, draft: Draft, rng: Generator) -> None:
        duration = uniform(rng, self.duration)
        start = draw_start(self.start, duration, draft, rng)
        draft.available[draft.window(self.label, start, duration)] = False


@dataclass(frozen=True)
class Glint:
    """Outliers: single measurements whose noise is a multiple of the usual.

    Attributes:
        probability: of an episode having them at all.
        fraction: of the measurements hit, each as a whole.
        factor: the multiple.
    """

    label: ClassVar[str] = "glint"
    probability: float = 0.5
    fraction: float = 0.1
    factor: float = 8.0

    def __post_init__(self) -> None:
        for name in ("probability", "fraction"):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= value <= 1.0:
                raise ValueError(f"Glint.{name} must be a number in [0, 1], got {value!r}.")
        if not is_number(self.factor) or self.factor <= 0.0:
            raise ValueError(f"Glint.factor must be positive, got {self.factor!r}.")

    def apply(self, draft: Draft, rng: Generator) -> None:
        present = rng.random() < self.probability
        hit = rng.random(len(draft.time)) < self.fraction
        if present:
            draft.noise_factor[hit] *= self.factor
            draft.throughout(self.label)


@dataclass(frozen=True)
class NoiseMisreport:
    """A sensor that tells the filter a wrong noise level, each channel its own.

    Attributes:
        factor: range of told over actual standard deviation, drawn log-uniformly.
    """

    label: ClassVar[str] = "misreported noise"
    factor: Range = (0.4, 2.5)

    def __post_init__(self) -> None:
        check_range(self, "factor")

    def apply(self, draft: Draft, rng: Generator) -> None:
        low, high = np.log(self.factor)
        draft.told_factor *= np.exp(rng.uniform(low, high, draft.told_factor.shape[1]))
        draft.throughout(self.label)


FAULTS: dict[str, type] = {
    "jamming": Jamming,
    "signal_loss": SignalLoss,
    "glint": Glint,
    "noise_misreport": NoiseMisreport,
}


def resolve_faults(
    setting: str | Mapping[str, Mapping[str, object]] | Sequence[Fault],
    presets: Mapping[str, tuple[Fault, ...]],
    known: Mapping[str, type],
) -> tuple[Fault, ...]:
    """The faults that a setting names.

    Args:
        setting: a preset's name; or fault objects; or a mapping from a fault's name to
            its parameters, e.g. ``{"jamming": {"start": 70, "duration": [30, 30]}}``.
        presets, known: the scenario's.

    Raises:
        ValueError: for an unknown preset, fault or parameter, or what is no fault.
    """
    if isinstance(setting, str):
        if setting not in presets:
            raise ValueError(unknown("faults", setting, presets))
        return presets[setting]
    if isinstance(setting, Mapping):
        return tuple(_build(name, parameters, known) for name, parameters in setting.items())
    if not isinstance(setting, Sequence):
        raise ValueError(
            "faults must be a preset's name, a list of fault objects, or a mapping from names to "
            f"parameters, got {setting!r}."
        )
    for fault in setting:
        whole = callable(getattr(fault, "apply", None)) and hasattr(fault, "label")
        if isinstance(fault, type) or not whole:
            raise ValueError(
                f"{fault!r} is no fault: give an object with a `label` and a method "
                "`apply(draft, rng)`."
            )
    return tuple(setting)


def _build(name: str, parameters: Mapping[str, object], known: Mapping[str, type]) -> Fault:
    if name not in known:
        raise ValueError(unknown("fault", name, known))
    if not isinstance(parameters, Mapping):
        raise ValueError(
            f"The fault {name!r} needs a mapping of its parameters ({{}} for the defaults), "
            f"got {parameters!r}."
        )
    names = [parameter.name for parameter in fields(known[name])]
    for parameter in parameters:
        if parameter not in names:
            raise ValueError(unknown(f"parameter of the fault {name!r}:", parameter, names))
    values = {
        key: tuple(value) if isinstance(value, list) else value for key, value in parameters.items()
    }
    return known[name](**values)


def check_range(fault: object, name: str, lowest: float | None = None) -> None:
    """Complain if a fault's range is not (low, high), positive or from `lowest` on.

    Raises:
        ValueError: naming the fault, the range and what it holds.
    """
    pair = getattr(fault, name)
    right = isinstance(pair, tuple | list) and len(pair) == 2 and all(map(is_number, pair))
    right = right and pair[0] <= pair[1]
    right = right and (pair[0] > 0 if lowest is None else pair[0] >= lowest)
    if not right:
        bound = "positive" if lowest is None else f"at least {lowest}"
        raise ValueError(
            f"{type(fault).__name__}.{name} must be a pair (low, high), {bound} and in order, "
            f"got {pair!r}."
        )


def check_start(fault: object) -> None:
    """Complain if a fault's `start` is neither None nor a time in seconds.

    Raises:
        ValueError: naming the fault and its start.
    """
    start = fault.start
    if start is not None and not (is_number(start) and start >= 0.0):
        raise ValueError(
            f"{type(fault).__name__}.start must be seconds from the episode's begin (0 or more), "
            f"got {start!r}."
        )


def uniform(rng: Generator, bounds: Range) -> float:
    """A number between the bounds: ``rng.uniform``, which takes ten times as long for one."""
    return bounds[0] + (bounds[1] - bounds[0]) * rng.random()


def log_uniform(rng: Generator, bounds: Range) -> float:
    """A number between the bounds, its logarithm uniform."""
    return float(np.exp(uniform(rng, (np.log(bounds[0]), np.log(bounds[1])))))


def draw_start(start: float | None, duration: float, draft: Draft, rng: Generator) -> float:
    """The start given, or one at random that leaves room for the duration; draws either way."""
    first, last = draft.time[0], draft.time[-1]
    drawn = uniform(rng, (first, max(last - duration, first)))
    return drawn if start is None else start
