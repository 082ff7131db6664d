"""An aircraft located by GNSS pseudoranges and their rates under faults (SPEC 3.4, 4.3, 7.1 E4)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime, timedelta
from functools import cached_property
from os import PathLike
from typing import ClassVar

import numpy as np
import pymap3d
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.gnss.almanac import baseline_constellation, read_yuma
from kfenv.models.gnss.atmosphere import WET_DELAY, WET_DENSITY, klobuchar, troposphere
from kfenv.models.gnss.clock import with_clock
from kfenv.models.gnss.orbits import (
    GPS_EPOCH,
    Constellation,
    earth_fixed,
    geodetic,
    gps_seconds,
    look_angles,
)
from kfenv.models.gnss.pseudorange import CHANNELS, pseudoranges
from kfenv.models.gnss.receiver import CLOCK_OFFSET, RATE_NOISE, range_deviation
from kfenv.models.markov_acceleration import markov_acceleration
from kfenv.models.model import Motion, Sensor
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios import tracks
from kfenv.scenarios.draws import normal
from kfenv.scenarios.faults import Fault, Jamming
from kfenv.scenarios.gnss.clocks import CLOCK_DENSITY, DRIFT_DEVIATION, clocks
from kfenv.scenarios.gnss.faults import (
    GNSS_FAULTS,
    ClockDegradation,
    GnssDraft,
    MultipathBurst,
    PllFailure,
    RangeRamp,
    RangeStep,
    ReceiverMisreport,
)
from kfenv.scenarios.gnss.log import GnssLog
from kfenv.scenarios.gnss.reading import log_of
from kfenv.scenarios.gnss.satellite_channels import assign_channels, by_channel
from kfenv.scenarios.recording import Recording, Whole
from kfenv.scenarios.scenario import TrackingScenario
from kfenv.scenarios.tracks import LONGEST_GAP, SmoothTrack, check_track, from_radar
from kfenv.scenarios.trajectories import MAX_DURATION, paper_trajectory, random_trajectories

Array = NDArray[np.float64]

DURATION, PAPER_DURATION, LOG_DURATION = 120.0, 250.0, 300.0  # s, unless told
PAPER_TIME = timedelta(hours=5)  # of the day, ours: six satellites above 10 deg for 250 s
# Broadcast ionosphere of a published worked example (seconds per semicircle^n).
ALPHA, BETA = (3.82e-8, 1.49e-8, -1.79e-7, 0.0), (1.43e5, 0.0, -3.28e5, 1.13e5)
UNSEEN = np.pi / 2.0  # elevation told where a channel has no satellite
HEIGHTS = (-1000.0, 20_000.0)  # m, that a place may have
DAY = r"\d{4}-\d\d-\d\d"
INSTANT = DAY + r"[T ]\d\d:\d\d(:\d\d(\.\d+)?)?"


@dataclass(frozen=True)
class GnssTracking(TrackingScenario):
    """The scenario of ``kfenv/GnssTracking-v0``; see its page for the fields.

    The state is in the earth-fixed frame, in which the velocities of the satellites are
    given too. A channel follows one satellite for as long as it is visible (see
    `kfenv.scenarios.gnss.satellite_channels`).

    Attributes:
        measurement_rate: measurements per second; `rate` is a multiple of it.
        place: latitude and longitude (deg) and height (m) of the flights' origin.
        date: the day, or the instant at which each episode begins (GPS time).
        almanac: path of a YUMA file; None for the baseline constellation.
        mask: elevation above which satellites are used, deg.
        ionosphere: share of the ionospheric delay that the corrections leave.
        troposphere: share of the standard tropospheric delay that they leave.
        track: path of a real flight's CSV file, flown at its own place.
        cutoff, longest_gap: how it is smoothed, see `kfenv.scenarios.tracks.smooth_track`.
        rinex: paths of a real log's observation and navigation file, and of its truth if the
            receiver moved, in place of all that is simulated. The log sets `rate`.
        moving: whether the receiver of a real log, or of a recording, is a vehicle's.
        manoeuvre: its acceleration's deviation, m/s^2, and time constant, s.
    """

    duration: float | None = None
    rate: float = 10.0
    faults: str | Mapping[str, Mapping[str, object]] | Sequence[Fault] = "random"
    measurement_rate: float = 1.0
    place: tuple[float, float, float] = (45.2, 7.6, 0.0)
    date: str = "2016-02-29"
    almanac: str | None = None
    mask: float = 10.0
    ionosphere: float = 0.0
    troposphere: float = 0.0
    track: str | None = None
    cutoff: float | None = None
    longest_gap: float = LONGEST_GAP
    rinex: Sequence[str] | None = None
    moving: bool = False
    manoeuvre: tuple[float, float] = (1.5, 10.0)

    name: ClassVar[str] = "GnssTracking"
    known_faults: ClassVar[Mapping[str, type]] = GNSS_FAULTS
    presets: ClassVar[Mapping[str, tuple[Fault, ...]]] = {
        "random": (
            Jamming(bursts=(0, 2)), ClockDegradation(), PllFailure(), RangeStep(), RangeRamp(),
            MultipathBurst(), ReceiverMisreport(),
        ),
        "paper": (
            ClockDegradation(duration=(30.0, 30.0), range_error=(150.0, 150.0), start=70.0),
            PllFailure(duration=(15.0, 15.0), start=150.0),
        ),
        "none": (),
    }  # fmt: skip
    initial_deviation: ClassVar[tuple[float, ...]] = (50.0, 20.0, 3.0)
    error_scale: ClassVar[float] = 10.0

    def __post_init__(self) -> None:
        if not isinstance(self.moving, bool):
            raise ValueError(f"moving must be True or False, got {self.moving!r}.")
        if self.duration is None:
            duration = PAPER_DURATION if self.faults == "paper" else DURATION
            duration = duration if self.rinex is None else LOG_DURATION
            object.__setattr__(self, "duration", duration)
        if self.log is not None:
            self._take_rate()
        super().__post_init__()
        if self.log is not None:
            self._check_log()
            return
        self._check_measurement_rate()
        self._check_place()
        if self.almanac is not None and not isinstance(self.almanac, str | PathLike):
            raise ValueError(f"almanac must be the path of a YUMA file, got {self.almanac!r}.")
        _ = _parsed(self.date), self._constellation  # complain
        if not is_number(self.mask) or not 0.0 <= self.mask < 90.0:
            raise ValueError(
                f"mask must be an elevation in degrees from 0 to below 90, got {self.mask!r}."
            )
        for name in ("ionosphere", "troposphere"):
            share = getattr(self, name)
            if not is_number(share) or not -1.0 <= share <= 1.0:
                raise ValueError(
                    f"{name} must be the share of the delay that is left, a number between -1 "
                    f"and 1, got {share!r}."
                )
        self._check_flight()

    def _take_rate(self) -> None:
        """Take the log's steps per second in place of the default."""
        rate = 1.0 / self.log.step
        if self.rate not in (rate, type(self).rate):
            raise ValueError(
                f"rate is the log's, {rate:g} per second: leave it out with rinex, got "
                f"{self.rate!r}."
            )
        object.__setattr__(self, "rate", rate)

    def _check_measurement_rate(self) -> None:
        right = is_number(self.measurement_rate) and self.measurement_rate > 0.0
        every = self.rate / self.measurement_rate if right else 0.0
        if not 1.0 <= every < np.inf or abs(every - round(every)) > 1e-9:
            raise ValueError(
                f"measurement_rate must divide rate = {self.rate:g} (filter steps per second), "
                f"got {self.measurement_rate!r}."
            )

    def _check_place(self) -> None:
        place = self.place
        right = isinstance(place, Sequence) and not isinstance(place, str) and len(place) == 3
        right = right and all(is_number(value) for value in place)
        bounds = ((-90.0, 90.0), (-360.0, 360.0), HEIGHTS)
        if not (
            right and all(low <= x <= high for x, (low, high) in zip(place, bounds, strict=True))
        ):
            raise ValueError(
                "place must be (latitude, longitude, height), within 90 and 360 degrees and "
                f"between {HEIGHTS[0]:g} and {HEIGHTS[1]:g} m, got {place!r}."
            )

    def _check_log(self) -> None:
        for item in fields(self):
            simulated = item.name not in ("duration", "rate", "rinex", "moving", "manoeuvre")
            if simulated and getattr(self, item.name) != item.default:
                raise ValueError(f"{item.name} is for simulated episodes: leave it out with rinex.")
        self.log.random_starts([], self.duration, "tuning")  # complains
        _ = self.motion  # complains

    def _check_flight(self) -> None:
        check_track(self, ("cutoff", "longest_gap"))
        if self.track is not None:
            self._flight.random_start(np.random.default_rng(0), self.duration)  # complains
        elif self.faults != "paper" and self.duration > MAX_DURATION:
            raise ValueError(
                f"A random flight lasts at most {MAX_DURATION:g} s, got duration="
                f"{self.duration!r}: run more episodes instead."
            )

    @cached_property
    def motion(self) -> Motion:
        """Variable turn, white jerk of 1 m^2/s^5, and a clock of 0.1 (m/s)^2/s.

        Of a real log constant acceleration for a receiver at rest, which has no turn rate, and
        for one that moves an acceleration that comes and goes.
        """
        if self.moving or (self.log is not None and self.log.moving):
            moves = markov_acceleration(*self._manoeuvre())
        else:
            moves = variable_turn(1.0) if self.rinex is None else constant_acceleration(1.0)
        return with_clock(moves, CLOCK_DENSITY)

    def _manoeuvre(self) -> Sequence[float]:
        pair = self.manoeuvre
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise ValueError(
                "manoeuvre must be an acceleration's deviation (m/s^2) and time constant (s), got "
                f"{pair!r}."
            )
        return pair

    @cached_property
    def sensor(self) -> Sensor:
        """Twelve pseudoranges and their rates."""
        return pseudoranges()

    @property
    def steps_per_measurement(self) -> int:
        """Filter steps from one measurement to the next, or between a log's epochs."""
        if self.log is not None:
            return self.log.steps_per_epoch
        return round(self.rate / self.measurement_rate)

    @property
    def initial_deviations(self) -> Array:
        """Position, velocity and acceleration along each axis, clock bias and drift."""
        return np.array([*self.initial_deviation * 3, round(CLOCK_OFFSET), DRIFT_DEVIATION])

    @cached_property
    def log(self) -> GnssLog | None:
        """The real log, if there is one."""
        return None if self.rinex is None else log_of(self.rinex, self.moving)

    def sample(self, rngs: Sequence[Generator]) -> Recording:
        """Draw one episode from each generator: of a log, a window of its first part."""
        if self.log is None:
            return super().sample(rngs)
        starts = self.log.random_starts(rngs, self.duration, "tuning")
        return self.log.recording(starts, self.duration)

    def recorded(self, split: str, episodes: int) -> Recording | None:
        """The windows of a log that are kept for validation or test, None for other episodes.

        Raises:
            ValueError: if the log is too short for two of them.
        """
        if self.log is None or split == "tuning":
            return None
        return self.log.recording(self.log.starts(self.duration, split)[:episodes], self.duration)

    def whole(self, after: float | None = None) -> Whole | None:
        """All epochs of a log from the first that tells a state."""
        return None if self.log is None else self.log.whole(after)

    def geodetic(self, position: Array) -> Array:
        """From the earth-fixed frame."""
        return np.stack(pymap3d.ecef2geodetic(*position.T), axis=-1)

    @cached_property
    def _constellation(self) -> Constellation:
        if self.almanac is None:
            return baseline_constellation()
        return read_yuma(self.almanac, near=_parsed(self.date)).usable()

    @property
    def _flight(self) -> SmoothTrack:
        """The smoothed flight in the track file."""
        return tracks.flight(self.track, self.cutoff, self.longest_gap)

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, 11): our trajectory B in the papers' case, the track, or random flights."""
        place = self.place
        if self.track is not None:
            flight, place = self._flight, self._flight.origin
            starts = (flight.random_start(rng, self.duration) for rng in rngs)
            local = np.stack([from_radar(flight, place, start + self.time) for start in starts])
        elif self.faults == "paper":
            local = np.tile(paper_trajectory("B", self.time), (len(rngs), 1, 1))
        else:
            local = random_trajectories(rngs, self.time)
        clock = clocks(rngs, self.time.size, 1.0 / self.rate)
        return np.concatenate([earth_fixed(local, place), clock], axis=-1)

    def drafts(self, truth: Array, rngs: Sequence[Generator]) -> GnssDraft:
        """The clean episodes: satellites in view, and the delays that the corrections leave."""
        measured = slice(None, None, self.steps_per_measurement)
        time = np.stack([self._first_instant(rng) + self.time[measured] for rng in rngs])
        receiver = truth[:, measured, list(self.motion.position)]
        position, velocity = self._constellation.seen_from(receiver, time)
        elevation, azimuth = look_angles(receiver, position)
        visible = elevation > np.radians(self.mask)
        channel = np.stack(list(map(assign_channels, visible, elevation)))
        delay = self._delay(receiver, elevation, azimuth, time, rngs)
        satellite = np.full((*truth.shape[:2], CHANNELS), -1)
        seen_at = np.full(satellite.shape, UNSEEN)
        satellite[:, measured] = channel
        seen_at[:, measured] = by_channel(elevation, channel, UNSEEN)
        inputs = np.zeros((*truth.shape[:2], 6 * CHANNELS))
        states = by_channel(np.concatenate([position, velocity], axis=-1), channel, 0.0)
        inputs[:, measured] = states.reshape(*time.shape, -1)
        told = {"sensor_inputs": inputs, "satellite": satellite, "elevation": seen_at}
        draft = self.clean(GnssDraft, truth, **told)
        draft.exact[:, measured, :CHANNELS] += by_channel(delay, channel, 0.0)
        draft.available &= np.tile(satellite >= 0, 2)
        return draft

    def _first_instant(self, rng: Generator) -> float:
        """GPS time at which an episode begins: drawn from the day, unless it is told."""
        drawn = rng.uniform(0.0, 86_400.0)
        if not _is_day(self.date):
            drawn = 0.0
        elif self.faults == "paper":
            drawn = PAPER_TIME.total_seconds()
        return gps_seconds(_parsed(self.date)) + drawn

    def _delay(
        self, receiver: Array, elevation: Array, azimuth: Array, time: Array,
        rngs: Sequence[Generator],
    ) -> Array:  # fmt: skip
        """What is left (B, E, K) of the atmosphere once the standard delays are taken off.

        The wet delay of the truth walks away from the standard one. The standard delay is
        that of the receiver's true place: that of an estimate 10 m off in height differs by
        15 mm at 10 deg of elevation.
        """
        latitude, longitude, height = (value[..., None] for value in geodetic(receiver))
        above = np.maximum(elevation, np.radians(3.0))  # lower ones are not used
        path = above, latitude, height, _parsed(self.date).timetuple().tm_yday
        walk = np.sqrt(WET_DENSITY / self.measurement_rate) * normal(rngs, time.shape[1:])
        delay = troposphere(*path, WET_DELAY + np.cumsum(walk, axis=1)[..., None])
        delay -= (1.0 - self.troposphere) * troposphere(*path)
        if self.ionosphere:
            delay += self.ionosphere * klobuchar(
                ALPHA, BETA, latitude, longitude, above, azimuth, time[..., None]
            )
        return delay

    def deviations(self, draft: GnssDraft) -> tuple[Array, Array]:
        """Code noise, multipath and troposphere by elevation, and the rates' constant."""
        measured = ..., slice(None, None, self.steps_per_measurement), slice(None)
        both = np.empty((*draft.elevation.shape[:-1], 2 * CHANNELS))
        both[:] = np.repeat([range_deviation(UNSEEN), RATE_NOISE], CHANNELS)
        both[..., :CHANNELS][measured] = range_deviation(draft.elevation[measured])
        return both, both

    def local_frame(self, position: Array) -> tuple[Array, Array]:
        """Origin (3,) and rotation (3, 3) from earth-fixed to east, north, up about a position."""
        latitude, longitude, _ = geodetic(position)
        return position, np.array(pymap3d.uvw2enu(*np.eye(3), latitude, longitude, deg=False))


def _is_day(date: str) -> bool:
    return re.fullmatch(DAY, date) is not None


def _parsed(date: str) -> datetime:
    """The date.

    Raises:
        ValueError: if it is none, or before GPS began.
    """
    written = isinstance(date, str) and re.fullmatch(f"{DAY}|{INSTANT}", date)
    try:
        parsed = datetime.fromisoformat(date) if written else None
    except ValueError:
        parsed = None
    if parsed is None or parsed < GPS_EPOCH.replace(tzinfo=None):
        raise ValueError(
            "date must be a day since 1980-01-06 like '2016-02-29', or an instant in GPS time "
            f"like '2016-02-29T05:00', got {date!r}."
        )
    return parsed
