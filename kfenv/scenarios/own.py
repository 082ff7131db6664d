"""Episodes of a user's own model: simulated from it, or a recording that the user has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from kfenv.checks import is_number
from kfenv.models import robot
from kfenv.models.covariances import deviations, positive_definite_factor
from kfenv.models.model import Motion, Sensor
from kfenv.models.probe import probe_motion, probe_sensor
from kfenv.models.yardstick import Yardstick
from kfenv.scenarios.faults import Draft, Fault, Glint, Jamming, NoiseMisreport, SignalLoss
from kfenv.scenarios.own_checks import (
    check_angles,
    check_recorded,
    check_scored,
    find_model,
    warn_of_angles,
)
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario
from kfenv.scenarios.trajectories import drawn_trajectory

Array = NDArray[np.float64]
Inputs = ArrayLike | Callable[[Generator, Array], ArrayLike]

DURATION, RATE = 20.0, 10.0  # s, 1/s, unless told
SPEED, TURN = 1.0, 0.4  # m/s, rad/s, of the example's drive
PARTS = {"tuning": (0.0, 0.4), "validation": (0.4, 0.6), "test": (0.6, 1.0)}  # of a recording


@dataclass(frozen=True, eq=False)
class OwnFilter(TrackingScenario):
    """The scenario of ``kfenv/Filter-v0``; see its page for the fields.

    Without a model it is the example of `kfenv.models.robot`.

    Raises:
        ValueError: for an argument that is none or does not go with the others, in one sentence.
    """

    motion: Motion | str | None = None
    sensor: Sensor | str | None = None
    scored: Sequence[str] | Sensor | None = None
    scale: float | Sequence[float] | None = None
    scored_rates: Sequence[str] = ()
    lost: float = 100.0
    recording: Recording | None = None
    R: ArrayLike | None = None
    mean: ArrayLike | None = None
    P: ArrayLike | None = None
    inputs: Inputs | None = None
    sensor_inputs: Inputs | None = None
    measure_every: int = 1
    duration: float = DURATION
    rate: float = RATE
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "random"

    name: ClassVar[str] = "Filter"
    rate_bounds: ClassVar[tuple[float, float]] = (1e-6, 1e6)

    def __post_init__(self) -> None:
        if self.motion is None and self.sensor is None:
            self._become_the_example()
        for name, kind in (("motion", Motion), ("sensor", Sensor)):
            object.__setattr__(self, name, find_model(name, getattr(self, name), kind))
        if self.recording is not None:
            check_recorded(self.recording, self.motion, self.sensor)
            object.__setattr__(self, "duration", float(np.ptp(self.time)))
            object.__setattr__(self, "rate", float(1.0 / np.median(np.diff(self.time))))
        super().__post_init__()
        probe_motion(self.motion)
        probe_sensor(self.sensor, len(self.motion.states))
        warn_of_angles(self.motion, self.sensor)
        check_scored(self.motion, self.scored, self.scored_rates, self.scale)
        self._check_numbers()

    def _become_the_example(self) -> None:
        example = {
            "motion": robot.robot(), "sensor": robot.beacons(), "scored": ("x", "y"), "scale": 0.1,
            "R": robot.NOISE, "mean": (4.0, 4.0, 0.0), "P": (0.04, 0.04, 0.01), "inputs": _drive,
        }  # fmt: skip
        for name, value in example.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def _check_numbers(self) -> None:
        if not is_number(self.lost) or not self.lost > 1.0:
            raise ValueError(f"lost must be a number of scales above 1, got {self.lost!r}.")
        every = self.measure_every
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise ValueError(f"measure_every must be a whole number, 1 or more, got {every!r}.")
        if self.recording is None:
            missing = [name for name in ("R", "mean", "P") if getattr(self, name) is None]
            if missing:
                raise ValueError(
                    f"{' and '.join(missing)} must be given to simulate the model (noise of the "
                    "measurements, initial mean and covariance), or a recording to replay."
                )
            _ = self._noise, self.initial_factor, self._start  # complain

    @cached_property
    def time(self) -> Array:
        """The instants of an episode, or of the recording's first, s."""
        return super().time if self.recording is None else np.atleast_2d(self.recording.time)[0]

    # ----- what is scored -------------------------------------------------------------

    @cached_property
    def yardstick(self) -> Yardstick:
        """What errors are measured of."""
        weights = () if is_number(self.scale) else tuple(1.0 / float(s) for s in self.scale)
        places = {state.name: i for i, state in enumerate(self.motion.states)}
        rates = tuple(places[name] for name in self.scored_rates)
        if isinstance(self.scored, Sensor):
            return Yardstick("scored", self.scored.channels, (), rates, weights, self.scored)
        states = tuple(places[name] for name in self.scored)
        components = tuple(self.motion.states[i] for i in states)
        return Yardstick("scored", components, states, rates, weights)

    @property
    def error_scale(self) -> float:
        """What errors are measured by: the scale, or one where every component has its own."""
        return float(self.scale) if is_number(self.scale) else 1.0

    @property
    def lost_distance(self) -> float:
        """A greater error is a loss."""
        return self.lost * self.error_scale

    # ----- simulation -----------------------------------------------------------------

    @property
    def presets(self) -> Mapping[str, tuple[Fault, ...]]:
        """Faults of any sensor, whose times are shares of the duration."""
        burst, gap = (0.04 * self.duration, 0.2 * self.duration), (0.02, 0.07)
        gap = tuple(share * self.duration for share in gap)
        faults = (Jamming(duration=burst), SignalLoss(duration=gap), Glint(), NoiseMisreport())
        return {"random": faults, "none": ()}

    @property
    def steps_per_measurement(self) -> int:
        """Filter steps from one measurement to the next."""
        return self.measure_every

    @property
    def circular(self) -> tuple[int, ...]:
        """Channels that are angles."""
        return tuple(i for i, channel in enumerate(self.sensor.channels) if channel.angle)

    @cached_property
    def _noise(self) -> Array:
        return deviations("R", self.R, len(self.sensor.channels))

    @cached_property
    def initial_factor(self) -> Array:
        """Lower factor (n, n) of P."""
        return positive_definite_factor("P", self.P, len(self.motion.states))

    @property
    def initial_deviations(self) -> Array:
        """Standard deviations (n,) of the initial estimate."""
        return np.sqrt(np.sum(self.initial_factor**2, axis=1))

    @cached_property
    def _start(self) -> Array:
        mean = np.atleast_1d(np.asarray(self.mean, np.float64))
        if mean.shape != (len(self.motion.states),) or not np.isfinite(mean).all():
            names = ", ".join(state.name for state in self.motion.states)
            raise ValueError(f"mean must hold a number for each of {names}, got {self.mean!r}.")
        return mean

    def episodes(self, rngs: Sequence[Generator]) -> Recording:
        """Draw episodes: inputs, truth about the mean, faults, measurement noise."""
        inputs = self._inputs("inputs", self.motion.inputs, rngs)
        truth = self.trajectories(rngs, inputs)
        shared = isinstance(self.sensor_inputs, str) and self.sensor_inputs == "inputs"
        sensed = inputs if shared else self._inputs("sensor_inputs", self.sensor.inputs, rngs)
        draft = self.clean(Draft, truth, inputs, sensed)
        check_angles(self.sensor, draft.exact)
        draft.available[:, np.arange(len(self.time)) % self.measure_every != 0] = False
        return self.measured(truth, draft, rngs)

    def trajectories(self, rngs: Sequence[Generator], inputs: Array | None = None) -> Array:
        """Truth (B, T, n), see `_moved`; inputs (B, T, p) of the motion."""
        inputs = [None] * len(rngs) if inputs is None else inputs
        return np.stack([self._moved(rng, given) for rng, given in zip(rngs, inputs, strict=True)])

    def _moved(self, rng: Generator, inputs: Array | None) -> Array:
        """Truth (T, n) that moves as the model does, from a start that P allows.

        Raises:
            ValueError: if it leaves the numbers.
        """
        start = self._start + self.initial_factor @ rng.standard_normal(len(self._start))
        with np.errstate(all="ignore"):
            truth = drawn_trajectory(rng, self.motion, start, self.time, inputs)
        if not np.isfinite(truth).all():
            when = self.time[np.argmin(np.isfinite(truth).all(axis=1))]
            raise ValueError(
                f"The simulated state is not finite from {when:g} s on: check f, the rate "
                f"({self.rate:g} per second) and Q."
            )
        return truth

    def deviations(self, draft: Draft) -> tuple[Array, Array]:
        """Those of R, told as they are."""
        noise = np.broadcast_to(self._noise, draft.exact.shape)
        return noise, noise

    def initial_means(self, start: Array, rngs: Sequence[Generator]) -> Array:
        """The mean itself: the truth is drawn about it."""
        return np.tile(self._start, (len(rngs), 1))

    def _inputs(self, name: str, wanted: Sequence[str], rngs: Sequence[Generator]) -> Array:
        """Known inputs (B, T, k) of episodes."""
        return np.stack([self._inputs_of_one(name, wanted, rng) for rng in rngs])

    def _inputs_of_one(self, name: str, wanted: Sequence[str], rng: Generator) -> Array:
        given, shape = getattr(self, name), (len(self.time), len(wanted))
        given = given(rng, self.time) if callable(given) else given
        if given is None and not wanted:
            return np.empty(shape)
        try:
            array = np.asarray(np.nan if given is None else given, np.float64)
        except (TypeError, ValueError):
            array = np.array(np.nan)  # no numbers
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(
                f"{name} must be an array of shape {shape} ({', '.join(wanted) or 'none'} at each "
                f"instant) or a function of a generator and the times that returns one, got "
                f"{'nothing' if given is None else f'shape {array.shape}'}."
            )
        return array

    # ----- a recording ----------------------------------------------------------------

    def recorded(self, split: str, episodes: int) -> Recording | None:
        """A recording's episodes that are kept for a split, None where episodes are simulated.

        Raises:
            ValueError: if there are too few.
        """
        if self.recording is None:
            return None
        first, last = (round(share * len(self.recording)) for share in PARTS[split])
        if last <= first:
            raise ValueError(
                f"The recording has {len(self.recording)} episodes, too few to keep some for "
                f"{split}: give 10 or more."
            )
        return self.recording[first : min(last, first + episodes)]

    def sample(self, rngs: Sequence[Generator]) -> Recording:
        """An episode for each generator: simulated, or any of the recording's tuning part."""
        if self.recording is None:
            return super().sample(rngs)
        part = self.recorded("tuning", len(self.recording))
        return part[[int(rng.integers(len(part))) for rng in rngs]]


