"""A target whose position is measured from reflections of GPS signals (SPEC 3.1, 7.1 E5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Motion, Sensor
from kfenv.models.position import position
from kfenv.scenarios.faults import Draft, Fault, Glint, Jamming, NoiseMisreport, SignalLoss
from kfenv.scenarios.radar.plotted import PlotFiles, Plotted
from kfenv.scenarios.trajectories import accelerated_flights

Array = NDArray[np.float64]

DURATION, PAPER_DURATION = 60.0, 24.5  # s, unless told; the published case has 50 measurements
SPECTRAL_DENSITY = 0.2  # m^2/s^5
VARIANCE = (10.0, 8.0, 5.0)  # m^2, of x, y and z


@dataclass(frozen=True)
class BistaticTracking(Plotted):
    """The scenario of ``kfenv/BistaticTracking-v0``.

    The duration is by default that of the published case, or that of a training episode.
    The published case is S3's but for the time between measurements and the flights, which
    are ours: S3 tells no time step, and draws flights that its filter's model does not.
    """

    duration: float | None = None
    rate: float = 2.0
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "random"
    plots: PlotFiles | None = None

    name: ClassVar[str] = "BistaticTracking"
    initial_deviation: ClassVar[tuple[float, ...]] = (sqrt(0.1), sqrt(0.1), sqrt(0.5))
    error_scale: ClassVar[float] = 10.0
    lost_distance: ClassVar[float] = 1_000.0  # a hundred error scales
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {
        "random": (Jamming(), SignalLoss(), Glint(), NoiseMisreport()),
        "paper": (),
        "none": (),
    }

    def __post_init__(self) -> None:
        if self.duration is None:
            duration = PAPER_DURATION if self.faults == "paper" else DURATION
            object.__setattr__(self, "duration", duration)
        self._settle_plots()
        super().__post_init__()
        self._check_plots()

    @cached_property
    def motion(self) -> Motion:
        """Constant acceleration, white jerk of 0.2 m^2/s^5; the truth moves so too."""
        return constant_acceleration(SPECTRAL_DENSITY)

    @cached_property
    def sensor(self) -> Sensor:
        """x, y and z."""
        return position()

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """From rest at the origin, driven by the model's own discrete noise."""
        return accelerated_flights(rngs, self.motion, np.zeros(9), self.time)

    def deviations(self, draft: Draft) -> tuple[Array, Array]:
        """The same at every time, and told as it is."""
        noise = np.broadcast_to(np.sqrt(VARIANCE), draft.exact.shape)
        return noise, noise

    def initial_means(self, start: Array, rngs: Sequence[Generator]) -> Array:
        """Drawn about the truth, but the truth itself in the published case."""
        return start if self.faults == "paper" else super().initial_means(start, rngs)
