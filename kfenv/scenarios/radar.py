"""What the radar scenarios share: flight, geometry, faults, measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from os import PathLike
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch
from kfenv.models.phased_array import PhasedArray, rain_transmission
from kfenv.models.radar import radar
from kfenv.scenarios.faults import (
    FAULTS,
    Draft,
    Fault,
    Range,
    check_range,
    check_start,
    resolve_faults,
)
from kfenv.scenarios.recording import Recording, stack
from kfenv.scenarios.trajectories import paper_trajectory

Array = NDArray[np.float64]

MAX_RATE = 100.0  # Hz
MIN_RATE = 1.0  # Hz: the variable-turn model takes one step per measurement


@dataclass
class RadarDraft(Draft):
    """A draft that knows what the radar sees.

    Attributes:
        position: (T, 3) range, azimuth and elevation of the target, m and rad.
        snr: (T,) single-pulse signal to noise and jamming, linear.
        told_snr: (T,) the same as the filter is told.
    """

    position: Array = field(default_factory=lambda: np.empty((0, 3)))
    snr: Array = field(default_factory=lambda: np.empty(0))
    told_snr: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Rain:
    """Rain over the whole area; it weakens the echo and the radar knows.

    Attributes:
        rate: range of the rain rate, mm/h.
    """

    label: ClassVar[str] = "rain"
    rate: Range = (0.0, 50.0)

    def __post_init__(self) -> None:
        check_range(self, "rate", lowest=0)

    def apply(self, draft: RadarDraft, rng: Generator) -> None:
        transmission = rain_transmission(draft.position[:, 0], rng.uniform(*self.rate))
        draft.snr *= transmission
        draft.told_snr *= transmission
        draft.throughout(self.label)


@dataclass(frozen=True)
class SelfScreeningJammer:
    """The published jammer: carried by the target, in the main lobe (SPEC 4.2).

    Attributes:
        start, duration: s.
        known: whether the filter is told the jammed noise (the published case).
    """

    label: ClassVar[str] = "jamming"
    start: float = 70.0
    duration: float = 30.0
    known: bool = True

    def __post_init__(self) -> None:
        check_start(self)
        if not is_number(self.start) or not is_number(self.duration) or self.duration <= 0.0:
            raise ValueError(
                "SelfScreeningJammer needs a start and a positive duration in seconds, got "
                f"{self.start!r} and {self.duration!r}."
            )

    def apply(self, draft: RadarDraft, rng: Generator) -> None:
        jammed = draft.window(self.label, self.start, self.duration)
        noise_rise = 1.0 + PhasedArray().jammer_to_noise(draft.position[jammed, 0])
        draft.snr[jammed] /= noise_rise
        if self.known:
            draft.told_snr[jammed] /= noise_rise


@dataclass(frozen=True)
class RadarScenario(ABC):
    """A target seen by a radar at the origin; see the environments' pages for the fields."""

    duration: float
    rate: float
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault]
    track: str | None = None
    radar_position: tuple[float, float, float] | None = None

    known_faults: ClassVar[Mapping[str, type]] = FAULTS
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {"none": ()}
    initial_deviation: ClassVar[tuple[float, float, float]]  # m, m/s, m/s^2 per axis
    error_scale: ClassVar[float]  # m
    lost_distance: ClassVar[float] = 10_000.0  # m, SPEC 7.1

    def __post_init__(self) -> None:
        if not is_number(self.rate) or not MIN_RATE <= self.rate <= MAX_RATE:
            raise ValueError(
                f"rate must lie between {MIN_RATE:g} and {MAX_RATE:g} measurements per second, "
                f"got {self.rate!r}."
            )
        if not is_number(self.duration) or self.duration < 1.0 / self.rate:
            raise ValueError(
                "duration must be a number of seconds, at least one step of "
                f"{1.0 / self.rate:g} s, got {self.duration!r}."
            )
        if self.track is not None and not isinstance(self.track, str | PathLike):
            raise ValueError(f"track must be the path of a CSV file, got {self.track!r}.")
        self._check_radar_position()
        if self.radar_position is not None and self.track is None:
            raise ValueError(
                "radar_position places a radar beside a real flight: give a track too."
            )
        resolve_faults(self.faults, self.presets, self.known_faults)
        if self.track is not None:
            _flight(self.track).random_start(np.random.default_rng(0), self.duration)  # complains

    def _check_radar_position(self) -> None:
        place = self.radar_position
        if place is None:
            return
        right = isinstance(place, Sequence) and not isinstance(place, str) and len(place) == 3
        if not (right and all(is_number(value) for value in place) and abs(place[0]) <= 90.0):
            raise ValueError(
                "radar_position must be (latitude, longitude, height) in degrees and metres, "
                f"got {place!r}."
            )

    def __reduce__(self):
        # Without what is derived: compiled and local functions cannot be pickled.
        return type(self), tuple(getattr(self, item.name) for item in fields(self))

    @cached_property
    def sensor(self) -> Sensor:
        """Range, azimuth and elevation."""
        return radar()

    @property
    @abstractmethod
    def motion(self) -> Motion:
        """What the filter believes about the target's motion."""

    @cached_property
    def time(self) -> Array:
        """The instants of an episode, s."""
        return np.arange(round(self.duration * self.rate) + 1) / self.rate

    @property
    def dimensions(self) -> tuple[int, int]:
        """Number of motion inputs and of sensor inputs."""
        return 0, 0

    def sample(self, rngs: Sequence[Generator]) -> Recording:
        """Draw one episode from each generator."""
        return stack([self._sample_one(rng) for rng in rngs])

    def trajectory(self, rng: Generator) -> Array:
        """Truth (T, 9) of one episode."""
        if self.track is None:
            return paper_trajectory("A", self.time)
        from kfenv.scenarios import tracks

        flight = _flight(self.track)
        if self.radar_position is None:
            return tracks.window(rng, flight, self.time)
        start = flight.random_start(rng, self.duration)
        return tracks.from_radar(flight, self.radar_position, start + self.time)

    def spoil(self, draft: RadarDraft, rng: Generator) -> None:
        """Apply the faults in turn."""
        for fault in resolve_faults(self.faults, self.presets, self.known_faults):
            fault.apply(draft, rng)

    @abstractmethod
    def noise(self, draft: RadarDraft, snr: Array) -> Array:
        """Standard deviations (T, 3) at a given signal to noise, before the faults' factors."""

    def draft(self, truth: Array) -> RadarDraft:
        """The clean episode."""
        position = np.stack(self._measure(tuple(truth.T), ()), axis=-1)
        return RadarDraft.clean(self.time, 3, position=position)

    @cached_property
    def _measure(self):
        return self.sensor.build(batch)

    def _sample_one(self, rng: Generator) -> Recording:
        truth = self.trajectory(rng)
        draft = self.draft(truth)
        self.spoil(draft, rng)
        true_noise = self.noise(draft, draft.snr) * draft.noise_factor
        told_noise = self.noise(draft, draft.told_snr) * draft.told_factor
        measurement = draft.position + true_noise * rng.standard_normal(true_noise.shape)
        measurement[:, 1] = np.arctan2(np.sin(measurement[:, 1]), np.cos(measurement[:, 1]))
        measurement[~draft.available] = np.nan
        deviation = np.tile(self.initial_deviation, 3)
        mean = truth[0] + deviation * rng.standard_normal(9)
        return Recording(
            time=self.time,
            measurement=measurement[None],
            noise=told_noise[None],
            mean=mean[None],
            factor=np.diag(deviation)[None],
            motion_inputs=np.empty((1, len(self.time), 0)),
            sensor_inputs=np.empty((1, len(self.time), 0)),
            truth=truth[None],
            true_noise=true_noise[None],
            faults=(tuple(draft.intervals),),
        )


@lru_cache(maxsize=16)
def _flight(path: str):
    """The smoothed flight in a track file."""
    from kfenv.scenarios import tracks

    return tracks.smooth_track(tracks.load_track(path))
