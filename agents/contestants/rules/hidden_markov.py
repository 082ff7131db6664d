"""A hidden Markov model of the noise: the fault model's levels, glint and misreport, told
apart by the innovations of all channels together.

Forward recursion of Rabiner (1989, "A tutorial on hidden Markov models", eq 19 to 21) with
innovation likelihoods N(nu; 0, H P H^T + R). Levels are exact; a channel's misreport and
whether the episode glints are held independent of the level from one step to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, log, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.models.kinematics import ACCELERATION, STATES

from ..agent import Agent, Array, Briefing, Parameter, knob_actions
from ..fault_model import FaultModel, factors

HOPS = 0.2  # from one disturbed level to another, per beginning of one
HARD_TURN = 20.0  # m/s^2
TINY = 1e-300
TWO_PI = 2.0 * pi


class Grid(NamedTuple):
    """A fault model as the compiled recursion takes it; powers counted from the least sum."""

    variance: Array  # (K,) factor of the told variance at each sum of powers
    levels: NDArray[np.int64]  # (L,) powers
    misreport: NDArray[np.int64]  # (M,) powers
    glint: int  # power
    glint_share: float


class Belief(NamedTuple):
    """What is held of B filters; changed in place."""

    level: Array  # (B, L) probabilities
    misreport: Array  # (B, m, M) probabilities of each channel's
    glints: Array  # (B,) probability that the episode has outliers


class HmmNoise(Agent):
    """Measurement noise from a hidden Markov model of the scenario's faults.

    The filter gets R' = 1 / E[1 / (H P H^T + R)] - H P H^T, which has the mean of the
    gains that the levels, glint and misreport call for (CONTEST section 2).
    """

    parameters = (
        Parameter("up", 0.002, 0.5, 0.052),
        Parameter("down", 0.001, 0.5, 0.010),
        Parameter("glint_share", 0.005, 0.5, 0.083),
        Parameter("leak", 1e-6, 1e-2, 1.8e-5),
        Parameter("process_noise", 0.05, 200.0, 9.6),
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        model = FaultModel.of(briefing.scenario).with_glint_share(self.values["glint_share"])
        self._grid = grid(model)
        self._belief = prior(model, briefing.batch, len(briefing.sensor.channels))
        self._time: Array | None = None

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        noise, _ = hear(
            info["innovation"], info["innovation_variance"], info["noise"], self._passed(info),
            self.values["up"], self.values["down"], self.values["leak"], self._grid, self._belief,
        )  # fmt: skip
        return knob_actions(self.briefing, 1.0, self._process_noise(info), noise)

    def _passed(self, info: Mapping[str, Any]) -> Array:
        """Seconds (B,) from the measurement that pended at the last decision to this one's.

        ``time`` is that of the update before, and stands still at the second decision.
        """
        before, self._time = self._time, info["time"]
        if before is None:
            return np.zeros(len(self._time))
        usual = self.briefing.decision_interval / self.briefing.scenario.rate
        return np.where(self._time > before, self._time - before, usual)

    def _process_noise(self, info: Mapping[str, Any]) -> Array | float:
        return self.values["process_noise"]


class HmmTurn(HmmNoise):
    """`HmmNoise`, whose process noise follows the estimated acceleration.

    q (1 + gain s / (1 + s)) with s = |a|^2 / (20 m/s^2)^2 of the last estimate
    (CONTEST section 2). A motion without acceleration among its states keeps q.
    """

    parameters = (
        Parameter("up", 0.002, 0.5, 0.039),
        Parameter("down", 0.001, 0.5, 0.0032),
        Parameter("glint_share", 0.005, 0.5, 0.12),
        Parameter("leak", 1e-6, 1e-2, 7e-5),
        Parameter("process_noise", 0.05, 200.0, 2.6),
        Parameter("turn_gain", 0.1, 1000.0, 9.6),
    )

    def _process_noise(self, info: Mapping[str, Any]) -> Array | float:
        q = self.values["process_noise"]
        if self.briefing.scenario.motion.states[: len(STATES)] != STATES:
            return q
        acceleration = info["estimate"][:, list(ACCELERATION)]
        s = np.nan_to_num(np.sum(acceleration**2, axis=1)) / HARD_TURN**2
        return q * (1.0 + self.values["turn_gain"] * s / (1.0 + s))


def grid(model: FaultModel) -> Grid:
    """The sums of powers that a model knows, from the least to the greatest."""
    glint = model.glint if model.glint_share > 0.0 else 0
    least = min(model.levels) + min(glint, 0) + min(model.misreport)
    most = max(model.levels) + max(glint, 0) + max(model.misreport)
    return Grid(
        factors(np.arange(least, most + 1)) ** 2,
        np.array(model.levels) - least,
        np.array(model.misreport),
        glint,
        model.glint_share,
    )


def prior(model: FaultModel, batch: int, channels: int) -> Belief:
    """Nothing disturbed yet, any misreport, and outliers as often as the model has them."""
    count = len(model.misreport)
    level = np.zeros((batch, len(model.levels)))
    level[:, 0] = 1.0
    return Belief(
        level,
        np.full((batch, channels, count), 1.0 / count),
        np.full(batch, model.glint_chance),
    )


@njit(cache=True, error_model="numpy")
def hear(innovation, variance, told, passed, up, down, leak, grid, belief):
    """Take the pending innovations into the belief.

    Args:
        innovation, variance: (B, m), NaN in channels that did not arrive.
        told: (B, m) deviation of the noise that the filter was told.
        passed: (B,) seconds since the last call.
        up, down: rates of `FaultModel`, 1/s.
        leak: share of a channel's misreport that is forgotten at each arrival.

    Returns:
        (B, m) factors of the told deviation that give the mean gain, NaN where none arrived, and
        (B,) the log-likelihood of the innovations, zero where none arrived.
    """
    batch, channels = innovation.shape
    states, sums = (2 if grid.glint_share > 0.0 else 1, len(grid.levels)), len(grid.variance)
    density, precision = np.empty((channels, sums)), np.empty((channels, sums))
    single, joint = np.empty((channels, *states)), np.empty(states)
    factor, evidence = np.full((batch, channels), np.nan), np.zeros(batch)
    for b in range(batch):
        _move(belief.level[b], passed[b], up, down)
        arrived = False
        for c in range(channels):
            if not np.isnan(innovation[b, c]):
                arrived = True
                told_variance = told[b, c] ** 2
                explained = max(variance[b, c] - told_variance, 0.0)
                for k in range(sums):
                    precision[c, k] = 1.0 / (explained + told_variance * grid.variance[k])
                evidence[b] += _weigh(innovation[b, c], precision[c], density[c])
                _likelihood(density[c], belief.misreport[b, c], grid, single[c])
        if not arrived:
            continue
        evidence[b] += _posterior(
            innovation[b], single, belief.level[b], belief.glints, b, grid, joint
        )
        for c in range(channels):
            if not np.isnan(innovation[b, c]):
                told_variance = told[b, c] ** 2
                mean = _misreported(
                    joint, single[c], density[c], precision[c], leak, grid, belief.misreport[b, c]
                )
                explained = max(variance[b, c] - told_variance, 0.0)
                noise = max(1.0 / mean - explained, 1e-6 * told_variance)
                factor[b, c] = sqrt(noise / told_variance)
    return factor, evidence


@njit(cache=True, error_model="numpy")
def _move(level, passed, up, down):
    """The chain's step: up to any disturbed level, down, or from one of them to another."""
    disturbed = len(level) - 1
    if disturbed == 0:
        return
    rise, fall, hop = 1.0 - exp(-up * passed), 1.0 - exp(-down * passed), 0.0
    if disturbed > 1:
        hop = (1.0 - fall) * (1.0 - exp(-HOPS * up * passed))
    calm, rest = level[0], 1.0 - level[0]
    level[0] = calm * (1.0 - rise) + rest * fall
    for i in range(1, disturbed + 1):
        others = rest - level[i]
        level[i] = level[i] * (1.0 - fall - hop) + calm * rise / disturbed
        if disturbed > 1:
            level[i] += others * hop / (disturbed - 1)


