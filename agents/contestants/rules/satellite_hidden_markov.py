"""A hidden Markov model of each satellite's range: sound, stepped aside or slowly drawn away."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.scenarios.faults import resolve_faults
from kfenv.scenarios.gnss.faults import RangeRamp, RangeStep

from ..agent import Array, Briefing, Parameter, knob_actions
from .hidden_markov import HmmNoise, hear
from .satellites import RANGES, RATES, SatelliteRule, unexplained

SIZES, SPEEDS, AGES = 6, 5, 12  # levels of steps and ramps of either sign, and of a ramp's age
SUSPECT = 0.5  # probability from which a satellite is kept out of the noise's level


class RangeErrors(NamedTuple):
    """What may be wrong with a range: K states, the first of them nothing.

    Attributes:
        error, speed: (K,) of the range, m, and of the rate, m/s.
        begin: (K,) probability that a fault begins there; they sum to one.
        end: (K,) rate at which it ends, 1/s.
        age: rate at which a ramp moves on to the next state, 1/s.
        ramps: the first state that is a ramp; each has `AGES` states in a row.
    """

    error: Array
    speed: Array
    begin: Array
    end: Array
    age: float
    ramps: int


class SatelliteHmm(SatelliteRule, HmmNoise):
    """`HmmNoise` beside a hidden Markov model of each satellite, forward as in Rabiner (1989).

    A satellite is sound, or its range is off by one of a few steps, or drawn away at one of a
    few speeds since one of a few ages; the likelihood is that of what the other satellites do
    not explain of its range and rate. A channel gets the noise of `HmmNoise`, with the mean
    square of the error on top; while a satellite is suspect it has no say in that noise.
    """

    parameters = (
        Parameter("up", 0.002, 0.5, 0.01),
        Parameter("down", 0.001, 0.5, 0.2),
        Parameter("glint_share", 0.005, 0.5, 0.08),
        Parameter("leak", 1e-6, 1e-2, 1e-4),
        Parameter("process_noise", 0.05, 200.0, 2.3),
        Parameter("fault_rate", 1e-6, 1e-1, 4e-4),  # of a satellite, 1/s
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._errors = range_errors(briefing.scenario)
        self._states = np.zeros((briefing.batch, CHANNELS, len(self._errors.error)))
        self._states[..., 0] = 1.0
        self._square = np.zeros((briefing.batch, 2 * CHANNELS))

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        passed, told = self._passed(info), info["noise"]
        arrived = ~np.isnan(info["innovation"])
        suspect = np.tile(self._states[..., 0] < 1.0 - SUSPECT, 2)
        doubt = np.where(arrived, np.hypot(1.0, np.sqrt(self._square) / told), 1.0)
        residual, deviation = unexplained(info, doubt)
        noise, _ = hear(
            np.where(suspect, np.nan, residual), deviation**2, told, passed,
            self.values["up"], self.values["down"], self.values["leak"], self._grid,
            self._belief,
        )  # fmt: skip
        noise = np.where(arrived, _filled(noise), np.nan)
        budget = np.hypot(noise, np.sqrt(self._square) / told)
        residual, deviation = unexplained(info, np.where(arrived, budget, 1.0))
        variance = deviation**2 - np.where(arrived, self._square, 0.0)
        follow(residual, variance, passed, self.values["fault_rate"], self._errors, self._states)
        for part, error in ((RANGES, self._errors.error), (RATES, self._errors.speed)):
            self._square[:, part] = self._states @ error**2
        noise = np.hypot(noise, np.sqrt(self._square) / told)
        return knob_actions(self.briefing, 1.0, self._process_noise(info), noise)


def _filled(noise: Array) -> Array:
    """The suspects take the mean of their group; 1 where nobody has any."""
    filled = noise.copy()
    for part in (RANGES, RATES):
        group = noise[:, part]
        count = np.sum(~np.isnan(group), axis=1, keepdims=True)
        mean = np.nansum(group, axis=1, keepdims=True) / np.maximum(count, 1)
        filled[:, part] = np.where(np.isnan(group), np.where(count > 0, mean, 1.0), group)
    return filled


def range_errors(scenario: Any) -> RangeErrors:
    """The states for the steps and ramps of a scenario, or for the usual ones."""
    faults = resolve_faults(scenario.faults, scenario.presets, scenario.known_faults)
    step = next((fault for fault in faults if isinstance(fault, RangeStep)), RangeStep())
    ramp = next((fault for fault in faults if isinstance(fault, RangeRamp)), RangeRamp())
    sizes = np.outer((-1.0, 1.0), np.geomspace(*step.size, SIZES)).ravel()
    speeds = np.outer((-1.0, 1.0), np.geomspace(*ramp.rate, SPEEDS)).ravel()
    age = (np.arange(AGES) + 0.5) * ramp.duration[1] / AGES
    error = np.concatenate([[0.0], sizes, np.outer(speeds, age).ravel()])
    speed = np.concatenate([np.zeros(1 + len(sizes)), np.repeat(speeds, AGES)])
    begin, ramps = np.zeros(len(error)), 1 + len(sizes)
    begin[1:ramps], begin[ramps::AGES] = 0.5 / len(sizes), 0.5 / len(speeds)
    end = np.full(len(error), 1.0 / np.mean(ramp.duration))
    end[1:ramps] = 1.0 / np.mean(step.duration)
    return RangeErrors(error, speed, begin, end, AGES / ramp.duration[1], ramps)


@njit(cache=True, error_model="numpy")
def follow(residual, variance, passed, rate, errors, states):
    """Take what is not explained into the satellites' states (B, 12, K), in place.

    Args:
        residual, variance: (B, 24) as the satellite's soundness would have them, NaN in
            channels that did not arrive.
        passed: (B,) seconds since the last call.
        rate: at which a sound satellite fails, 1/s.
    """
    satellites = states.shape[1]
    for b in range(states.shape[0]):
        for c in range(satellites):
            state = states[b, c]
            _move(state, passed[b], rate, errors)
            _weigh(state, residual[b, c], variance[b, c], errors.error)
            _weigh(state, residual[b, satellites + c], variance[b, satellites + c], errors.speed)


@njit(cache=True, error_model="numpy")
def _move(state, passed, rate, errors):
    """Faults begin and end, and ramps grow older."""
    fails, older = state[0] * (1.0 - exp(-rate * passed)), 1.0 - exp(-errors.age * passed)
    state[0] -= fails
    for k in range(len(state) - 1, 0, -1):
        ends = state[k] * (1.0 - exp(-errors.end[k] * passed))
        state[0] += ends
        state[k] -= ends
        if k >= errors.ramps and (k - errors.ramps) % AGES < AGES - 1:
            state[k + 1] += state[k] * older
            state[k] *= 1.0 - older
        state[k] += fails * errors.begin[k]


@njit(cache=True, error_model="numpy")
def _weigh(state, residual, variance, errors):
    """Multiply by the likelihood of a residual, nothing if that is missing."""
    if np.isnan(residual):
        return
    nearest, total = np.inf, 0.0
    for k in range(len(state)):
        if state[k] > 0.0:  # what cannot be must not make all that can be vanish
            nearest = min(nearest, (residual - errors[k]) ** 2)
    for k in range(len(state)):
        if state[k] > 0.0:
            state[k] *= exp(-0.5 * ((residual - errors[k]) ** 2 - nearest) / variance)
            total += state[k]
    for k in range(len(state)):
        state[k] /= total
