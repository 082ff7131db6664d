"""Many filters on the same recordings: run in chunks, kept on disk, resumed where they stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import SeedSequence, default_rng
from numpy.typing import NDArray

from kfenv import __version__
from kfenv.filters.adaptive import AdaptiveDesign, AdaptiveFilter
from kfenv.filters.designs import FilterDesign
from kfenv.filters.matrices import cholesky, solve_lower, symmetric
from kfenv.filters.protocol import Knobs
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.results import History
from kfenv.models.model import Sensor
from kfenv.models.namespaces import batch
from kfenv.scenarios.recording import Recording

from ..files import clear_partial, read_arrays, written_whole
from ..jobs.executor import Workers, run_jobs

Array = NDArray[np.float64]

STREAM = 4  # the splits of a contest are 1 to 3: its episodes and these never meet
CHUNK = 25  # runs filtered and kept together


@dataclass(frozen=True)
class Method:
    """A filter under study.

    Attributes:
        label: its name in tables and figures.
        design: a name in `kfenv.filters.designs.DESIGNS`, or a design.
        kappa: spread of the sigma points in place of the design's.
        process_scale: factor of the process noise covariance that the filter assumes.
        dtype: what a design of the family computes in.
    """

    label: str
    design: str | FilterDesign | AdaptiveDesign
    kappa: float | None = None
    process_scale: float = 1.0
    dtype: str = "float64"


@dataclass(frozen=True)
class Study:
    """Filters that all meet the same recordings.

    Attributes:
        key: name of the study, and of its folder.
        scenario: draws one recording from each generator.
        methods: the filters.
        runs: number of recordings.
        seed: run i draws from a stream of its own, whatever the number of runs.
        initial_deviation: of position, velocity and acceleration, in place of the
            scenario's; the same standard normal draw is scaled.
        spacing: s between the instants whose results are kept.
    """

    key: str
    scenario: Any
    methods: tuple[Method, ...]
    runs: int
    seed: int = 0
    initial_deviation: tuple[float, float, float] | None = None
    spacing: float = 1.0

    def __post_init__(self) -> None:
        if self.runs < 2:
            raise ValueError(f"runs must be at least 2, since spreads are told, got {self.runs}.")

    @property
    def kept(self) -> NDArray[np.intp]:
        """Indices of the instants whose results are kept."""
        time = self.scenario.time
        stride = max(1, round(self.spacing / (time[1] - time[0])))
        return np.arange(0, len(time), stride)

    @property
    def time(self) -> Array:
        """The kept instants, s."""
        return self.scenario.time[self.kept]

    def sample(self, first: int = 0, count: int | None = None) -> Recording:
        """The recordings of `count` runs (by default all) from the first on."""
        last = self.runs if count is None else min(first + count, self.runs)
        keys = [SeedSequence(self.seed, spawn_key=(STREAM, i)) for i in range(first, last)]
        recording = self.scenario.sample([default_rng(key) for key in keys])
        if self.initial_deviation is None:
            return recording
        former = np.diagonal(recording.factor, axis1=1, axis2=2)
        wanted = np.tile(self.initial_deviation, former.shape[1] // 3)
        offset = (recording.mean - recording.truth[:, 0]) / former * wanted
        return replace(
            recording,
            mean=recording.truth[:, 0] + offset,
            factor=np.broadcast_to(np.diag(wanted), recording.factor.shape),
        )


class Outcome(NamedTuple):
    """What one filter made of N runs, at the K kept instants; NaN from a failure on."""

    error: Array  # (N, K, n) estimate minus truth
    channel_error: Array  # (N, K, m) the same in the measured channels, angles wrapped
    nees: Array  # (N, K) of the position, 3 degrees of freedom
    nis: Array  # (N, K)
    condition: Array  # (N, K) of the covariance P
    root_condition: Array  # (N, K) of its factor S; NaN where none is carried
    lost_at: Array  # (N,) s, when the position error exceeded the loss distance or the
    # filter failed; infinite if never
    failure: NDArray[np.int64]  # (N,) an index of `kfenv.filters.results.FAILURES`
    indefinite: NDArray[np.int64]  # (N,) steps whose covariance was not positive definite

    @property
    def position_error(self) -> Array:
        """(N, K, 3), m, of axis-major states."""
        return self.error[..., 0:9:3]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(N,) whether the track was lost."""
        return np.isfinite(self.lost_at)


