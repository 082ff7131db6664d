"""Constant noise covariances, optimised on the error: the strongest static tuning."""

from __future__ import annotations

from collections.abc import Sequence
from math import log
from typing import Any

import numpy as np

from kfenv.envs.knobs import Knob
from kfenv.envs.options import Options
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs, elapsed, measured
from kfenv.filters.results import OK, History, Prediction
from kfenv.models.namespaces import batch
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.scenario import TrackingScenario

from .agent import Array, Parameter
from .compiled import CompiledFilter

DIAGONAL, COUPLING, NOISE = (0.03, 300.0), (np.exp(-2.0), np.exp(2.0)), (0.1, 50.0)


class Okf(CompiledFilter):
    """The Optimized Kalman Filter of Greenberg et al. (2023): Q and R by their Cholesky factors.

    The factor of Q is (diagonal, then couplings of each pair of states) times the model's own
    for the episode's initial state, held ever after; R is the told one times a constant
    for each channel, since no scenario's channels depend on each other. Tuning chooses all of
    them on the error itself, by CMA-ES as for everyone else, where the paper follows gradients.
    """

    def tunable(self, scenario: TrackingScenario, knobs: Sequence[Knob]) -> tuple[Parameter, ...]:
        """n (n + 1) / 2 numbers of Q and m of R; a coupling is the logarithm of its value."""
        states = [state.name for state in scenario.motion.states]
        return (
            *(Parameter(f"q {a}", *DIAGONAL, 1.0) for a in states),
            *(
                Parameter(f"q {a} {b}", *COUPLING, 1.0)
                for i, a in enumerate(states)
                for b in states[:i]
            ),
            *(Parameter(f"r {c.name}", *NOISE, 1.0) for c in scenario.sensor.channels),
        )

    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """See `RecordingFilter.filter`."""
        engine = Engine(scenario.motion, scenario.sensor, options.kappa)
        shape = recording.measurement.shape[:2]
        n = recording.mean.shape[1]
        status, failed_at = np.zeros(shape[0], np.int64), np.full(shape[0], -1)
        means, factors = np.full((*shape, n), np.nan), np.full((*shape, n, n), np.nan)
        nis, dt = np.full(shape, np.nan), elapsed(recording)
        noise = self._process_noise(scenario, recording)
        scale = self._noise_scale(scenario)
        knobs, mean, factor = Knobs.nominal(shape[0]), recording.mean, recording.factor
        for t in range(shape[1]):
            if t == 0:
                prediction = Prediction(mean, factor, np.zeros_like(factor))
            else:
                inputs = recording.motion_inputs[:, t].copy()
                prediction = engine.predict(mean, factor, inputs, dt[:, t].copy(), status)
                prediction = prediction._replace(noise=noise)
            pending = measured(recording, t)
            told = engine.update(
                prediction, knobs, pending._replace(noise=pending.noise * scale), status
            )
            mean, factor = told.mean, told.factor
            failed_at[(status != OK) & (failed_at < 0)] = t
            sound = status == OK
            means[sound, t], factors[sound, t] = mean[sound], factor[sound]
            nis[sound, t] = told.nis[sound]
        return History(means, nis, status, failed_at, factors @ factors.swapaxes(2, 3), factors)

    def _process_noise(self, scenario: TrackingScenario, recording: Recording) -> Array:
        """The lower factor of Q, constant in each episode (B, n, n)."""
        own = initial_noise_factor(scenario, recording)
        states, size = [state.name for state in scenario.motion.states], _sizes(own)
        diagonal = [self.values.get(f"q {a}", 1.0) for a in states]
        chosen = np.tile(np.diag(diagonal), (len(recording), 1, 1))
        for i, a in enumerate(states):
            for j, b in enumerate(states[:i]):
                coupling = log(self.values.get(f"q {a} {b}", 1.0))
                chosen[:, i, j] = diagonal[i] * coupling * size[:, i] / size[:, j]
        return chosen @ own

    def _noise_scale(self, scenario: TrackingScenario) -> Array:
        return np.array([self.values.get(f"r {c.name}", 1.0) for c in scenario.sensor.channels])


def initial_noise_factor(scenario: TrackingScenario, recording: Recording) -> Array:
    """The model's lower factor (B, n, n) of Q for each episode's first step."""
    motion, n = scenario.motion, recording.mean.shape[1]
    dt = recording.times[:, 1] - recording.times[:, 0]
    inputs = tuple(recording.motion_inputs[:, 1].T)
    entries = motion.build(batch).noise_factor(tuple(recording.mean.T), inputs, dt)
    factor = np.zeros((len(recording), n, n))
    for (row, column), entry in zip(motion.noise_pattern, entries, strict=True):
        factor[:, row, column] = entry
    return factor


def _sizes(factor: Array) -> Array:
    """Deviations (B, n) of the states, one where there is no noise: the units of couplings."""
    size = np.sqrt(np.sum(factor**2, axis=2))
    return np.where(size > 0.0, size, 1.0)
