"""The loop that an agent closes: filter, statistics of its innovations, observation, knobs.

It knows neither episodes nor truth nor rewards. Whoever replays recordings (`kfenv.envs.core`) or
hears a sensor hands in what arrives, instant by instant, so both give the same bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.addresses import Addresses
from kfenv.envs import statistics
from kfenv.envs.channels import Channels
from kfenv.envs.knobs import choose_knobs, knobs_of, knobs_of_channels
from kfenv.envs.memory import Memory
from kfenv.envs.options import ENGINE, FULL, GAUSSIAN_SUMS, Options
from kfenv.envs.state_knobs import places_of_states
from kfenv.filters.engine import Engine, InPlace
from kfenv.filters.pointwise import PointwiseFilter
from kfenv.filters.protocol import Filter, Knobs, Measurement, Status
from kfenv.filters.results import OK, Prediction, Update
from kfenv.models.model import Sensor
from kfenv.models.namespaces.lanes import LANES
from kfenv.models.own import is_compilable
from kfenv.models.yardstick import lines_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class _Beside:
    """A filter whose results are copied to where the `Engine` writes them by itself."""

    def __init__(self, filter: Filter) -> None:
        self._filter = filter

    def advance_in_place(
        self, place: InPlace, inputs: Array, dt: Array, measurement: Measurement
    ) -> None:
        """See `Engine`, as for the others."""
        given = place.mean, place.factor, inputs, dt
        self._copy(self._filter.predict, given, place.status, place.prediction)
        self.innovate_in_place(place, measurement)

    def innovate_in_place(self, place: InPlace, measurement: Measurement) -> None:
        given = place.prediction, place.knobs, measurement
        self._copy(self._filter.innovate, given, place.status, place.out)

    def update_in_place(self, place: InPlace, measurement: Measurement, *odds: Array) -> None:
        given = place.prediction, place.knobs, measurement
        self._copy(self._filter.update, given, place.status, place.out, *odds)

    def _copy(self, method, given: tuple, status: Status, out: tuple, *odds: Array) -> None:
        running = status == OK
        for before, after in zip(out, method(*given, status, *odds), strict=True):
            before[running] = after[running]


class Loop:
    """B filters in lock-step whose knobs an agent turns.

    At each instant in turn: `look` at what arrived, `observation`, `turn` the knobs if a decision
    is due, `correct`; then `predict` to the next instant.

    Args:
        scenario: gives motion, sensor and scales.
        options: of the environment.
        batch: B.
        channels: what tells of single channels.
    """

    def __init__(
        self, scenario: Any, options: Options, batch: int, channels: type[Channels] = Channels
    ) -> None:
        self.scenario, self.options, self.batch = scenario, options, batch
        motion, sensor = scenario.motion, scenario.sensor
        self.filter = make_filter(scenario, options, batch)
        self.yardstick = yardstick = scenario.yardstick
        self._lines, self._weight = yardstick.lines(len(motion.states)), yardstick.weight
        places = yardstick.rates
        self._rates = lines_of(places, [place + 1 for place in places], [False] * len(places))
        self._group = np.array(sensor.group_of_channel)
        self.interval = options.decision_interval or scenario.steps_per_measurement
        self._prepare_knobs(sensor, channels)
        n, m = len(motion.states), len(sensor.channels)
        self._prediction = Prediction(np.zeros((batch, n)), *np.zeros((2, batch, n, n)))
        self._pending = _empty_update(batch, n, m)
        self._update = _empty_update(batch, n, m)
        self._nominal, self._knobs = Knobs.nominal(batch), Knobs(*np.ones((2, batch)))
        self._told = np.ones((batch, m))
        self._turned = self._prediction
        if len(self._state_knob):
            self._turned = self._prediction._replace(noise=np.zeros((batch, n, n)))
        self.status, self._work = np.zeros((2, batch), np.int64)
        self._statistics = np.zeros((batch, len(sensor.groups), statistics.COLUMNS))
        self._since = np.zeros(batch)
        self._action = np.zeros((batch, len(self.knobs)))
        self.factors = np.ones((batch, len(self._all_knobs)))
        self.observation_size = len(self.feature_names())
        groups, common = len(sensor.groups), statistics.common_size(yardstick.rates)
        self._common_size = groups * statistics.PER_GROUP + common
        self._note_addresses()

    def _note_addresses(self) -> None:
        """Of what kernels are handed at every instant."""
        pending, status, work = self._pending, self.status, self._work
        state = self._update.mean, self._update.factor
        self._looking = InPlace(*state, self._prediction, self._nominal, pending, work)
        self._correcting = InPlace(*state, self._turned, self._knobs, self._update, work)
        self._turning = Addresses(
            self.factors, self._group_knob, self._channel_knob, self._state_knob,
            self._prediction.noise, status, *self._knobs, self._told, self._turned.noise, work,
        )  # fmt: skip
        self._noticing = Addresses(
            pending.whitened, self._group, self._statistics, self._since, work, status
        )
        self._observing = Addresses(
            pending.whitened, pending.variance, self._lines, pending.factor, self._rates,
            self._weight, self._group, self._statistics, self._since, self._action, status,
        )  # fmt: skip

    def _prepare_knobs(self, sensor: Sensor, channels: type[Channels]) -> None:
        options, names = self.options, [channel.name for channel in sensor.channels]
        motion = self.scenario.motion
        shared = knobs_of(sensor.groups, options.mixture, options.most_fading, motion.groups)
        states, n = places_of_states(motion, sensor.groups), len(motion.states)
        self._state_knob = np.array([states.get(i, -1) for i in range(n)] if states else [], int)
        self._group_knob, self._channel_knob = 2 + self._group, len(shared) + np.arange(len(names))
        self._outlier_knob = len(shared) - 1
        self._all_knobs = (*shared, *knobs_of_channels(names))
        self.knobs = choose_knobs(
            options.actions, sensor.groups, options.mixture, names, options.most_fading,
            motion.groups,
        )  # fmt: skip
        self.knob_place = np.array([self._all_knobs.index(knob) for knob in self.knobs])
        self._log_low = np.log([knob.low for knob in self.knobs])
        self._log_high = np.log([knob.high for knob in self.knobs])
        single = self.knob_place[self.knob_place >= len(shared)] - len(shared)
        self._channels = self._memory = None
        if len(single):
            self._channels = channels(self.scenario, single, self.batch, options.kappa)
        if options.observation == FULL:
            self._memory = Memory(self.scenario, single, self.batch)

    def begin(self, chosen: NDArray[np.int64], mean: Array, factor: Array) -> None:
        """Start anew at the chosen places: initial means (C, n), lower factors (C, n, n).

        What is then looked at is the initial state's measurement, without a prediction.
        """
        for begins_at_zero in (self.status, self._statistics, self._since, self._action):
            begins_at_zero[chosen] = 0
        self._prediction.mean[chosen] = mean
        self._prediction.root[chosen] = factor
        self._prediction.noise[chosen] = 0.0
        self._update.mean[chosen] = mean
        self._update.factor[chosen] = factor
        self._update.nis[chosen] = np.nan
        self._statistics[chosen, :, : len(statistics.WINDOWS)] = 1.0
        if self._channels is not None:
            self._channels.restart(chosen)
        if self._memory is not None:
            self._memory.restart(chosen, mean)
        self.factors[chosen] = 1.0

    def turn(self, action: Array, running: Mask) -> None:
        """Set the knobs by an action (B, K) of the running filters."""
        statistics.turn_knobs(
            action, running, self._log_low, self._log_high, self.knob_place, self.factors,
            self._action,
        )  # fmt: skip

    def correct(self, arrived: Measurement, due: Mask, active: Mask) -> None:
        """Update the active filters by what arrived.

        Args:
            due: (B,) whether the instant is one of the sensor's: fading acts at these alone.
        """
        told = self._turn(arrived, due, active)[2]
        odds = (self.factors[:, self._outlier_knob].copy(),) if self.options.mixture else ()
        self._worker.update_in_place(self._correcting, told, *odds)
        statistics.settle(self._work, active, self.status, self._update.mean, self._update.nis)

    def _turn(
        self, arrived: Measurement, due: Mask, active: Mask
    ) -> tuple[Prediction, Knobs, Measurement]:
        """Prediction, knobs and measurement as the factors make them, and the status to work by."""
        statistics.apply_knobs(self._turning.table, due, arrived.noise, active)
        return self._turned, self._knobs, Measurement(arrived.inputs, arrived.value, self._told)

    @property
    def _worker(self) -> Engine | _Beside:
        """The engine, or whatever filter there is: one may watch that stands in front of it."""
        return self.filter if isinstance(self.filter, Engine) else _Beside(self.filter)

    def foresee(self, arrived: Measurement, due: Mask, status: Status) -> Update:
        """The innovation of what arrived with the last decision's knobs still held.

        Of a Gaussian sum that of its nominal component.

        Args:
            due: as for `correct`.
            status: of the filters, to be set where one fails at this.
        """
        return self.filter.innovate(*self._turn(arrived, due, status == 0), status)

    def advance(self, inputs: Array, arrived: Measurement, dt: Array, active: Mask) -> None:
        """Predict the active filters over dt (B,), and look at what arrived.

        Args:
            inputs: (B, p) of the motion.
            arrived, dt: as for `look`.
        """
        statistics.select(active, self.status, self._work)
        self._worker.advance_in_place(self._looking, inputs, dt, arrived)
        self._notice(arrived, dt, active)

    def look(self, arrived: Measurement, dt: Array, active: Mask) -> None:
        """Form the pending innovation with nominal knobs and take it into the statistics.

        Args:
            dt: (B,) since the instant before, zero at the first one.
        """
        statistics.select(active, self.status, self._work)
        self._worker.innovate_in_place(self._looking, arrived)
        self._notice(arrived, dt, active)

    def _notice(self, arrived: Measurement, dt: Array, active: Mask) -> None:
        statistics.notice(self._noticing.table, dt, active)
        if self._channels is not None:
            self._channels.collect(self._pending, arrived, self._work == 0)
        if self._memory is not None:
            self._memory.collect(self._pending, arrived, dt, self._work == 0)

    def observe(self, noise: Array, passes: Array, pends: Mask) -> NDArray[np.float32]:
        """The observation, a fresh (B, D) array: `features` in single precision."""
        return self.features(noise, passes, pends).astype(np.float32)

    def features(self, noise: Array, passes: Array, pends: Mask) -> Array:
        """What `feature_names` names, a fresh (B, D) array.

        Args:
            noise: (B, m) deviations that the filter is told of what was looked at.
            passes: (B,) seconds from instant to instant: an action holds for `interval` of them.
            pends: (B,) whether what was looked at waits for its update.
        """
        out = np.zeros((self.batch, self.observation_size))
        rows = self.yardstick.matrix(self._pending.mean, self._pending.factor)
        statistics.observe(
            self._observing.table, noise, rows, self.scenario.error_scale, pends, out
        )
        at = self._common_size
        if self._channels is None and self._memory is None:
            return out
        if self._channels is not None:
            told = self._channels.observe(pends)
            out[:, at : at + told.shape[1]] = told
            at += told.shape[1]
        if self._memory is not None:
            held = self.interval * passes
            self._memory.observe(self._pending.mean, held, pends, out[:, at:])
        statistics.complete(self._action, self.status, out)
        return out

    def tell(self, noise: Array, pends: Mask) -> dict[str, Any]:
        """Fresh arrays (B, ...) of the last estimate and of the pending innovation.

        Args:
            noise, pends: as for `observe`.
        """
        innovation, variance = self._pending.innovation.copy(), self._pending.variance.copy()
        statistics.conceal(pends, innovation, variance)
        told: dict[str, Any] = {
            "estimate": self._update.mean.copy(),
            "nis": self._update.nis.copy(),
            "innovation": innovation,
            "innovation_variance": variance,
            "noise": noise.copy(),
        }
        if self._channels is not None:
            told["innovation_covariance"] = pends[:, None, None] * self._channels.covariance
        return told

    @property
    def pending(self) -> Update:
        """What each filter sees of the measurement that it looked at, with nominal knobs."""
        return self._pending

    @property
    def latest(self) -> Update:
        """The last update of each filter."""
        return self._update

    def state(self) -> dict[str, Array]:
        """All that an instant leaves to the next, by name: arrays (B, ...) to be read or set."""
        held = {"mean": self._update.mean, "factor": self._update.factor, "nis": self._update.nis}
        held |= {f"predicted_{k}": array for k, array in self._prediction._asdict().items()}
        held |= {
            "status": self.status, "statistics": self._statistics, "since": self._since,
            "action": self._action, "knobs": self.factors,
        }  # fmt: skip
        for part in (self._channels, self._memory):
            held |= part.state() if part is not None else {}
        return held

    def feature_names(self) -> tuple[str, ...]:
        """What each component of the observation is."""
        groups, yardstick = self.scenario.sensor.groups, self.yardstick
        names = [*statistics.feature_names(groups, yardstick.name, yardstick.rates)]
        for part in (self._channels, self._memory):
            names.extend(part.feature_names() if part is not None else ())
        names.extend(f"previous action: {knob.name}" for knob in self.knobs)
        return tuple(names)


def make_filter(scenario: Any, options: Options, batch: int = LANES) -> Filter:
    """The engine, a Gaussian sum, or a square-root filter of the reference tier by name.

    Models that are NumPy functions, which the engine cannot run, get its equal around NumPy.

    Args:
        batch: of filters; a single one gets an engine of one lane.

    Raises:
        ValueError: for an unknown name or one without a square-root factor.
    """
    motion, sensor = scenario.motion, scenario.sensor
    if options.filter == ENGINE:
        if not (is_compilable(motion) and is_compilable(sensor)):
            return PointwiseFilter(motion, sensor, options.kappa)
        return Engine(motion, sensor, options.kappa, lanes=1 if batch == 1 else LANES)
    from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, build_tier, told_design
    from kfenv.filters.designs import DESIGNS, find_design
    from kfenv.filters.reference import ReferenceFilter

    if options.mixture:
        design = told_design(options.filter, scenario.mixture)
        return build_tier(motion, sensor, design, compiled=True)
    if options.filter in ADAPTIVE_DESIGNS and ADAPTIVE_DESIGNS[options.filter].fading:
        raise ValueError(
            f"The filter {options.filter!r} fades by itself, and here fading is a knob: choose "
            f"one of {', '.join(GAUSSIAN_SUMS)} and let an agent turn it."
        )
    if options.filter in ADAPTIVE_DESIGNS:
        raise ValueError(
            f"The filter {options.filter!r} is a contestant of its own: name it as an agent of "
            "`kfenv evaluate`, or take 'srckf-joseph-exact', whose knobs can be turned."
        )
    if find_design(options.filter).form != "square-root":
        known = [name for name, design in DESIGNS.items() if design.form == "square-root"]
        raise ValueError(
            f"The filter {options.filter!r} carries a covariance, and the knobs need a "
            f"factor: choose one of {', '.join(known)}."
        )
    return ReferenceFilter(motion, sensor, options.filter, kappa=options.kappa)


def _empty_update(batch: int, n: int, m: int) -> Update:
    return Update(
        np.zeros((batch, n)), np.zeros((batch, n, n)), *np.full((3, batch, m), np.nan),
        np.full(batch, np.nan), np.zeros(batch),
    )  # fmt: skip