def simulate(
    motion: Motion, sensor: Sensor, faults: Any = "random", *, episodes: int = 1, seed: int = 0,
    **keywords: Any,
) -> Recording:  # fmt: skip
    """Episodes of a model of one's own, with process noise, measurement noise and faults.

    Args:
        motion, sensor: the models.
        faults: as of ``kfenv/Filter-v0``, e.g. ``"none"``.
        episodes: how many.
        seed: the same seed gives the same bits; more episodes do not change the first.
        keywords: ``R``, ``mean``, ``P``, ``duration``, ``rate``, ``inputs``, ``sensor_inputs`` and
            ``measure_every`` as of ``kfenv/Filter-v0``.

    Raises:
        ValueError: in one sentence.
    """
    scored = {"scored": (motion.states[0].name,), "scale": 1.0}
    scenario = OwnFilter(motion=motion, sensor=sensor, faults=faults, **scored, **keywords)
    streams = np.random.SeedSequence(seed).spawn(episodes)
    return scenario.sample([np.random.default_rng(stream) for stream in streams])


def recording_of(
    time: ArrayLike, measurement: ArrayLike, R: ArrayLike, mean: ArrayLike, P: ArrayLike, *,
    inputs: ArrayLike | None = None, sensor_inputs: ArrayLike | None = None,
    truth: ArrayLike | None = None,
) -> Recording:  # fmt: skip
    """A recording of one log, or of several of the same times.

    Args:
        time: (T,) increasing, s.
        measurement: (T, m), or (B, T, m) of B logs, in the units of the sensor's channels (angles
            in rad); NaN where nothing arrived.
        R: (m, m) covariance of their noise, diagonal, or (m,) variances.
        mean, P: (n,), or (B, n), and (n, n) or (n,) variances, of the state at the first time.
        inputs, sensor_inputs: (T, p), (T, k), or with B in front; those of the motion at an index
            for the step that leads there.
        truth: (T, n) or (B, T, n), where it is known.

    Raises:
        ValueError: if shapes or values do not fit, in one sentence.
    """
    z = np.asarray(measurement, np.float64)
    z = z[None] if z.ndim == 2 else z
    batch, steps = z.shape[:2]
    start = np.atleast_1d(np.asarray(mean, np.float64))
    start = np.broadcast_to(start, (batch, start.shape[-1]))
    factor = positive_definite_factor("P", P, start.shape[1])
    series = (
        None if given is None else np.broadcast_to(given, (batch, steps, np.shape(given)[-1]))
        for given in (inputs, sensor_inputs, truth)
    )
    u, s, x = series
    none = np.empty((batch, steps, 0))
    return Recording(
        time=np.asarray(time, np.float64),
        measurement=z,
        noise=np.broadcast_to(deviations("R", R, z.shape[2]), z.shape),
        mean=start,
        factor=np.broadcast_to(factor, (batch, *factor.shape)),
        motion_inputs=none if u is None else u,
        sensor_inputs=none if s is None else s,
        truth=x,
    )


def _drive(rng: Generator, time: Array) -> Array:
    """The example's speed and turn rate: legs of some seconds, turned to either side."""
    legs = (time // rng.uniform(2.0, 5.0)).astype(int)
    turns = rng.uniform(-TURN, TURN, legs[-1] + 1)
    return np.column_stack((np.full(len(time), SPEED), turns[legs]))
