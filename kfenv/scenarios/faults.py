"""Faults: small objects that spoil an episode before its measurements are drawn.

A fault is anything with a ``label`` and a method ``apply(draft, rng)`` that changes
the `Draft` of an episode. One that can spoil many episodes at once saves most of the time,
see `Together`. Those here serve every scenario; a range (low, high) is drawn from anew
in each episode.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import groupby, pairwise
from typing import ClassVar, Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.names import unknown
from kfenv.scenarios.draft import Draft
from kfenv.scenarios.draws import Draws

Array = NDArray[np.float64]
Range = tuple[float, float]


class Fault(Protocol):
    """What a scenario asks of a fault."""

    label: str

    def apply(self, draft: Draft, rng: Generator) -> None:
        """Change the draft; every random choice comes from `rng`."""


class Together(ABC):
    """A fault that spoils many episodes at once; alone, one is the only one of many."""

    def apply(self, draft: Draft, rng: Generator) -> None:
        """Change the draft of one episode."""
        self.apply_all(draft.alone(), [rng])

    @abstractmethod
    def apply_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        """Change the draft of many in place, each with the numbers that it would get alone."""


@dataclass(frozen=True)
class Jamming(Together):
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

    def apply_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        low, high = self.bursts
        drawn = [rng.random((rng.integers(low, high, endpoint=True), 3)) for rng in rngs]
        episode = [i for i, rows in enumerate(drawn) for _ in rows]
        duration, factor, start = np.concatenate(drawn).T
        duration, factor = between(self.duration, duration), log_between(self.factor, factor)
        start = place_start(self.start, duration, draft.time, start)
        windows = draft.windows(self.label, start, duration, episode)
        bursts = zip(windows, factor.tolist(), strict=True)
        for i, own in groupby(bursts, key=lambda burst: burst[0][0]):
            _raise(draft.noise_factor[i], [(window, factor) for (_, window), factor in own])


@dataclass(frozen=True)
class SignalLoss(Together):
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

    def apply_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        duration, start = Draws(rngs, 2).left.T
        duration = between(self.duration, duration)
        start = place_start(self.start, duration, draft.time, start)
        for i, window in draft.windows(self.label, start, duration):
            draft.available[i, window] = False


@dataclass(frozen=True)
class Glint(Together):
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

    def apply_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        drawn = Draws(rngs, 1 + len(draft.time)).left
        present = drawn[:, 0] < self.probability
        hit = (drawn[:, 1:] < self.fraction) & present[:, None]
        draft.noise_factor[hit] *= self.factor
        draft.each_throughout(self.label, present.tolist())


@dataclass(frozen=True)
class NoiseMisreport(Together):
    """A sensor that tells the filter a wrong noise level, each channel its own.

    Attributes:
        factor: range of told over actual standard deviation, drawn log-uniformly.
    """

    label: ClassVar[str] = "misreported noise"
    factor: Range = (0.4, 2.5)

    def __post_init__(self) -> None:
        check_range(self, "factor")

    def apply_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        factor = log_between(self.factor, Draws(rngs, draft.told_factor.shape[-1]).left)
        draft.told_factor *= factor[:, None]
        draft.each_throughout(self.label)


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


def apply_all(faults: Sequence[Fault], draft: Draft, rngs: Sequence[Generator]) -> None:
    """Apply faults in turn to the draft of many episodes."""
    for together, some in groupby(faults, key=_spoils_all):
        some = tuple(some)
        if together:
            for fault in some:
                fault.apply_all(draft, rngs)
        else:
            for one, rng in zip(draft.episodes(), rngs, strict=True):
                for fault in some:
                    fault.apply(one, rng)


def _spoils_all(fault: Fault) -> bool:
    """Not one derived from such a fault that has an `apply` of its own."""
    return getattr(type(fault), "apply", None) is Together.apply


def _raise(noise_factor: Array, bursts: Sequence[tuple[slice, float]]) -> None:
    """Raise an episode's noise in bursts, where they overlap by the greatest factor."""
    ends = sorted(end for window, _ in bursts for end in (window.start, window.stop))
    for begin, end in pairwise(ends):
        raised = [factor for window, factor in bursts if window.start <= begin < window.stop]
        noise_factor[begin:end] *= max(1.0, *raised, 1.0)


def between(bounds: Range, drawn: Array | float) -> Array | float:
    """Numbers between the bounds from ones between 0 and 1."""
    return bounds[0] + (bounds[1] - bounds[0]) * drawn


def log_between(bounds: Range, drawn: Array | float) -> Array | float:
    """Numbers between the bounds, their logarithms from ones between 0 and 1."""
    return np.exp(between(np.log(bounds), drawn))


def place_start(start: float | None, duration: Array, time: Array, drawn: Array) -> Array:
    """The start given, or one that leaves room for each duration, from ones between 0 and 1."""
    if start is not None:
        return np.full(len(drawn), float(start))
    return between((time[0], np.maximum(time[-1] - duration, time[0])), drawn)


def uniform(rng: Generator, bounds: Range) -> float:
    """A number between the bounds: ``rng.uniform``, which takes ten times as long for one."""
    return between(bounds, rng.random())


def log_uniform(rng: Generator, bounds: Range) -> float:
    """A number between the bounds, its logarithm uniform."""
    return float(log_between(bounds, rng.random()))


def draw_start(start: float | None, duration: float, draft: Draft, rng: Generator) -> float:
    """The start given, or one at random that leaves room for the duration; draws either way."""
    first, last = draft.time[0], draft.time[-1]
    drawn = uniform(rng, (first, max(last - duration, first)))
    return drawn if start is None else start
