"""The papers' validation cases: constant acceleration, fixed radar noise (SPEC 7.1 E1, E2).

Rates and noise are published; flight, initial deviation and process noise are ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import radians
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Motion
from kfenv.scenarios.faults import (
    Fault,
    Glint,
    Jamming,
    NoiseMisreport,
    SignalLoss,
    resolve_faults,
)
from kfenv.scenarios.radar.scenario import RadarDraft, RadarScenario, Rain, SelfScreeningJammer

Array = NDArray[np.float64]

PUBLISHED_NOISE = {10.0: (20.0, 1.45, 1.45), 2.0: (30.0, 1.45, 5.0)}  # Hz: m, deg, deg


@dataclass(frozen=True)
class RadarValidation(RadarScenario):
    """The scenario of ``kfenv/RadarValidation-v0``."""

    duration: float = 250.0
    rate: float = 10.0
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "none"
    noise_deviation: tuple[float, float, float] | None = None

    name: ClassVar[str] = "RadarValidation"
    initial_deviation: ClassVar[tuple[float, float, float]] = (300.0, 30.0, 3.0)
    error_scale: ClassVar[float] = 100.0
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {
        "none": (),
        "paper": (),
        "random": (Jamming(), SignalLoss(), Glint(), NoiseMisreport()),
    }

    def __post_init__(self) -> None:
        self._check_deviation()
        super().__post_init__()
        if self.plots is None and self.noise_deviation is None and self.rate not in PUBLISHED_NOISE:
            raise ValueError(
                f"No noise is published for {self.rate:g} Hz: use rate=10 or rate=2, or give "
                "noise_deviation=(metres, degrees, degrees)."
            )
        for fault in resolve_faults(self.faults, self.presets, self.known_faults):
            if isinstance(fault, Rain | SelfScreeningJammer):
                raise ValueError(
                    f"{fault!r} acts through the radar equation, which fixed noise has not: "
                    "leave it out, or use RadarTracking."
                )

    def _check_deviation(self) -> None:
        deviation = self.noise_deviation
        if deviation is None:
            return
        triple = isinstance(deviation, Sequence | np.ndarray) and len(deviation) == 3
        if not triple or not all(is_number(value) and value > 0.0 for value in deviation):
            raise ValueError(
                "noise_deviation must hold three positive numbers (range in m, azimuth and "
                f"elevation in degrees), got {self.noise_deviation!r}."
            )

    @property
    def deviation_at_boundary(self) -> tuple[float, float, float]:
        """Noise of range, azimuth and elevation in m, deg, deg."""
        if self.noise_deviation is None:
            return PUBLISHED_NOISE[self.rate]
        return self.noise_deviation

    @cached_property
    def motion(self) -> Motion:
        """Constant acceleration, white jerk of 1 m^2/s^5."""
        return constant_acceleration(1.0)

    def noise(self, draft: RadarDraft, snr: Array) -> Array:
        """The same at every time."""
        distance, azimuth, elevation = self.deviation_at_boundary
        deviation = (distance, radians(azimuth), radians(elevation))
        return np.broadcast_to(deviation, draft.exact.shape)
