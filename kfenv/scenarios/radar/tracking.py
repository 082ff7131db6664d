"""A manoeuvring aircraft before a phased-array radar under faults (SPEC 4.2, 7.1 E3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.model import Motion
from kfenv.models.phased_array import PhasedArray
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.draft import split
from kfenv.scenarios.faults import FAULTS, Fault, Glint, Jamming, NoiseMisreport, SignalLoss
from kfenv.scenarios.radar.scenario import RadarDraft, RadarScenario, Rain, SelfScreeningJammer
from kfenv.scenarios.trajectories import (
    MAX_DURATION,
    paper_trajectory,
    random_trajectories,
    style_of,
)

Array = NDArray[np.float64]

DURATION, PAPER_DURATION = 120.0, 250.0  # s, unless told; 250 s is the whole of trajectory B


@dataclass(frozen=True)
class RadarTracking(RadarScenario):
    """The scenario of ``kfenv/RadarTracking-v0``.

    The duration is by default that of the paper's case, or that of a training episode.
    """

    duration: float | None = None
    rate: float = 10.0
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "random"
    flights: str = "manoeuvring"

    name: ClassVar[str] = "RadarTracking"
    radar: ClassVar[PhasedArray] = PhasedArray()
    initial_deviation: ClassVar[tuple[float, float, float]] = (50.0, 20.0, 3.0)
    error_scale: ClassVar[float] = 50.0
    known_faults: ClassVar[Mapping[str, type]] = FAULTS | {
        "rain": Rain,
        "self_screening_jammer": SelfScreeningJammer,
    }
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {
        "random": (Rain(), Jamming(), SignalLoss(), Glint(), NoiseMisreport()),
        "paper": (SelfScreeningJammer(), SignalLoss(duration=(10.0, 10.0), start=150.0)),
        "none": (),
    }

    def __post_init__(self) -> None:
        if self.duration is None:
            duration = PAPER_DURATION if self.faults == "paper" else DURATION
            object.__setattr__(self, "duration", duration)
        super().__post_init__()
        style_of(self.flights)  # complains
        at_random = self.track is None and self.plots is None and self.faults != "paper"
        if not at_random and self.flights != "manoeuvring":
            raise ValueError(
                "flights says how random flights are flown: leave it out with a track or "
                "faults='paper'."
            )
        if at_random and self.duration > MAX_DURATION:
            raise ValueError(
                f"A random flight lasts at most {MAX_DURATION:g} s, got duration="
                f"{self.duration!r}: run more episodes instead."
            )

    @cached_property
    def motion(self) -> Motion:
        """Variable turn, white jerk of 1 m^2/s^5."""
        return variable_turn(1.0)

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Trajectory B in the paper's case, the given track, or random flights."""
        if self.track is not None:
            return super().trajectories(rngs)
        if self.faults == "paper":
            return np.tile(paper_trajectory("B", self.time), (len(rngs), 1, 1))
        return random_trajectories(rngs, self.time, self.flights)

    def drafts(self, truth: Array, rngs: Sequence[Generator]) -> RadarDraft:
        """The clean episodes: S/N from the radar equation, nothing beyond the scan limit."""
        draft = super().drafts(truth, rngs)
        distance, azimuth, elevation = split(draft.exact)
        draft.array = self.radar
        draft.snr = self.radar.signal_to_noise(distance, azimuth, elevation)
        draft.told_snr = draft.snr.copy()
        draft.available &= self.radar.detects(azimuth, elevation)[..., None]
        return draft

    def noise(self, draft: RadarDraft, snr: Array) -> Array:
        """From the integrated S/N."""
        # beyond the limit nothing arrives: any finite value will do
        azimuth, elevation = self.radar.within_scan(*split(draft.exact)[1:])
        return self.radar.noise(self.radar.integrated(snr), azimuth, elevation)
