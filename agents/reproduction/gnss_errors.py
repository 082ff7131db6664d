"""Errors of E4's filters in east, north and up, inside and outside its faults."""

from __future__ import annotations

import numpy as np
import pymap3d
from numpy.typing import NDArray

from kfenv.scenarios.gnss.tracking import GnssTracking

from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]

CLOCK, PLL = GnssTracking.presets["paper"]  # their times and sizes are ours: S0 tells none
FAULT, LOSS = ((f.start, f.start + f.duration[0]) for f in (CLOCK, PLL))  # s
RECOVERY = 10.0  # s after either until its errors are forgotten
SETTLED = 25.0  # s
POSITION, ACCELERATION = slice(0, 9, 3), slice(2, 9, 3)


def rotation(scenario: GnssTracking) -> Array:
    """From the earth-fixed frame to east, north, up at the flights' origin (3, 3)."""
    return scenario.local_frame(np.array(pymap3d.geodetic2ecef(*scenario.place)))[1]


def local(study: Study, outcome: Outcome) -> Outcome:
    """The outcome with its errors in east, north and up."""
    return outcome._replace(error=turned(outcome.error, rotation(study.scenario)))


def turned(states: Array, axes: Array) -> Array:
    """States (..., 11), or differences of them, with the nine of the motion in other axes."""
    motion = states[..., :9].reshape(*states.shape[:-1], 3, 3)
    moved = np.einsum("ij,...jd->...id", axes, motion)
    return np.concatenate([moved.reshape(*states.shape[:-1], 9), states[..., 9:]], axis=-1)


def inside(study: Study) -> NDArray[np.bool_]:
    """Which kept instants lie in the clock fault."""
    return (study.time >= FAULT[0]) & (study.time < FAULT[1])


def outside(study: Study) -> NDArray[np.bool_]:
    """Which kept instants are settled and untouched by either fault."""
    spoilt = [(study.time >= s) & (study.time < e + RECOVERY) for s, e in (FAULT, LOSS)]
    return (study.time > SETTLED) & ~spoilt[0] & ~spoilt[1]


def rms(outcome: Outcome, columns: slice | int, when: NDArray[np.bool_]) -> Array:
    """RMS over runs kept and instants, of each of the columns."""
    return np.sqrt(np.mean(outcome.error[~outcome.lost][:, when, columns] ** 2, axis=(0, 1)))


def run_rms(outcome: Outcome, columns: slice, when: NDArray[np.bool_]) -> Array:
    """(N,) RMS of each run, of the length of the columns' vector; NaN where lost."""
    squares = np.sum(outcome.error[:, when, columns] ** 2, axis=2)
    return np.where(outcome.lost, np.nan, np.sqrt(np.mean(squares, axis=1)))