@njit(cache=True, error_model="numpy")
def _weigh(innovation, precision, density):
    """Likelihood at each precision, but for a factor that keeps the greatest of order one.

    Returns:
        The logarithm of that factor.
    """
    half, least = 0.5 * innovation * innovation, precision[-1]
    for k in range(len(precision)):
        density[k] = exp(half * (least - precision[k])) * sqrt(precision[k] / least)
    return 0.5 * log(least / TWO_PI) - half * least


@njit(cache=True, error_model="numpy")
def _likelihood(density, misreport, grid, single):
    """Of one channel for each level, without and with glint: over all its misreports."""
    for g in range(single.shape[0]):
        for i in range(single.shape[1]):
            at, total = grid.levels[i] + g * grid.glint, 0.0
            for j in range(len(misreport)):
                total += misreport[j] * density[at + grid.misreport[j]]
            single[g, i] = max(total, TINY)


@njit(cache=True, error_model="numpy")
def _posterior(innovation, single, level, glints, b, grid, joint):
    """Levels with and without glint given all channels; level and glints take them in.

    Returns:
        The log-likelihood of the channels, from their likelihoods in `single`.
    """
    weights = (1.0 - grid.glint_share * glints[b], grid.glint_share * glints[b])
    most = -np.inf
    for g in range(joint.shape[0]):
        for i in range(joint.shape[1]):
            joint[g, i] = log(max(level[i], TINY))
            for c in range(len(innovation)):
                if not np.isnan(innovation[c]):
                    joint[g, i] += log(single[c, g, i])
            most = max(most, joint[g, i])
    evidence = np.zeros(2)
    for g in range(joint.shape[0]):
        for i in range(joint.shape[1]):
            joint[g, i] = exp(joint[g, i] - most)
            evidence[g] += joint[g, i]
    total = weights[0] * evidence[0] + weights[1] * evidence[1]
    for i in range(joint.shape[1]):
        level[i] = 0.0
        for g in range(joint.shape[0]):
            joint[g, i] *= weights[g] / total
            level[i] += joint[g, i]
    glinting = (1.0 - grid.glint_share) * evidence[0] + grid.glint_share * evidence[1]
    glints[b] *= glinting / total
    return most + log(total)


@njit(cache=True, error_model="numpy")
def _misreported(joint, single, density, precision, leak, grid, misreport):
    """Take a measurement into a channel's misreport; E[1 / variance of the innovation]."""
    count, mean = len(misreport), 0.0
    share = np.zeros(count)
    for g in range(joint.shape[0]):
        for i in range(joint.shape[1]):
            at, weight = grid.levels[i] + g * grid.glint, joint[g, i] / single[g, i]
            for j in range(count):
                k = at + grid.misreport[j]
                part = weight * misreport[j] * density[k]
                share[j] += part
                mean += part * precision[k]
    total = share.sum()
    for j in range(count):
        misreport[j] = (1.0 - leak) * share[j] / total + leak / count
    return mean / total
