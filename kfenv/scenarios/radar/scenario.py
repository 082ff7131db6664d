"""What the radar scenarios share: flight, geometry, faults, measurements."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import pymap3d
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Sensor
from kfenv.models.phased_array import PhasedArray, rain_transmission
from kfenv.models.radar import radar
from kfenv.scenarios import tracks
from kfenv.scenarios.draft import Draft
from kfenv.scenarios.draws import Draws
from kfenv.scenarios.faults import Range, Together, between, check_range, check_start
from kfenv.scenarios.radar.plotted import PlotFiles, Plotted
from kfenv.scenarios.tracks import LONGEST_GAP, check_track
from kfenv.scenarios.trajectories import paper_trajectory

Array = NDArray[np.float64]


@dataclass
class RadarDraft(Draft):
    """A draft that knows the S/N; `exact` holds range, azimuth and elevation, m and rad.

    Attributes:
        snr: (T,) single-pulse signal to noise and jamming, linear.
        told_snr: (T,) the same as the filter is told.
        array: the radar, where the radar equation gives the noise.
    """

    snr: Array = field(default_factory=lambda: np.empty(0))
    told_snr: Array = field(default_factory=lambda: np.empty(0))
    array: PhasedArray | None = None


@dataclass(frozen=True)
class Rain(Together):
    """Rain over the whole area; it weakens the echo and the radar knows.

    Attributes:
        rate: range of the rain rate, mm/h.
    """

    label: ClassVar[str] = "rain"
    rate: Range = (0.0, 50.0)

    def __post_init__(self) -> None:
        check_range(self, "rate", lowest=0)

    def apply_all(self, draft: RadarDraft, rngs: Sequence[Generator]) -> None:
        rate = between(self.rate, Draws(rngs, 1).left)
        transmission = rain_transmission(draft.exact[..., 0], rate)
        draft.snr *= transmission
        draft.told_snr *= transmission
        draft.each_throughout(self.label)


@dataclass(frozen=True)
class SelfScreeningJammer:
    """A jammer carried by the target, in the main lobe; power and bandwidth of Table 4 (SPEC 4.2).

    Attributes:
        start: when it begins, s; published is "at about 70 s".
        duration: its length, s; ours, none is published.
        known: whether the filter is told the jammed noise, as published.
        power: radiated effectively (ERP), W; with 0 nothing is jammed.
        bandwidth: Hz.
    """

    label: ClassVar[str] = "jamming"
    start: float = 70.0
    duration: float = 30.0
    known: bool = True
    power: float = 15.0
    bandwidth: float = 0.15e9

    def __post_init__(self) -> None:
        check_start(self)
        if not is_number(self.start) or not is_number(self.duration) or self.duration <= 0.0:
            raise ValueError(
                "SelfScreeningJammer needs a start and a positive duration in seconds, got "
                f"{self.start!r} and {self.duration!r}."
            )
        for name, lowest in (("power", 0.0), ("bandwidth", 1.0)):
            value = getattr(self, name)
            if not is_number(value) or value < lowest:
                raise ValueError(
                    f"SelfScreeningJammer.{name} must be a number, {lowest:g} or more, "
                    f"got {value!r}."
                )

    def apply(self, draft: RadarDraft, rng: Generator) -> None:
        jammed = draft.window(self.label, self.start, self.duration)
        noise_rise = 1.0 + draft.array.jammer_to_noise(
            draft.exact[jammed, 0], self.power, self.bandwidth
        )
        draft.snr[jammed] /= noise_rise
        if self.known:
            draft.told_snr[jammed] /= noise_rise


@dataclass(frozen=True)
class RadarScenario(Plotted):
    """A target seen by a radar at the origin; see the environments' pages for the fields."""

    track: str | None = None
    plots: PlotFiles | None = None
    radar_position: tuple[float, float, float] | None = None
    cutoff: float | None = None
    longest_gap: float = LONGEST_GAP
    altitude_offset: float = 0.0

    circular: ClassVar[tuple[int, ...]] = (1,)  # the azimuth

    def __post_init__(self) -> None:
        self._check_radar_position()
        self._settle_plots()
        super().__post_init__()
        self._check_plots()
        if self.plots is None:
            check_track(self, ("radar_position", "cutoff", "longest_gap", "altitude_offset"))
        if self.track is not None:
            self._flown(np.random.default_rng(0))  # complains

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

    @cached_property
    def sensor(self) -> Sensor:
        """Range, azimuth and elevation."""
        return radar()

    def geodetic(self, position: Array) -> Array | None:
        """East, north and up of the radar, if its place is told."""
        if self.radar_position is None:
            return None
        return np.stack(pymap3d.enu2geodetic(*position.T, *self.radar_position), axis=-1)

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, 9): trajectory A, or windows of the track."""
        if self.track is None:
            return np.tile(paper_trajectory("A", self.time), (len(rngs), 1, 1))
        return np.stack([self._flown(rng) for rng in rngs])

    def _flown(self, rng: Generator) -> Array:
        """A window of the track."""
        flight = tracks.flight(self.track, self.cutoff, self.longest_gap)
        if self.radar_position is None:
            return tracks.window(rng, flight, self.time, self.altitude_offset)
        start = flight.random_start(rng, self.duration)
        return tracks.from_radar(flight, self.radar_position, start + self.time)

    @abstractmethod
    def noise(self, draft: RadarDraft, snr: Array) -> Array:
        """Standard deviations (..., T, 3) at an S/N (..., T), before the faults' factors."""

    def deviations(self, draft: RadarDraft) -> tuple[Array, Array]:
        """From the S/N that is and the one the filter is told."""
        actual = self.noise(draft, draft.snr)
        if np.array_equal(draft.snr, draft.told_snr):
            return actual, actual
        return actual, self.noise(draft, draft.told_snr)

    def drafts(self, truth: Array, rngs: Sequence[Generator]) -> RadarDraft:
        """The clean episodes."""
        nothing = np.ones(truth.shape[:-1])
        return self.clean(RadarDraft, truth, snr=nothing, told_snr=nothing)
