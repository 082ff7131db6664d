"""What an agent may be tuned on: its error, or what measurements alone tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.options import Options
from kfenv.envs.rewards import CAP, LABEL_FREE, LIKELIHOOD
from kfenv.filters.protocol import Knobs, Measurement, Status
from kfenv.filters.results import OK, Prediction, Update
from kfenv.models.model import Sensor
from kfenv.models.namespaces import batch
from kfenv.scenarios.recording import Recording

from ..contestants.agent import Agent, Contestant, RecordingFilter
from ..contestants.registry import make_agent
from .rollout import make_core, play, rollout, scenario_and_options

Array = NDArray[np.float64]

ERROR, AXES, WITHHELD = "error", "axes", "withheld"
COSTS = (ERROR, *LABEL_FREE, WITHHELD, AXES)

# Of so many measurements the last few are kept from the filter, which foresees them one by one.
PERIOD, KEPT = 12, 3
WORST = 7.0  # cost of a measurement missed by a thousand deviations, or by a filter that failed


def costs(
    on: str, contestant: Contestant, env_id: str, env_kwargs: dict[str, Any],
    recording: Recording, seed: int,
) -> Array:  # fmt: skip
    """What tuning makes small, of each episode (N,).

    * ``"error"``: log of the position RMSE, m, which needs the truth.
    * ``"axes"``: mean of the horizontal and the vertical mean square error, each over the fixed
      filter's on all episodes, so that none is bought by the other.
    * ``"likelihood"``: minus the mean log-likelihood, over the nominal filter's and per channel
      that arrived, of the next innovation with the knobs held: the reward of that name, uncapped.
    * ``"consistency"``: minus the mean reward of that name; see an environment's page.
    * ``"withheld"``: of every twelve measurements the filter misses the last three; mean over
      channel groups of log(1 + e^2) / 2, e being what it foresees of them less what was
      measured, in told deviations. The logarithm bears outliers.

    Raises:
        ValueError: if an episode has no truth, or the contestant does not suit `on`.
    """
    if on == ERROR:
        return np.log(rollout(contestant, env_id, env_kwargs, recording, seed).rmse)
    scenario, options = scenario_and_options(env_id, env_kwargs)
    if on == AXES:
        square = _of_both_axes(contestant, env_id, env_kwargs, recording, seed)
        nominal = _of_both_axes(make_agent("fixed"), env_id, env_kwargs, recording, seed)
        return np.mean(square / nominal.mean(axis=0), axis=1)
    contestant = contestant.suited_to(scenario)
    if on == WITHHELD:
        return _withheld(contestant, scenario, options, recording, seed)
    if not isinstance(contestant, Agent):
        raise ValueError(
            f"{contestant.name} turns no knobs, so the environment's reward {on!r} does not "
            f"concern it: tune it on {ERROR!r} or {WITHHELD!r}."
        )
    core = make_core(contestant, scenario, options, recording, on)
    return _unforeseen(contestant, core, recording, seed)


def _unforeseen(agent: Agent, core: Core, recording: Recording, seed: int) -> Array:
    """Minus the mean gain in likelihood, or reward; a lost track costs what rewards ask besides."""
    gained, arrived, lost = np.zeros(core.batch), np.zeros(core.batch), np.zeros(core.batch, bool)
    for reward, gone in play(agent, core, recording, seed):
        lost |= gone
        if core.options.reward == LIKELIHOOD:
            gained, arrived = gained + core.foresight.gained, arrived + core.foresight.arrived
        else:
            gained, arrived = gained + np.where(gone, 0.0, reward), arrived + ~lost
    mean = gained / np.maximum(arrived, 1.0)
    return np.where(lost, CAP + np.maximum(-mean, 0.0), -mean)


def _of_both_axes(
    contestant: Contestant, env_id: str, env_kwargs: dict[str, Any], recording: Recording,
    seed: int,
) -> Array:  # fmt: skip
    """Horizontal and vertical mean squares (N, 2) over the decisions whose error is known.

    A lost track is as far off both ways.
    """
    scenario, _ = scenario_and_options(env_id, env_kwargs)
    if scenario.yardstick.name != "position":
        raise ValueError(
            f"{scenario.name} is scored by its {scenario.yardstick.name}, which has no horizontal "
            f"and vertical: tune on {ERROR!r} instead of {AXES!r}."
        )
    scores = rollout(contestant, env_id, env_kwargs, recording, seed, trace=True)
    assert recording.truth is not None and scores.off is not None and scores.error is not None
    middle = recording.truth[:, recording.truth.shape[1] // 2, list(scenario.motion.position)]
    frames = np.array([scenario.local_frame(place)[1] for place in middle])
    local = np.einsum("nij,dnj->dni", frames, scores.off)
    square = np.stack([np.sum(local[..., :2] ** 2, axis=-1), local[..., 2] ** 2], axis=-1)
    known, far = ~np.isnan(scores.error)[..., None], scenario.lost_distance**2
    square = np.where(known & np.isfinite(square), np.minimum(square, far), 0.0)
    mean = np.sum(square, axis=0) / np.maximum(np.sum(known, axis=0), 1)
    return np.where(scores.lost[:, None], far, mean)


# ----- withheld measurements ------------------------------------------------------------------


def withhold(recording: Recording) -> tuple[Recording, Array]:
    """The recording as the filter meets it, and what is kept from it (B, T, m), NaN elsewhere."""
    arrived = ~np.isnan(recording.measurement)
    number = np.cumsum(arrived.any(axis=2), axis=1) - 1
    kept = (number % PERIOD >= PERIOD - KEPT)[..., None] & arrived
    missing = np.where(kept, np.nan, recording.measurement)
    return replace(recording, measurement=missing), np.where(kept, recording.measurement, np.nan)


def foreseen_costs(sensor: Sensor, recording: Recording, kept: Array, mean: Array) -> Array:
    """Costs (B,) of predicted states (B, T, n) where measurements (B, T, m) were withheld."""
    off = (kept - measured(sensor, mean, recording.sensor_inputs)) / recording.noise
    for c, channel in enumerate(sensor.channels):
        if channel.angle:
            off[..., c] = _wrapped(off[..., c] * recording.noise[..., c])
            off[..., c] /= recording.noise[..., c]
    missed = ~np.isnan(kept)
    with np.errstate(over="ignore"):
        cost = 0.5 * np.log1p(np.where(np.isnan(off), np.inf, off) ** 2)
    cost = np.where(missed, np.minimum(cost, WORST), 0.0).sum(axis=1)
    membership = np.eye(len(sensor.groups))[np.array(sensor.group_of_channel)]
    total, count = cost @ membership, missed.sum(axis=1) @ membership
    share = np.where(count > 0.0, total / np.maximum(count, 1.0), 0.0)
    return share.sum(axis=1) / np.maximum((count > 0.0).sum(axis=1), 1)


def measured(sensor: Sensor, mean: Array, inputs: Array) -> Array:
    """What the sensor would measure (..., m) of states (..., n) with known inputs (..., k)."""
    states, known = (tuple(np.moveaxis(array, -1, 0)) for array in (mean, inputs))
    with np.errstate(all="ignore"):  # of states that are none
        return np.stack(sensor.build(batch)(states, known), axis=-1)


def _wrapped(angle: Array) -> Array:
    return np.arctan2(np.sin(angle), np.cos(angle))


def _withheld(
    contestant: Contestant, scenario: Any, options: Options, recording: Recording, seed: int
) -> Array:
    met, kept = withhold(recording)
    if isinstance(contestant, RecordingFilter):
        told = replace(met, truth=None, true_noise=None, true_bias=None, faults=())
        mean = contestant.filter(scenario, options, told).mean  # nothing arrived: predicted
    else:
        assert isinstance(contestant, Agent)
        core = make_core(contestant, scenario, options, met, "rmse")
        core.filter = looked = _Looked(core)
        for _ in play(contestant, core, met, seed):
            pass
        mean = looked.mean
    return foreseen_costs(scenario.sensor, recording, kept, mean)


class _Looked:
    """A core's filter that keeps what it predicts (B, T, n)."""

    def __init__(self, core: Core) -> None:
        self.filter, self.core = core.filter, core
        self.predict, self.update = self.filter.predict, self.filter.update
        shape = (core.batch, core.time.shape[-1], len(core.scenario.motion.states))
        self.mean = np.full(shape, np.nan)
        self.run: Callable = self.filter.run

    def innovate(
        self, prediction: Prediction, knobs: Knobs, measurement: Measurement, status: Status
    ) -> Update:
        """As the filter's."""
        result = self.filter.innovate(prediction, knobs, measurement, status)
        sound = np.flatnonzero(status == OK)
        self.mean[sound, self.core.index[sound]] = prediction.mean[sound]
        return result
