"""An inertial unit aided by GNSS fixes of position, velocity and attitude (SPEC 3.5, 4.4, E6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import radians, sqrt
from typing import ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Motion, Sensor
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.strapdown import GRAVITY
from kfenv.models.vehicle_constraints import CHANNELS, with_constraints
from kfenv.scenarios.faults import (
    FAULTS,
    Draft,
    Fault,
    Glint,
    Jamming,
    NoiseMisreport,
    SignalLoss,
)
from kfenv.scenarios.inertial.arguments import (
    check_constraints,
    check_corrections,
    check_fix_noise,
    check_numbers,
)
from kfenv.scenarios.inertial.constraints import pseudo_measurements
from kfenv.scenarios.inertial.faults import (
    OUTLIER_SHARE,
    VARIANCE_RATIO,
    AccelerationStep,
    Interference,
    Outliers,
    RateStep,
)
from kfenv.scenarios.inertial.flights import exact_samples, paper_flight, random_flights
from kfenv.scenarios.inertial.log import InertialLog
from kfenv.scenarios.inertial.motion import motion_of
from kfenv.scenarios.inertial.reading import check_paths, read_log
from kfenv.scenarios.inertial.teaching import Lessons, lessons
from kfenv.scenarios.inertial.units import markov, of_unit
from kfenv.scenarios.recording import Recording, Whole, stack
from kfenv.scenarios.scenario import TrackingScenario
from kfenv.scenarios.trajectories import MAX_DURATION

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz, at which the noise of an inertial sample is given
INSTABILITY_TIME = 100.0  # s, correlation time of a wandering bias

# Standard deviations after a second: S4 Table 1, and a small unit on a vehicle
PAPER_NOISE, UNIT_NOISE = (10.0, 2.0, 0.5), (0.01, 0.02, 0.05)
FIRST_BIAS = (0.3, 0.5)  # m/s^2, deg/s: of a log's unit before anything is known of it
OUTAGE = 15.0  # s, of the schedule
LEAST_BIAS = (1e-4, 1e-4)  # in the same units: a filter's factor has no zeros


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
    process_noise: tuple[float, float, float] | None = None
    log: Sequence[str] | None = None
    biases: bool | None = None
    bias_drift: tuple[float, float] = (2e-3, 2e-3)
    bias_time: tuple[float, float] = (1000.0, 1000.0)
    earth: bool = False
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time_offset: float = 0.0
    constraints: Sequence[str] = ()
    constraint_noise: tuple[float, float, float] = (0.5, 0.05, 0.05)

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
        self._settle_defaults()
        check_fix_noise(self.gnss_noise)
        check_numbers(self, "process_noise", ("m", "m/s", "deg"))
        for name in ("imu_noise", "imu_bias", "imu_instability"):
            check_numbers(self, name, ("m/s^2", "deg/s"), zero=True)
        check_numbers(self, "bias_drift", ("m/s^2", "deg/s"))
        check_numbers(self, "bias_time", ("s", "s"))
        if self.earth and not (self.biases and self.log is not None):
            raise ValueError(
                "earth=True is for a log and a filter with biases: simulated flights are over a "
                "flat Earth at rest."
            )
        check_numbers(self, "constraint_noise", ("m/s", "m/s", "deg/s"))
        check_constraints(self.constraints, self.log is not None, bool(self.biases))
        _ = self.motion  # complains
        if self.log is not None:
            self._log.starts(self.duration, "tuning")  # complains
        self._check_measurement_rate()
        if self.log is None and self.faults != "paper" and self.duration > MAX_DURATION:
            raise ValueError(
                f"A random flight lasts at most {MAX_DURATION:g} s, got duration="
                f"{self.duration!r}: run more episodes instead."
            )

    def _settle_defaults(self) -> None:
        """What a log gives, or has other defaults for than a simulation."""
        real = self.log is not None
        check_corrections(self.mounting, self.time_offset, real)
        if real:
            object.__setattr__(self, "log", check_paths(self.log))
            object.__setattr__(self, "measurement_rate", self.rate / self._log.steps_per_fix)
        if self.process_noise is None:
            object.__setattr__(self, "process_noise", UNIT_NOISE if real else PAPER_NOISE)
        if self.biases is None:
            object.__setattr__(self, "biases", real)

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
        """Strapdown mechanisation driven by the samples, with or without their biases."""
        if not self.biases:
            return motion_of(tuple(self.process_noise))
        drift, time = tuple(self.bias_drift), tuple(self.bias_time)
        return motion_of(tuple(self.process_noise), drift, time, bool(self.earth))

    @cached_property
    def sensor(self) -> Sensor:
        """Position, velocity and attitude; of a log no attitude, but perhaps constraints."""
        return with_constraints(navigation_fix(attitude=self.log is None), self._constraints)

    @property
    def _constraints(self) -> tuple[str, ...]:
        """Those that are told, in the order of all."""
        return tuple(name for name in CHANNELS if name in self.constraints)

    @property
    def _constraint_deviations(self) -> Array:
        """Standard deviations (k,) of their channels, SI."""
        across, velocity, rate = self.constraint_noise
        deviations = dict(zip(CHANNELS, (across, velocity, radians(rate)), strict=True))
        return np.concatenate(
            [np.empty(0), *([deviations[n]] * len(CHANNELS[n]) for n in self._constraints)]
        )

    @property
    def _log(self) -> InertialLog:
        mounting = tuple(np.radians(self.mounting).tolist())
        return read_log(self.log, float(self.rate), mounting, float(self.time_offset))

    @property
    def _lessons(self) -> Lessons:
        bias = tuple(self._bias_deviations(FIRST_BIAS).tolist())
        return lessons(self._log, self.motion, bias)

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
        """Standard deviations (9,) of the initial estimate, or (15,) with the unit's biases."""
        bias = self._bias_deviations(np.hypot(self.imu_bias, self.imu_instability))
        return np.concatenate([np.repeat(self.initial_deviation, 3), bias])

    def _bias_deviations(self, given: Sequence[float]) -> Array:
        """Of six biases, SI, given in m/s^2 and deg/s; none of a filter without."""
        force, rate = np.maximum(given, LEAST_BIAS)
        return np.repeat([force, radians(rate)], 3) if self.biases else np.empty(0)

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
        """The windows of a log that are kept for a split, None for other episodes.

        Outages follow a fixed schedule, in every split: those of validation and test tile
        their part, those to tune on are as many as asked. Other faults spoil windows that
        do not overlap, and tuning draws its own.

        Raises:
            ValueError: if the log is too short for one.
        """
        if self.log is None:
            return None
        if self._misses_fixes:
            tiles = self._log.apart(self.duration, split, self.outage)
            if split == "tuning":
                tiles = self._log.starts(self.duration, split)
            chosen = np.rint(np.linspace(0, len(tiles) - 1, min(episodes, len(tiles))))
            return self._outages(tiles[chosen.astype(np.int64)])
        if split == "tuning":
            return None
        starts = self._log.apart(self.duration, split, self.duration + 1.0 / self.rate)[:episodes]
        return stack([self._replay(start, np.random.default_rng(start)) for start in starts])

    @property
    def outage(self) -> float:
        """Length of an outage on the schedule, s: it ends its window, and is at most 0.6 of it."""
        return min(OUTAGE, 0.6 * self.duration)

    @property
    def _misses_fixes(self) -> bool:
        return self.faults in ("random", "outages")

    def outages_at(self, times: Sequence[float]) -> Recording:
        """Windows of a log in which the fixes after these times, s of its clock, are withheld.

        Each begins `duration` less `outage` before its time and ends with its outage.

        Raises:
            ValueError: if a window is not within the log, after the vehicle first moved.
        """
        places = [self._log.place_before(time, self.duration, self.outage) for time in times]
        return self._outages(np.array(places))

    def _outages(self, starts: Array) -> Recording:
        lead = self.duration - self.outage + 0.5 / self.rate  # the fix at its begin is the last
        fault = SignalLoss(duration=(self.outage, self.outage), start=lead)
        return stack([self._replay(i, np.random.default_rng(i), (fault,)) for i in starts])

    def episodes(self, rngs: Sequence[Generator]) -> Recording:
        """Draw episodes, or windows of the log's part for training."""
        if self.log is None:
            return super().episodes(rngs)
        faults = self.presets["outages"] if self._misses_fixes else None
        starts = self._log.starts(self.duration, "tuning")
        return stack([self._replay(rng.choice(starts), rng, faults) for rng in rngs])

    def whole(self, after: float | None = None) -> Whole | None:
        """All of a log from the first fix after which the vehicle moved; it begins once."""
        if self.log is None or after is not None:
            return None
        log, start = self._log, self._log.first_moving
        begin = log.row[start]
        time = np.arange(len(log.time) - begin) / self.rate
        recording = self._replay(start, np.random.default_rng(0), (), time)
        if log.truth is None:
            recording = replace(recording, truth=None, scored=None)
        return Whole(recording, float(log.time[begin]))

    def geodetic(self, position: Array) -> Array | None:
        """North, east and down of the first fix of a log."""
        if self.log is None:
            return None
        return self._log.geodetic(self._log.first_moving, position)

    def _replay(
        self, start: int, rng: Generator, faults: Sequence[Fault] | None = None,
        time: Array | None = None,
    ) -> Recording:  # fmt: skip
        """A window of the log; faults that raise the noise add what is missing to it."""
        time = self.time if time is None else time
        window = self._log.window(start, time[-1])
        inputs = self._log.motion_inputs(window.rows, start, len(self.motion.inputs))
        draft = Draft.clean(
            time, window.fix.shape[1], exact=window.fix, motion_inputs=inputs,
            sensor_inputs=np.empty((len(time), 0)),
        )  # fmt: skip
        draft.available[:] = window.arrived[:, None]
        if faults is None:
            self.spoil(draft, rng)
        for fault in faults or ():
            fault.apply(draft, rng)
        missing = np.sqrt(np.maximum(draft.noise_factor**2 - 1.0, 0.0)) * window.deviation
        measurement = draft.exact + missing * rng.standard_normal(missing.shape)
        measurement[~draft.available] = np.nan
        withheld = window.arrived & ~draft.available.any(axis=1)
        of_constraints = pseudo_measurements(self._log, window.rows, self._constraints)
        same = np.tile(self._constraint_deviations, (len(time), 1))
        mean, factor = self._lessons.at(start)
        unknown = np.zeros((len(time), len(mean) - window.truth.shape[1]))
        return Recording(
            time=time,
            measurement=np.hstack([measurement, of_constraints])[None],
            noise=np.hstack([window.deviation * draft.told_factor, same])[None],
            mean=mean[None],
            factor=factor[None],
            motion_inputs=draft.motion_inputs[None],
            sensor_inputs=draft.sensor_inputs[None],
            truth=np.hstack([window.truth, unknown])[None],
            true_noise=np.hstack([window.deviation * draft.noise_factor, same])[None],
            scored=withheld[None] if self._log.truth is None else None,
            faults=(tuple(draft.intervals),),
        )

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Flights of the paper's case, or random ones: truth (B, T, 9); (B, T, 15) with biases."""
        if self.faults == "paper":
            flights = np.tile(paper_flight(self.time), (len(rngs), 1, 1))
        else:
            flights = random_flights(rngs, self.time)
        if not self.biases:
            return flights
        biases = np.stack([self._constant(rng) + self._wandering(rng) for rng in rngs])
        return np.concatenate([flights, biases], axis=-1)

    def drafts(self, truth: Array, rngs: Sequence[Generator]) -> Draft:
        """Inertial samples with the unit's errors, and a fix every so many of them."""
        samples = exact_samples(truth[..., :9], self.time)
        errors = self.inertial_errors(rngs)
        samples += errors + truth[..., 9:] if self.biases else errors
        if self.biases:
            gravity = np.tile([GRAVITY, 0.0, 0.0], (*samples.shape[:-1], 1))
            samples = np.concatenate([samples, gravity], axis=-1)
        draft = self.clean(Draft, truth, samples)
        draft.available[:] = False
        draft.available[:, :: self.steps_per_measurement] = True
        return draft

    def deviations(self, draft: Draft) -> tuple[Array, Array]:
        """The same at every time."""
        same = np.broadcast_to(self.fix_deviations, draft.exact.shape)
        return same, same

    def inertial_errors(self, rngs: Sequence[Generator]) -> Array:
        """Errors (B, T, 6) of the samples: white noise, and biases that are no states."""
        errors = np.empty((len(rngs), len(self.time), 6))
        deviation = sqrt(self.rate / SAMPLE_RATE) * of_unit(self.imu_noise)
        for rng, own in zip(rngs, errors, strict=True):
            rng.standard_normal(out=own)
            own *= deviation
            if not self.biases:
                own += self._constant(rng)
                own += self._wandering(rng)
        return errors

    def _constant(self, rng: Generator) -> Array:
        """The given bias in the paper's case, otherwise one drawn with that deviation."""
        drawn, bias = rng.standard_normal(6), of_unit(self.imu_bias)
        return bias if self.faults == "paper" else bias * drawn

    def _wandering(self, rng: Generator) -> Array:
        deviation = of_unit(self.imu_instability)
        return markov(rng, len(self.time), 1.0 / self.rate, INSTABILITY_TIME, deviation)
