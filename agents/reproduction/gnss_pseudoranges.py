"""What E4's pseudoranges say by themselves: fixes of single epochs, and their errors in one run."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import BIAS, CHANNELS
from kfenv.models.namespaces import batch
from kfenv.scenarios.gnss.fix import least_squares, range_slopes
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.recording import Recording

from .monte_carlo import CHUNK, Outcome, Study

Array = NDArray[np.float64]

STEPS = 8  # of Gauss and Newton, from the centre of the Earth
RANGES = slice(0, CHANNELS)


def gnss_only(study: Study) -> Outcome:
    """Positions and clock biases of every kept instant by itself, as an outcome of no filter.

    Weighted least squares of the pseudoranges. All else is NaN, as is an instant with fewer
    than four satellites.
    """
    chunks = [
        fix_errors(study.sample(first, CHUNK), study.kept) for first in range(0, study.runs, CHUNK)
    ]
    error = np.concatenate(chunks)
    none = np.full(error.shape[:2], np.nan)
    runs = np.zeros(study.runs, np.int64)
    return Outcome(
        error=error, channel_error=np.full((*error.shape[:2], 2 * CHANNELS), np.nan), nees=none,
        nis=none, condition=none, root_condition=none, lost_at=np.full(study.runs, np.inf),
        failure=runs, indefinite=runs,
    )  # fmt: skip


def fix_errors(recording: Recording, kept: NDArray[np.intp]) -> Array:
    """Errors (B, K, 11) of single-epoch fixes at some instants (K,); NaN where there are none."""
    truth = recording.truth[:, kept]
    shape = len(recording) * len(kept), CHANNELS
    satellite = recording.sensor_inputs[:, kept].reshape(*shape, 2, 3)[:, :, 0]
    ranges, noise = (
        values[:, kept, RANGES].reshape(shape)
        for values in (recording.measurement, recording.noise)
    )
    weight = np.isfinite(ranges) / noise
    place, bias = np.zeros((len(ranges), 3)), np.zeros((len(ranges), 1))
    for _ in range(STEPS):
        with np.errstate(invalid="ignore"):  # idle channels have their satellite in the centre
            slopes = range_slopes(satellite, place)
        distance = np.linalg.norm(satellite - place[:, None], axis=-1)
        change, _ = least_squares(slopes, ranges - distance - bias, weight)
        place, bias = place + change[:, :3], bias + change[:, 3:]
    error = np.full(truth.shape, np.nan)
    error[..., 0:9:3] = place.reshape(*truth.shape[:2], 3) - truth[..., 0:9:3]
    error[..., BIAS] = bias.reshape(truth.shape[:2]) - truth[..., BIAS]
    return error


class PseudorangeErrors(NamedTuple):
    """What one run's pseudoranges are off by, at the T instants of its measurements, m."""

    time: Array  # (T,), s
    elevation: Array  # (T, 12), rad
    troposphere: Array  # (T, 12) the whole delay on the way, NaN where a channel is idle
    left: Array  # (T, 12) what the standard correction leaves of it
    error: Array  # (T, 12) of the corrected pseudoranges, noise and faults included


def pseudorange_errors(scenario: GnssTracking, seed: int) -> PseudorangeErrors:
    """Draw an episode and take its pseudoranges apart."""
    recording = scenario.episode(np.random.default_rng(seed))
    truth, inputs = recording.truth[0], recording.sensor_inputs[0]
    exact = np.stack(scenario.sensor.build(batch)(tuple(truth.T), tuple(inputs.T)), axis=1)
    left, uncorrected = (_draft(replace(scenario, troposphere=share), seed) for share in (0.0, 1.0))
    seen = left.satellite >= 0
    measured = slice(None, None, scenario.steps_per_measurement)
    delays = (
        np.where(seen, draft.exact[:, RANGES] - exact[:, RANGES], np.nan)[measured]
        for draft in (uncorrected, left)
    )
    error = (recording.measurement[0] - exact)[measured, RANGES]
    return PseudorangeErrors(recording.time[measured], left.elevation[measured], *delays, error)


def _draft(scenario: GnssTracking, seed: int):
    """An episode before its faults and its noise."""
    rng = np.random.default_rng(seed)
    return scenario.draft(scenario.trajectory(rng), rng)
