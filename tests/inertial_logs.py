"""Inertial and GNSS logs of a simulated drive, written as the CSV files that a user brings."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pymap3d
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.scenarios.inertial.files import GNSS_COLUMNS, IMU_COLUMNS, TRUTH_COLUMNS
from kfenv.scenarios.inertial.flights import exact_samples, random_flight

Array = NDArray[np.float64]

ORIGIN = (45.2, 7.6, 300.0)
CLOCK = 1000.0  # s, the log's first time
DEVIATION = np.array([1.5, 1.5, 3.0, 0.1, 0.1, 0.2])


class Drive(NamedTuple):
    """What two or three files hold, as arrays with a column per name."""

    imu: Array
    gnss: Array
    truth: Array

    def write(self, folder: Path) -> tuple[str, str, str]:
        """Write the files and tell their paths."""
        paths = []
        for name, table, columns in (
            ("imu.csv", self.imu, IMU_COLUMNS), ("gnss.csv", self.gnss, GNSS_COLUMNS),
            ("truth.csv", self.truth, TRUTH_COLUMNS),
        ):  # fmt: skip
            paths.append(str(folder / name))
            np.savetxt(paths[-1], table, "%.17g", ",", header=",".join(columns), comments="")
        return tuple(paths)


def drive(
    duration: float = 300.0, rate: float = 100.0, every: int = 20, noisy: bool = True, seed: int = 1
) -> tuple[Drive, Array]:
    """A flight of gentle turns with a good inertial unit, and its states (T, 9)."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate) + 1) / rate
    flight = random_flight(rng, time)
    return _recorded(rng, time, flight, every, noisy), flight


def car(
    duration: float = 300.0, rate: float = 100.0, every: int = 20, seed: int = 1
) -> tuple[Drive, Array]:
    """A level drive through bends at 6 to 18 m/s: unlike a flight, it does not bank."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate) + 1) / rate
    speed = 12.0 + 6.0 * np.sin(time / 9.0)
    yaw = 1.5 * np.sin(time / 7.0) + np.sin(time / 17.0)
    states = np.zeros((len(time), 9))
    states[:, 3], states[:, 4], states[:, 8] = speed * np.cos(yaw), speed * np.sin(yaw), yaw
    states[1:, :3] = np.cumsum(0.5 / rate * (states[1:, 3:6] + states[:-1, 3:6]), axis=0)
    return _recorded(rng, time, states, every), states


def stop_and_go(duration: float = 200.0, rate: float = 20.0, every: int = 5) -> Drive:
    """A car that stands for 20 s of every 50 and shakes its unit when it moves."""
    rng = np.random.default_rng(1)
    time = np.arange(round(duration * rate) + 1) / rate
    since = time % 50.0
    speed = 12.0 * np.clip(np.minimum((since - 20.0) / 4.0, (50.0 - since) / 4.0), 0.0, 1.0)
    yaw = np.cumsum(0.04 * speed * np.sin(time / 9.0)) / rate
    states = np.zeros((len(time), 9))
    states[:, 3], states[:, 4], states[:, 8] = speed * np.cos(yaw), speed * np.sin(yaw), yaw
    states[1:, :3] = np.cumsum(0.5 / rate * (states[1:, 3:6] + states[:-1, 3:6]), axis=0)
    log = _recorded(rng, time, states, every)
    shaken = np.array([0.5] * 3 + [0.02] * 3) * rng.standard_normal((len(time), 6))
    log.imu[:, 1:] += np.where(speed[:, None] > 0.0, shaken, 0.0)
    return log


def _recorded(rng: Generator, time: Array, states: Array, every: int, noisy: bool = True) -> Drive:
    samples = exact_samples(states, time)
    deviation = np.tile(DEVIATION, (len(time[::every]), 1))
    fix = states[::every, :6] + noisy * deviation * rng.standard_normal(deviation.shape)
    if noisy:
        samples = samples + ([0.03] * 3 + [0.0005] * 3)
        samples += rng.standard_normal(samples.shape) * ([0.05] * 3 + [0.001] * 3)
    clock = CLOCK + time[:, None]
    return Drive(
        np.hstack([clock, samples]),
        np.hstack([clock[::every], _geodetic(fix[:, :3]), fix[:, 3:], deviation]),
        np.hstack([clock, _geodetic(states[:, :3]), states[:, 3:6]]),
    )


def _geodetic(position: Array) -> Array:
    return np.stack(pymap3d.ned2geodetic(*position.T, *ORIGIN), axis=1)