def run_study(
    study: Study,
    folder: Path,
    processes: Workers = 2,
    advance: Callable[[int], None] = lambda runs: None,
) -> dict[str, Outcome]:
    """Run a study, or what is left of it, and return each method's outcome by label.

    Every finished chunk of runs is a file in `folder`, under a name that tells the
    study's settings, so that an interrupted study goes on where it stopped.

    Args:
        processes: so many of this machine, or a cluster's.
        advance: called with the number of runs that were finished.
    """
    folder = folder / study.key
    folder.mkdir(parents=True, exist_ok=True)
    clear_partial(folder)
    starts = range(0, study.runs, CHUNK)
    paths = {start: folder / f"{_fingerprint(study, start)}.npz" for start in starts}
    todo = [start for start in starts if not paths[start].exists()]
    advance(sum(_size(study, start) for start in starts if start not in todo))
    for start, arrays in run_jobs(partial(_filter_chunk, study), todo, processes):
        with written_whole(paths[start]) as file:
            np.savez(file, **arrays)
        advance(_size(study, start))
    names = [f"{i}/{field}" for i in range(len(study.methods)) for field in Outcome._fields]
    remedy = "delete it, and the same command computes it again"
    chunks = [
        read_arrays(path, names, remedy, _size(study, start)) for start, path in paths.items()
    ]
    return {
        method.label: Outcome(
            *(
                np.concatenate([chunk[f"{i}/{field}"] for chunk in chunks])
                for field in Outcome._fields
            )
        )
        for i, method in enumerate(study.methods)
    }


def filter_recording(scenario: Any, method: Method, recording: Recording) -> History:
    """One method over a whole recording."""
    models = scenario.motion, scenario.sensor
    if isinstance(method.design, AdaptiveDesign):
        tier = AdaptiveFilter(*models, method.design, compiled=True)
    else:
        tier = ReferenceFilter(*models, method.design, method.kappa, method.dtype)
    ones = np.ones(len(recording))
    return tier.history(recording, Knobs(ones, method.process_scale * ones))


def _size(study: Study, start: int) -> int:
    return min(CHUNK, study.runs - start)


def _fingerprint(study: Study, start: int) -> str:
    """A file name for a chunk: equal names hold equal numbers."""
    settings = (__version__, replace(study, runs=2), start, _size(study, start))
    return f"{start:05d}-{sha256(repr(settings).encode()).hexdigest()[:12]}"


def _filter_chunk(study: Study, start: int) -> dict[str, NDArray]:
    recording = study.sample(start, CHUNK)
    arrays = {}
    for i, method in enumerate(study.methods):
        history = filter_recording(study.scenario, method, recording)
        with np.errstate(all="ignore"):  # a filter that has come apart overflows
            outcome = _outcome(study, recording, history)
        arrays |= {f"{i}/{name}": value for name, value in outcome._asdict().items()}
    return arrays


def _outcome(study: Study, recording: Recording, history: History) -> Outcome:
    kept, position = study.kept, np.array(study.scenario.motion.position)
    error = history.mean - recording.truth
    distance = np.linalg.norm(error[..., position], axis=2)
    gone = ~(distance <= study.scenario.lost_distance)
    lost_at = np.where(gone.any(axis=1), recording.time[np.argmax(gone, axis=1)], np.inf)
    P = history.covariance
    rootless = ~np.isfinite(cholesky(_batched(symmetric(P)))).all(axis=(1, 2))
    indefinite = rootless.reshape(P.shape[:2]) & np.isfinite(P).all(axis=(2, 3))
    factors = history.factor
    return Outcome(
        error=error[:, kept],
        channel_error=_channel_error(study.scenario.sensor, history.mean, recording, kept),
        nees=_nees(error[:, kept][..., position], P[:, kept][..., position[:, None], position]),
        nis=history.nis[:, kept],
        condition=_condition(P[:, kept]),
        root_condition=np.full(error[:, kept].shape[:2], np.nan)
        if factors is None
        else _condition(factors[:, kept]),
        lost_at=lost_at,
        failure=history.status,
        indefinite=np.sum(indefinite, axis=1),
    )


def _batched(matrices: Array) -> Array:
    return matrices.reshape(-1, *matrices.shape[2:])


def _nees(error: Array, covariance: Array) -> Array:
    """Normalised squared error; NaN where the covariance is not positive definite."""
    roots = cholesky(_batched(symmetric(covariance)))
    whitened = solve_lower(roots, error.reshape(-1, error.shape[2], 1))
    return np.sum(whitened**2, axis=(1, 2)).reshape(error.shape[:2])


def _condition(matrices: Array) -> Array:
    """Ratio of the extreme singular values, (N, K); NaN where a matrix is not finite."""
    condition = np.full(matrices.shape[:2], np.nan)
    sound = np.isfinite(matrices).all(axis=(2, 3))
    condition[sound] = np.linalg.cond(matrices[sound])
    return condition


def _channel_error(
    sensor: Sensor, mean: Array, recording: Recording, kept: NDArray[np.intp]
) -> Array:
    """What the sensor would show of the estimate less what it would show of the truth."""
    measure = sensor.build(batch)
    inputs = tuple(np.moveaxis(recording.sensor_inputs[:, kept], 2, 0))
    seen, true = (
        np.stack(measure(tuple(np.moveaxis(states[:, kept], 2, 0)), inputs), axis=2)
        for states in (mean, recording.truth)
    )
    error = seen - true
    angles = [channel.angle for channel in sensor.channels]
    error[..., angles] -= 2.0 * np.pi * np.round(error[..., angles] / (2.0 * np.pi))
    return error
