"""Steps of a filter and what a policy makes of them, in double precision: for tests elsewhere."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.envs import memory
from kfenv.envs.channels import Channels
from kfenv.envs.loop import Loop
from kfenv.filters.protocol import Measurement, measured
from kfenv.filters.results import Update
from kfenv.models.namespaces import batch
from kfenv.scenarios.recording import Recording

from .deployable import Deployable

Array = NDArray[np.float64]

ONE = np.ones(1, bool)
MOST_STEPS, MOST_NUMBERS = 240, 20_000
WITHHELD = 0.1  # of the channels, so that missing ones are met


class Instant(NamedTuple):
    """What a filter knows before an update, under nominal knobs; see `kfenv_instant` in C."""

    innovation: Array  # (m,), NaN where missing
    covariance: Array  # (m, m) of the innovation
    noise: Array  # (m,) told deviations
    dt: float
    deviation: float
    rate_deviation: float
    distance: float
    rate: Array
    acceleration: Array


class Golden(NamedTuple):
    """Instants in order, the features and the knobs that a policy sets at each."""

    instants: list[Instant]
    observations: list[Array]
    knobs: list[Array]


def golden(deployable: Deployable) -> Golden:
    """The first steps of an episode of the environment, some measurements withheld.

    Features, network and knobs in double precision, so that other arithmetic can be compared.
    """
    network, recording = deployable.policy.network, _episode(deployable)
    loop = Loop(deployable.loop.scenario, deployable.loop.options, 1, ExactChannels)
    times = recording.time
    first = times[1] - times[0]
    loop.begin(np.zeros(1, np.int64), recording.mean, recording.factor)
    start = loop.yardstick.values(recording.mean[0])
    origin = loop.scenario.local_frame(start)[0]
    held, told = np.zeros((1, network.memory_size)), Golden([], [], [])
    for t, dt in enumerate(np.diff(times, prepend=times[0] - first)):
        passed, arrived = np.array([dt if t else 0.0]), measured(recording, t)
        if t:
            loop.advance(recording.motion_inputs[:, t].copy(), arrived, passed, ONE)
        else:
            loop.look(arrived, passed, ONE)
        if t % loop.interval == 0:
            observation = loop.features(arrived.noise, np.array([dt]), ONE)
            action, held = network.decide(observation, held)
            loop.turn(np.clip(action, -1.0, 1.0), ONE)
        if loop.status[0]:
            break
        told.instants.append(_instant(loop, arrived, dt, origin))
        told.observations.append(observation[0])
        told.knobs.append(loop.factors[0, loop.knob_place])
        loop.correct(arrived, np.array([t % loop.scenario.steps_per_measurement == 0]), ONE)
    return told


def _episode(deployable: Deployable) -> Recording:
    """Its beginning, with channels missing here and there."""
    scenario, rng = deployable.loop.scenario, np.random.default_rng(0)
    whole = scenario.sample([rng])
    channels = whole.measurement.shape[2]
    width = channels**2 + 2 * channels + deployable.policy.observation_size
    steps = min(MOST_STEPS, MOST_NUMBERS // width, whole.time.shape[-1])
    measurement = whole.measurement[:, :steps].copy()
    measurement[rng.random(measurement.shape) < WITHHELD] = np.nan
    return Recording(
        whole.times[0, :steps], measurement, whole.noise[:, :steps], whole.mean, whole.factor,
        whole.motion_inputs[:, :steps], whole.sensor_inputs[:, :steps],
    )  # fmt: skip


def _instant(loop: Loop, arrived: Measurement, dt: float, origin: Array) -> Instant:
    yardstick, pending = loop.yardstick, loop.pending
    mean, factor, weight = pending.mean[0], pending.factor[0], yardstick.weight
    rates = list(yardstick.rates)
    rate_weight = weight[: len(rates)]
    turns = memory.accelerations(loop.scenario.motion) if rates else []
    channels, n = loop.scenario.sensor.channels, len(mean)
    covariance = exact_covariance(
        loop.scenario.sensor.build(batch), np.array([channel.angle for channel in channels]),
        np.sqrt(n + loop.options.kappa), pending, arrived,
    )  # fmt: skip
    return Instant(
        pending.innovation[0].copy(), covariance, arrived.noise[0], dt,
        np.linalg.norm(weight[:, None] * yardstick.rows(mean, factor)),
        np.linalg.norm(rate_weight[:, None] * factor[rates]),
        np.linalg.norm(weight * (yardstick.values(mean) - origin)),
        rate_weight * mean[rates], mean[turns],
    )  # fmt: skip


class ExactChannels(Channels):
    """Channels whose innovations have the covariance that a filter tells, curvature included.

    The environments neglect that of a channel with another.
    """

    def covariances(
        self, pending: Update, told: Measurement, missing: NDArray[np.bool_], heard: NDArray
    ) -> Array:
        """See `Channels.covariances`; of a single filter."""
        exact = exact_covariance(self._measure, self._angle, self._spread, pending, told)
        present = ~missing[0]
        return (exact * np.outer(present, present))[None]


def exact_covariance(
    measure: Any, angle: NDArray[np.bool_], spread: float, pending: Update, told: Measurement
) -> Array:
    """The covariance (m, m) of a single filter's pending innovation, by its sigma points.

    Of channels that are missing it tells what it would be.

    Args:
        measure, angle, spread: as for `kfenv.envs.channels.innovation_covariance`.
        pending, told: of one filter.
    """
    mean, factor = pending.mean[0], spread * pending.factor[0]
    n = len(mean)
    points = np.concatenate([mean[:, None], mean[:, None] + factor, mean[:, None] - factor], axis=1)
    weight = np.append(spread**2 - n, np.full(2 * n, 0.5)) / spread**2
    seen = measure(tuple(points), tuple(told.inputs[0]))
    off = np.stack([np.broadcast_to(z, points.shape[1:]) for z in seen])
    off = off - off[:, :1]
    off[angle] = np.arctan2(np.sin(off[angle]), np.cos(off[angle]))
    off = off - (off @ weight)[:, None]
    return (off * weight) @ off.T + np.diag(told.noise[0] ** 2)
