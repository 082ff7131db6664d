"""An inertial unit aided by GNSS fixes of position, velocity and attitude (SPEC 3.5, 4.4, E6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import exp, radians, sqrt
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Motion, Sensor
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.strapdown import strapdown
from kfenv.scenarios.faults import (
    FAULTS,
    Draft,
    Fault,
    Glint,
    Jamming,
    NoiseMisreport,
    SignalLoss,
)
from kfenv.scenarios.inertial.faults import (
    OUTLIER_SHARE,
    VARIANCE_RATIO,
    AccelerationStep,
    Interference,
    Outliers,
    RateStep,
)
from kfenv.scenarios.inertial.flights import exact_samples, paper_flight, random_flight
from kfenv.scenarios.inertial.log import InertialLog
from kfenv.scenarios.inertial.reading import check_paths, read_log
from kfenv.scenarios.recording import Recording, stack
from kfenv.scenarios.scenario import TrackingScenario
from kfenv.scenarios.trajectories import MAX_DURATION

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz, at which the noise of an inertial sample is given
INSTABILITY_TIME = 100.0  # s, correlation time of a wandering bias


@dataclass(frozen=True)
class InsGnss(TrackingScenario):
    """The scenario of ``kfenv/InsGnss-v0``; see its page for the fields.

    Noise of the fixes, process noise and initial uncertainty are those of the paper's tables
    (S4 Tables 1, 2); the inertial unit and the flights are ours.
    """

    duration: float = 50.0
    rate: float = 100.0
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "random"
    measurement_rate: float = 10.0
    gnss_noise: Sequence[float | Sequence[float]] = ((100.0, 100.0, 150.0), (2.0, 2.0, 5.0), 1.5)
    imu_noise: tuple[float, float] = (0.3, 0.3)
    imu_bias: tuple[float, float] = (0.1, 0.1)
    imu_instability: tuple[float, float] = (0.0, 0.0)
    process_noise: tuple[float, float, float] = (10.0, 2.0, 0.5)
    log: Sequence[str] | None = None

    name: ClassVar[str] = "InsGnss"
    initial_deviation: ClassVar[tuple[float, ...]] = (100.0, 10.0, radians(10.0))
    error_scale: ClassVar[float] = 20.0
    mixture: ClassVar[tuple[float, float]] = (OUTLIER_SHARE, VARIANCE_RATIO)
    known_faults: ClassVar[Mapping[str, type]] = FAULTS | {
        "outliers": Outliers,
        "interference": Interference,
        "acceleration_step": AccelerationStep,
        "rate_step": RateStep,
    }
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {
        "random": (
            Jamming(bursts=(0, 1), duration=(3.0, 10.0), factor=(2.0, 10.0)),
            SignalLoss(),
            Glint(),
            NoiseMisreport(),
            Interference(factor=(3.0, sqrt(VARIANCE_RATIO))),
            AccelerationStep(),
            RateStep(size=(0.5, 3.0)),
        ),
        "paper": (Outliers(),),
        "outages": (SignalLoss(duration=(5.0, 15.0)),),
        "none": (),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.log is not None:
            object.__setattr__(self, "log", check_paths(self.log))
            object.__setattr__(self, "measurement_rate", self.rate / self._log.steps_per_fix)
            self._log.starts(self.duration, "tuning")  # complains
        _check_fix_noise(self.gnss_noise)
        _check_numbers(self, "process_noise", ("m", "m/s", "deg"))
        for name in ("imu_noise", "imu_bias", "imu_instability"):
            _check_numbers(self, name, ("m/s^2", "deg/s"), zero=True)
        self._check_measurement_rate()
        if self.log is None and self.faults != "paper" and self.duration > MAX_DURATION:
            raise ValueError(
                f"A random flight lasts at most {MAX_DURATION:g} s, got duration="
                f"{self.duration!r}: run more episodes instead."
            )

    def _check_measurement_rate(self) -> None:
        if not is_number(self.measurement_rate) or not self.measurement_rate > 0.0:
            raise ValueError(
                "measurement_rate must be a positive number of fixes per second, "
                f"got {self.measurement_rate!r}."
            )
        steps = self.rate / self.measurement_rate
        if steps > 1.0 and abs(steps - round(steps)) > 1e-9:
            raise ValueError(
                f"A fix must fall on an inertial sample: rate={self.rate:g} is no multiple of "
                f"measurement_rate={self.measurement_rate:g}."
            )

    @cached_property
    def motion(self) -> Motion:
        """Strapdown mechanisation driven by the samples."""
        position, velocity, attitude = self.process_noise
        return strapdown((position, velocity, radians(attitude)))

    @cached_property
    def sensor(self) -> Sensor:
        """Position, velocity and attitude; of a log no attitude."""
        return navigation_fix(attitude=self.log is None)

    @property
    def _log(self) -> InertialLog:
        return read_log(self.log, float(self.rate))

    @property
    def circular(self) -> tuple[int, ...]:
        """The channels of attitude."""
        return () if self.log is not None else (6, 7, 8)

    @property
    def steps_per_measurement(self) -> int:
        """Inertial samples from one fix to the next."""
        return max(1, round(self.rate / self.measurement_rate))

    @property
    def initial_deviations(self) -> Array:
        """Standard deviations (9,) of the initial estimate."""
        return np.repeat(self.initial_deviation, 3)

    @property
    def fix_deviations(self) -> Array:
        """Standard deviations (9,) of a fix without faults."""
        deviations = np.array([np.broadcast_to(given, 3) for given in self.gnss_noise])
        deviations[2] = np.radians(deviations[2])
        return deviations.ravel()

    def local_frame(self, position: Array) -> tuple[Array, Array]:
        """East, north and up of the same origin."""
        return np.zeros(3), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

    def recorded(self, split: str, episodes: int) -> Recording | None:
        """The windows of a log that are kept for validation or test, None for other episodes.

        Raises:
            ValueError: if the log is too short for one.
        """
        if self.log is None or split == "tuning":
            return None
        starts = self._log.apart(self.duration, split)[:episodes]
        return stack([self._replay(start, np.random.default_rng(start)) for start in starts])

    def episode(self, rng: Generator) -> Recording:
        """Draw one episode, or a window of the log's part for training."""
        if self.log is None:
            return super().episode(rng)
        return self._replay(rng.choice(self._log.starts(self.duration, "tuning")), rng)

    def spoil(self, draft: Draft, rng: Generator) -> None:
        """Apply the faults in turn; to a log the default ones are outages."""
        if self.log is None or self.faults != "random":
            super().spoil(draft, rng)
        else:
            for fault in self.presets["outages"]:
                fault.apply(draft, rng)

    def _replay(self, start: int, rng: Generator) -> Recording:
        """A window of the log; faults that raise the noise add what is missing to it."""
        window = self._log.window(start, self.duration)
        draft = Draft.clean(
            self.time, window.fix.shape[1], exact=window.fix, motion_inputs=window.samples.copy(),
            sensor_inputs=np.empty((len(self.time), 0)),
        )  # fmt: skip
        draft.available[:] = window.arrived[:, None]
        self.spoil(draft, rng)
        missing = np.sqrt(np.maximum(draft.noise_factor**2 - 1.0, 0.0)) * window.deviation
        measurement = draft.exact + missing * rng.standard_normal(missing.shape)
        measurement[~draft.available] = np.nan
        withheld = window.arrived & ~draft.available.any(axis=1)
        return Recording(
            time=self.time,
            measurement=measurement[None],
            noise=(window.deviation * draft.told_factor)[None],
            mean=window.mean[None],
            factor=window.factor[None],
            motion_inputs=draft.motion_inputs[None],
            sensor_inputs=draft.sensor_inputs[None],
            truth=window.truth[None],
            true_noise=(window.deviation * draft.noise_factor)[None],
            scored=withheld[None] if self._log.truth is None else None,
            faults=(tuple(draft.intervals),),
        )

    def trajectory(self, rng: Generator) -> Array:
        """The flight of the paper's case, or a random one: truth (T, 9)."""
        return paper_flight(self.time) if self.faults == "paper" else random_flight(rng, self.time)

    def draft(self, truth: Array, rng: Generator) -> Draft:
        """Inertial samples with the unit's errors, and a fix every so many of them."""
        samples = exact_samples(truth, self.time) + self.inertial_errors(rng)
        draft = self.clean(Draft, truth, samples)
        draft.available[:] = False
        draft.available[:: self.steps_per_measurement] = True
        return draft

    def deviations(self, draft: Draft) -> tuple[Array, Array]:
        """The same at every time."""
        same = np.broadcast_to(self.fix_deviations, draft.exact.shape)
        return same, same

    def inertial_errors(self, rng: Generator) -> Array:
        """Errors (T, 6) of the samples: white noise, constant bias, wandering bias.

        In the paper's case the bias is the given one on every axis; otherwise it is
        drawn with that deviation.
        """
        noise, bias, wander = (
            np.repeat([force, radians(rate)], 3)
            for force, rate in (self.imu_noise, self.imu_bias, self.imu_instability)
        )
        steps = len(self.time)
        white = sqrt(self.rate / SAMPLE_RATE) * noise * rng.standard_normal((steps, 6))
        drawn = rng.standard_normal(6)
        constant = bias if self.faults == "paper" else bias * drawn
        return white + constant + wander * _markov(rng, steps, 1.0 / self.rate)


