"""The Rao-Blackwellised particle filter with the true priors of the faults."""

from __future__ import annotations

from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from kfenv.envs.options import Options
from kfenv.filters.engine import Engine
from kfenv.filters.mixing import mix
from kfenv.filters.protocol import Knobs, Measurement, measured
from kfenv.filters.results import BAD_UPDATE, OK, History, Prediction, blame
from kfenv.filters.transforms import StateFunction, angle_indices, wrap
from kfenv.models.namespaces import batch, dual
from kfenv.scenarios.recording import Recording

from ..agent import Array
from ..compiled import CompiledFilter
from .hypotheses import Situation, choose
from .priors import NoisePriors

PROCESS_NOISE = np.array([0.01, 1.0, 30.0, 500.0])
SWITCHING = 0.1  # 1/s
SPREAD = 0.1  # of Liu and West's kernel for what stays for the episode
ROWS = 32_768  # particles of all episodes that are held at once


class ParticleBound(CompiledFilter):
    """What a filter that knows how the faults are drawn can reach, but for its Monte Carlo error.

    Rao-Blackwellised (Doucet et al. 2000): a particle is a history of bursts, glints,
    misreports (Liu and West 2001) and process noises, and carries the compiled filter given
    that history. It knows the faults' priors exactly (`NoisePriors`), but not how the target
    manoeuvres, for which it has four process noises. Slow: a limit to measure against.

    Args:
        particles: for each episode.
        seed: with an episode's own measurements it makes its random numbers.
    """

    def __init__(self, name: str, values: Any = None, particles: int = 256, seed: int = 0) -> None:
        super().__init__(name, values)
        self.particles, self.seed = particles, seed

    def with_values(self, values: Any) -> ParticleBound:
        """Itself: nothing is tuned."""
        return self

    def check(self, scenario: Any, options: Options, recording: Recording) -> None:
        """See `CompiledFilter.check`.

        Raises:
            ValueError: if the scenario's faults are none that `NoisePriors` knows.
        """
        super().check(scenario, options, recording)
        NoisePriors.of(scenario, recording)

    def filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        """See `RecordingFilter.filter`; some episodes at a time."""
        size = max(1, ROWS // self.particles)
        parts = [
            self._filter(scenario, options, recording[begin : begin + size])[:5]
            for begin in range(0, len(recording), size)
        ]
        joined = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        return History(*joined, None)

    def _filter(self, scenario: Any, options: Options, recording: Recording) -> History:
        run = Particles(scenario, options, recording, self.particles, self.seed)
        episodes, steps, n = len(recording), len(recording.time), recording.mean.shape[1]
        means = np.full((episodes, steps, n), np.nan)
        covariances = np.full((episodes, steps, n, n), np.nan)
        failed_at = np.full(episodes, -1)
        for t in range(steps):
            mean, factor, status = run.step(t)
            failed_at[(status != OK) & (failed_at < 0)] = t
            sound = status == OK
            means[sound, t] = mean[sound]
            covariances[sound, t] = factor[sound] @ factor[sound].swapaxes(1, 2)
        return History(means, np.full((episodes, steps), np.nan), status, failed_at, covariances,
                       None)  # fmt: skip


class Particles:
    """P particles for each of B episodes, in rows episode by episode."""

    def __init__(
        self, scenario: Any, options: Options, recording: Recording, count: int, seed: int
    ) -> None:
        self.recording, self.count = recording, count
        self.engine = Engine(scenario.motion, scenario.sensor, options.kappa)
        self._angles = angle_indices(scenario.sensor.channels)
        self._is_angle = np.array([state.angle for state in scenario.motion.states])
        self._sensor = scenario.sensor.build(batch), scenario.sensor.build(dual)
        self._priors = NoisePriors.of(scenario, recording)
        self._rngs = [default_rng((seed, crc32(z.tobytes()))) for z in recording.measurement]
        rows = len(recording) * count
        self.mean = np.repeat(recording.mean, count, 0)
        self.factor = np.repeat(recording.factor, count, 0)
        self._log_weight = np.zeros(rows)
        self._status = np.zeros(len(recording), np.int64)
        self._dt = np.diff(recording.time, prepend=recording.time[0])
        self._situation = self._begin(rows)

    def _begin(self, rows: int) -> Situation:
        channels = self.recording.measurement.shape[2]
        low, high = self._priors.misreport
        misreport = low + (high - low) * self._uniform(channels)
        motion = (self._uniform(1)[:, 0] * len(PROCESS_NOISE)).astype(np.int64)
        nothing = np.zeros((3, rows), np.int64)
        return Situation(np.ones(rows), np.zeros(rows), *nothing, misreport, motion)

    def _uniform(self, columns: int) -> Array:
        """(B P, columns) numbers, each episode's from its own generator."""
        return np.concatenate([rng.random((self.count, columns)) for rng in self._rngs])

    def step(self, t: int) -> tuple[Array, Array, NDArray[np.int64]]:
        """Advance to an instant; mean (B, n), factor (B, n, n) and status (B,)."""
        count, dt = self.count, float(self._dt[t])
        pending = Measurement(*(np.repeat(a, count, 0) for a in measured(self.recording, t)))
        work = np.zeros(len(self.mean), np.int64)
        prediction = self._predict(t, work)
        innovation, slope = self._look(prediction.mean, pending)
        deviation, priors = np.empty_like(pending.noise), self._priors
        glint = np.array([priors.glint_chance, priors.glint_share, priors.glint_factor])
        choose(
            innovation, slope @ prediction.root, slope @ prediction.noise, pending.noise, dt,
            PROCESS_NOISE, 1.0 - np.exp(-SWITCHING * dt), priors.start[t], priors.ending,
            priors.factor, glint, self._uniform(2), self._situation, deviation, self._log_weight,
        )  # fmt: skip
        knobs = Knobs(np.ones(len(work)), PROCESS_NOISE[self._situation.motion])
        told = self.engine.update(prediction, knobs, pending._replace(noise=deviation), work)
        self.mean, self.factor = told.mean, told.factor
        self._log_weight[work != OK] = -np.inf
        weight = self._normalise()
        mean, factor = mix(
            weight[:, :, None], self._by_episode(self.mean), self._by_episode(self.factor),
            self._is_angle,
        )  # fmt: skip
        blame(self._status, BAD_UPDATE, mean, factor)
        self._resample(weight)
        return mean[:, 0], factor[:, 0], self._status

    def _predict(self, t: int, work: NDArray[np.int64]) -> Prediction:
        if t == 0:
            return Prediction(self.mean, self.factor, np.zeros_like(self.factor))
        inputs = np.repeat(self.recording.motion_inputs[:, t], self.count, 0)
        dt = np.full(len(self.mean), self._dt[t])
        prediction = self.engine.predict(self.mean, self.factor, inputs, dt, work)
        prediction.mean[work != OK] = 0.0  # meaningless, and out of the way
        return prediction

    def _look(self, mean: Array, pending: Measurement) -> tuple[Array, Array]:
        """Innovation (R, m) and the sensor's slope (R, m, n) at the predicted means."""
        function = StateFunction(*self._sensor, self._angles, pending.inputs)
        expected = function.values(mean[:, :, None])[:, :, 0]
        return wrap(pending.value - expected, self._angles), function.jacobian(mean)

    def _by_episode(self, rows: Array) -> Array:
        return rows.reshape(len(self.recording), self.count, *rows.shape[1:])

    def _normalise(self) -> Array:
        """Weights (B, P) of sum 1."""
        logs = np.nan_to_num(self._by_episode(self._log_weight), nan=-np.inf)
        most = logs.max(axis=1, keepdims=True)
        self._status[~np.isfinite(most[:, 0])] = BAD_UPDATE
        weight = np.exp(logs - np.where(np.isfinite(most), most, 0.0))
        total = weight.sum(axis=1, keepdims=True)
        return weight / np.where(total > 0.0, total, 1.0)

    def _resample(self, weight: Array) -> None:
        """Where fewer than half of the particles count, draw them anew by their weights."""
        effective = 1.0 / np.maximum(np.sum(weight**2, axis=1), 1e-300)
        self._log_weight = np.log(np.maximum(weight, 1e-300)).ravel()
        for b in np.flatnonzero((effective < 0.5 * self.count) & (self._status == OK)):
            rows = slice(b * self.count, (b + 1) * self.count)
            chosen = b * self.count + systematic(weight[b], self._rngs[b])
            misreport = self._situation.misreport[rows]
            centre = weight[b] @ misreport
            spread = np.sqrt(weight[b] @ (misreport - centre) ** 2)
            for array in (self.mean, self.factor, *self._situation):
                array[rows] = array[chosen]
            self._log_weight[rows] = 0.0
            kept = np.sqrt(1.0 - SPREAD**2)
            noise = SPREAD * spread * self._rngs[b].standard_normal(misreport.shape)
            moved = kept * misreport + (1.0 - kept) * centre + noise
            misreport[:] = np.clip(moved, *self._priors.misreport)


def systematic(weight: Array, rng: Generator) -> NDArray[np.int64]:
    """Indices (P,) drawn by weights of sum 1, with one random number for all."""
    count = len(weight)
    places = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weight), places), count - 1)
