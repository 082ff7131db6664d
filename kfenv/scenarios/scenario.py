"""What every scenario shares: arguments and their checks, faults, episodes drawn together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch
from kfenv.models.yardstick import Yardstick
from kfenv.scenarios.draft import Draft, split
from kfenv.scenarios.draws import normal
from kfenv.scenarios.faults import FAULTS, Fault, apply_all, resolve_faults
from kfenv.scenarios.recording import Recording, Whole, stack

Array = NDArray[np.float64]

MAX_RATE = 100.0  # Hz
MIN_RATE = 1.0  # Hz: the motion models take steps of up to a second
MOST_INSTANTS = 1_000_000  # of an episode, which is held whole
# Instants drawn together: more would not stay in a processor's cache
AT_ONCE = 20_000
LEAST_AT_ONCE = 4  # episodes

# Once glibc has freed an array of almost 32 MiB, it keeps twice as much of what is freed later.
# Otherwise it gives back what episodes were drawn in, and asks for it anew page by page.
np.empty(2**22 - 2**12)

TOGETHER = {"trajectory": "trajectories(rngs)", "draft": "drafts(truth, rngs)"}


@dataclass(frozen=True)
class TrackingScenario(ABC):
    """A target, the sensor that sees it, and what the filter is told.

    A subclass gives the class variables, `motion`, `sensor`, `trajectories` and
    `deviations`; `drafts` where faults act on more than noise and arrival. A scenario
    whose instants have no measurement (a filter that predicts more often than it
    updates) clears `Draft.available` there.

    Attributes:
        duration: of an episode, s.
        rate: filter steps per second.
        faults: what spoils an episode, see `resolve_faults`.
        name: what it is called.
        known_faults, presets: faults and sets of them that have names.
        initial_deviation: of the initial estimate's position, velocity and acceleration
            along each axis, m, m/s, m/s^2.
        circular: channels that are angles all around and so kept within (-pi, pi].
        error_scale: what errors are measured by in rewards and observations, m.
        lost_distance: a greater position error is a lost track, m.
        mixture: share of outliers in the measurements and ratio of their variance to the
            nominal one, where the scenario has any to tell a Gaussian sum.
        rate_bounds: between which the rate lies, 1/s.

    Raises:
        ValueError: for an argument that is none, or an unknown fault.
    """

    duration: float
    rate: float
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault]

    name: ClassVar[str]
    known_faults: ClassVar[Mapping[str, type]] = FAULTS
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {"none": ()}
    initial_deviation: ClassVar[tuple[float, ...]]
    circular: ClassVar[tuple[int, ...]] = ()
    error_scale: ClassVar[float]
    lost_distance: ClassVar[float] = 10_000.0  # SPEC 7.1
    mixture: ClassVar[tuple[float, float] | None] = None
    rate_bounds: ClassVar[tuple[float, float]] = (MIN_RATE, MAX_RATE)

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for one, all_of_them in TOGETHER.items():
            if one in vars(cls):
                raise TypeError(
                    f"{cls.__name__} defines {one}, but episodes are drawn together: define "
                    f"{all_of_them}, with the episodes in front."
                )

    def __post_init__(self) -> None:
        least, most = self.rate_bounds
        if not is_number(self.rate) or not least <= self.rate <= most:
            raise ValueError(
                f"rate must lie between {least:g} and {most:g} per second, got {self.rate!r}."
            )
        if not is_number(self.duration) or self.duration < 1.0 / self.rate:
            raise ValueError(
                "duration must be a number of seconds, at least one step of "
                f"{1.0 / self.rate:g} s, got {self.duration!r}."
            )
        instants = self.duration * self.rate
        if instants > MOST_INSTANTS:
            raise ValueError(
                f"duration={self.duration!r} at rate={self.rate:g} makes {instants:.2g} instants, "
                f"and an episode has at most {MOST_INSTANTS:,}: shorten it."
            )
        resolve_faults(self.faults, self.presets, self.known_faults)  # complains

    def __reduce__(self):
        # Without what is derived: compiled and local functions cannot be pickled.
        return type(self), tuple(getattr(self, item.name) for item in fields(self))

    @property
    @abstractmethod
    def motion(self) -> Motion:
        """What the filter believes about the target's motion."""

    @property
    @abstractmethod
    def sensor(self) -> Sensor:
        """What is measured."""

    @cached_property
    def yardstick(self) -> Yardstick:
        """What errors are measured of: the position."""
        return Yardstick.position(self.motion)

    @cached_property
    def time(self) -> Array:
        """The instants of an episode, s."""
        return np.arange(round(self.duration * self.rate) + 1) / self.rate

    @property
    def dimensions(self) -> tuple[int, int]:
        """Number of motion inputs and of sensor inputs."""
        return len(self.motion.inputs), len(self.sensor.inputs)

    @property
    def longest_step(self) -> float:
        """The longest that the motion model takes, s, with room for rounding."""
        return (1.0 + 1e-6) / self.rate_bounds[0]

    @property
    def steps_per_measurement(self) -> int:
        """Filter steps from one measurement to the next, faults aside."""
        return 1

    @cached_property
    def initial_deviations(self) -> Array:
        """Standard deviations (n,) of the initial estimate."""
        return np.tile(self.initial_deviation, 3)

    @cached_property
    def initial_factor(self) -> Array:
        """Lower factor (n, n) of the initial estimate's covariance."""
        return np.diag(self.initial_deviations)

    def sample(self, rngs: Sequence[Generator]) -> Recording:
        """Draw one episode from each generator."""
        many = self.at_once
        return stack([self.episodes(rngs[i : i + many]) for i in range(0, len(rngs), many)])

    @property
    def at_once(self) -> int:
        """How many episodes are drawn together."""
        return max(LEAST_AT_ONCE, AT_ONCE // len(self.time))

    def recorded(self, split: str, episodes: int) -> Recording | None:
        """At most so many episodes of a real log that are kept for a split; None if drawn."""
        return None

    def whole(self, after: float | None = None) -> Whole | None:
        """All of a real log as one episode; None where episodes are drawn.

        Args:
            after: time of the log's clock, s, from which on a filter begins anew; None where it
                cannot.
        """
        return None

    def geodetic(self, position: Array) -> Array | None:
        """Latitude, longitude (deg) and height (m) of positions (T, 3) of the state, as (T, 3).

        None where the state's frame has no place on Earth. A log's frame is that of `whole`.
        """
        return None

    def episode(self, rng: Generator) -> Recording:
        """Draw one episode."""
        return self.episodes([rng])

    def episodes(self, rngs: Sequence[Generator]) -> Recording:
        """Draw episodes together: truth, faults, measurement noise, initial estimate.

        Each generator is asked for the same numbers in the same order as if it were alone.
        """
        truth = self.trajectories(rngs)
        return self.measured(truth, self.drafts(truth, rngs), rngs)

    def measured(self, truth: Array, draft: Draft, rngs: Sequence[Generator]) -> Recording:
        """The episodes of truths (B, T, n) and their clean drafts: faults, noise, estimate."""
        self._spoil_all(draft, rngs)
        true_noise, told_noise = self.deviations(draft)
        true_noise, told_noise = true_noise * draft.noise_factor, told_noise * draft.told_factor
        measurement = self._noisy(draft, true_noise, normal(rngs, true_noise.shape[1:]))
        return Recording(
            time=self.time,
            measurement=measurement,
            noise=told_noise,
            mean=self.initial_means(truth[:, 0], rngs),
            factor=np.tile(self.initial_factor, (len(truth), 1, 1)),
            motion_inputs=draft.motion_inputs,
            sensor_inputs=draft.sensor_inputs,
            truth=truth,
            true_noise=true_noise,
            true_bias=draft.bias,
            faults=tuple(map(tuple, draft.intervals)),
        )

    def _noisy(self, draft: Draft, noise: Array, drawn: Array) -> Array:
        """Measurements (B, T, m) from standard normal numbers; NaN where nothing arrives."""
        every = self.steps_per_measurement
        seen = drawn[:, ::every]
        seen *= noise[:, ::every]
        seen += draft.exact[:, ::every]
        for channel in self.circular:
            angle = seen[..., channel]
            np.arctan2(np.sin(angle), np.cos(angle), out=angle)
        np.copyto(seen, np.nan, where=~draft.available[:, ::every])
        if every == 1:
            return seen
        measurement = np.full(drawn.shape, np.nan)
        measurement[:, ::every] = seen
        return measurement

    @abstractmethod
    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, n) of an episode from each generator."""

    def trajectory(self, rng: Generator) -> Array:
        """Truth (T, n) of one episode."""
        return self.trajectories([rng])[0]

    @abstractmethod
    def deviations(self, draft: Draft) -> tuple[Array, Array]:
        """True and told standard deviations (..., T, m) of the noise, faults' factors aside."""

    def drafts(self, truth: Array, rngs: Sequence[Generator]) -> Draft:
        """The episodes before their faults: exact measurements and, if there are any, inputs.

        Args:
            truth: (B, T, n).
            rngs: of the B episodes.

        Returns:
            The draft of all, whose arrays have the episodes in front.
        """
        return self.clean(Draft, truth)

    def draft(self, truth: Array, rng: Generator) -> Draft:
        """One episode before its faults, of the truth (T, n)."""
        return next(self.drafts(truth[None], [rng]).episodes())

    def _spoil_all(self, draft: Draft, rngs: Sequence[Generator]) -> None:
        if type(self).spoil is TrackingScenario.spoil:
            apply_all(self._faults, draft, rngs)
            return
        for one, rng in zip(draft.episodes(), rngs, strict=True):
            self.spoil(one, rng)

    def spoil(self, draft: Draft, rng: Generator) -> None:
        """Apply the faults in turn to one episode; a subclass may do something else."""
        for fault in self._faults:
            fault.apply(draft, rng)

    @cached_property
    def _faults(self) -> tuple[Fault, ...]:
        return resolve_faults(self.faults, self.presets, self.known_faults)

    def initial_means(self, start: Array, rngs: Sequence[Generator]) -> Array:
        """Initial estimates (B, n), drawn about the truths (B, n) at the first instant."""
        return start + self.initial_deviations * normal(rngs, start.shape[1:])

    def local_frame(self, position: Array) -> tuple[Array, Array]:
        """Where pictures are drawn: p becomes rotation (p - origin), east, north, up.

        Here the states are in such a frame already.

        Args:
            position: (3,) in the state's frame, the middle of what is to be seen.

        Returns:
            Origin (3,) and rotation (3, 3).
        """
        return np.zeros(len(position)), np.eye(len(position))

    def clean(
        self, kind: type[Draft], truth: Array, motion_inputs: Array | None = None,
        sensor_inputs: Array | None = None, **more: object,
    ) -> Draft:  # fmt: skip
        """A draft of that kind whose exact measurements are the sensor's of the truth.

        Between the instants of measurements they are zero.

        Args:
            kind: `Draft`, or a class derived from it that takes `more`.
            truth: (..., T, n).
            motion_inputs, sensor_inputs: (..., T, p), (..., T, k), where the models take any.
        """
        none = np.empty((*truth.shape[:-1], 0))
        motion_inputs = none if motion_inputs is None else motion_inputs
        sensor_inputs = none if sensor_inputs is None else sensor_inputs
        measured = ..., slice(None, None, self.steps_per_measurement), slice(None)
        x, s = (split(a[measured]) for a in (truth, sensor_inputs))
        exact = np.zeros((*truth.shape[:-1], len(self.sensor.channels)))
        for values, channel in zip(self._measure(x, s), split(exact[measured]), strict=True):
            channel[...] = values
        return kind.clean(
            self.time, exact.shape[-1], exact=exact, motion_inputs=motion_inputs,
            sensor_inputs=sensor_inputs, **more,
        )  # fmt: skip

    @cached_property
    def _measure(self):
        return self.sensor.build(batch)