def _markov(rng: Generator, steps: int, dt: float) -> Array:
    """Six first-order Markov processes (T, 6) of unit deviation."""
    from scipy.signal import lfilter

    keep = exp(-dt / INSTABILITY_TIME)
    drive = rng.standard_normal((steps, 6))
    drive[1:] *= sqrt(1.0 - keep * keep)
    return lfilter([1.0], [1.0, -keep], drive, axis=0)


def _check_numbers(
    scenario: InsGnss, name: str, units: tuple[str, ...], zero: bool = False
) -> None:
    """Complain if a field does not hold one positive (or zero) number per unit."""
    given = getattr(scenario, name)
    right = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == len(units)
    if not right or not all(is_number(v) and (v > 0.0 or (zero and v == 0.0)) for v in given):
        bound = "numbers, zero or more" if zero else "positive numbers"
        raise ValueError(
            f"{name} must hold {len(units)} {bound} ({', '.join(units)}), got {given!r}."
        )


def _check_fix_noise(given: object) -> None:
    """Complain unless there are three deviations, each a positive number or one for each axis."""
    right = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == 3
    if not right or not all(_is_deviation(value) for value in given):
        raise ValueError(
            "gnss_noise must hold three deviations (position in m, velocity in m/s, attitude in "
            f"deg), each a positive number or three of them, one for each axis; got {given!r}."
        )


def _is_deviation(value: object) -> bool:
    """Whether it is a positive number, or three of them."""
    axes = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else (value,)
    return len(axes) in (1, 3) and all(is_number(number) and number > 0.0 for number in axes)
