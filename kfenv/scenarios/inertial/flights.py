"""Flights for inertial navigation: one from the paper's start, random ones, their exact samples.

A flight is an array (T, 9) of states [pN, pE, pD, vN, vE, vD, roll, pitch, yaw], m, m/s, rad.
Velocity and attitude are prescribed at the instants; position is the trapezoid of velocity,
and the inertial samples invert the discrete mechanisation of `kfenv.models.strapdown`, so
that a unit without errors reproduces the flight to rounding (SPEC 7.1 E6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.models.rotations import exponential, logarithm, matrix_from_angles
from kfenv.models.strapdown import GRAVITY
from kfenv.scenarios.trajectories import random_trajectories

Array = NDArray[np.float64]

# The start of S4 Table 1; down is printed as +1000 m and +50 m/s, against a pitch of +10 deg.
PAPER_START = (1_000.0, 1_000.0, -1_000.0)  # m
PAPER_VELOCITY = (260.0, 70.0, -50.0)  # m/s
PAPER_ROLL, PAPER_PITCH, PAPER_YAW = np.radians([45.0, 10.0, 10.0])  # the track is at 15.1 deg

# The flight from there on is not in the paper and ours.
PITCH_SWING = np.radians(5.0)
TURN_SPEED = 270.0  # m/s, of the coordinated turn: sqrt(260^2 + 70^2)
PERIOD = 50.0  # s

ANGLE_OF_ATTACK = np.radians(3.0)  # of the random flights


def paper_flight(time: Array) -> Array:
    """Our flight from the start that the paper gives (SPEC 7.1 E6): a climbing S of 50 s.

    The paper gives position, velocity and attitude at the start and no more. Roll
    45 cos(2 pi t / 50) deg, pitch 10 + 5 sin(2 pi t / 25) deg, yaw rate g tan(roll) / 270;
    horizontal velocity turns with the yaw, vD = -50 cos(2 pi t / 50) m/s.

    Args:
        time: (T,) s, from 0 on.
    """
    phase = 2.0 * np.pi * time / PERIOD
    roll = PAPER_ROLL * np.cos(phase)
    pitch = PAPER_PITCH + PITCH_SWING * np.sin(2.0 * phase)
    rate = GRAVITY * np.tan(roll) / TURN_SPEED
    turned = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[1:] + rate[:-1]))])
    north, east, down = PAPER_VELOCITY
    sine, cosine = np.sin(turned), np.cos(turned)
    velocity = [north * cosine - east * sine, north * sine + east * cosine, down * np.cos(phase)]
    angles = np.stack([roll, pitch, _wrapped(PAPER_YAW + turned)], axis=1)
    return _flight(time, np.array(PAPER_START), np.stack(velocity, axis=1), angles)


def random_flight(rng: Generator, time: Array) -> Array:
    """One random flight (T, 9), see `random_flights`."""
    return random_flights([rng], time)[0]


def random_flights(rngs: Sequence[Generator], time: Array) -> Array:
    """Random flights (B, T, 9), begun at 0, 0: those of `random_trajectories`, turned and banked.

    Turns are coordinated (the wings' lift stands in the plane of symmetry), without
    sideslip, the nose 3 deg above the path.

    Args:
        rngs: where the flights come from; the same state gives the same bits.
        time: (T,) s.
    """
    states = random_trajectories(rngs, time)
    axes = ([4, 1, 7], [5, 2, 8])
    sign = np.array([1.0, 1.0, -1.0])
    velocity, acceleration = (states[..., index] * sign for index in axes)
    start = states[:, :1, 6:7] * [0.0, 0.0, -1.0]
    return _flight(time, start, velocity, _coordinated(velocity, acceleration))


def exact_samples(truth: Array, time: Array) -> Array:
    """The inertial samples (..., T, 6) that carry each state of a flight (..., T, 9) to the next.

    Row t belongs to the step from t - 1 to t; row 0, which drives none, repeats row 1.
    """
    dt = np.diff(time)[:, None]
    C = matrix_from_angles(truth[..., 6:])
    before, after = C[..., :-1, :, :], C[..., 1:, :, :]
    turned = logarithm(before.swapaxes(-1, -2) @ after)
    middle = before @ exponential(0.5 * turned)
    pull = np.diff(truth[..., 3:6], axis=-2) / dt - np.array([0.0, 0.0, GRAVITY])
    force = np.einsum("...ji,...j->...i", middle, pull)
    samples = np.concatenate([force, turned / dt], axis=-1)
    return np.concatenate([samples[..., :1, :], samples], axis=-2)


def _coordinated(velocity: Array, acceleration: Array) -> Array:
    """Roll, pitch and yaw (..., T, 3) of flights without sideslip."""
    north, east, down = np.moveaxis(velocity, -1, 0)
    ground_squared = north**2 + east**2
    yaw = np.arctan2(east, north)
    pitch = np.arctan2(-down, np.sqrt(ground_squared)) + ANGLE_OF_ATTACK
    across = (north * acceleration[..., 1] - east * acceleration[..., 0]) / np.sqrt(ground_squared)
    return np.stack([np.arctan2(across, GRAVITY - acceleration[..., 2]), pitch, yaw], axis=-1)


def _flight(time: Array, start: Array, velocity: Array, angles: Array) -> Array:
    step = 0.5 * np.diff(time)[:, None] * (velocity[..., 1:, :] + velocity[..., :-1, :])
    travelled = np.concatenate([np.zeros_like(step[..., :1, :]), np.cumsum(step, axis=-2)], axis=-2)
    return np.concatenate([start + travelled, velocity, angles], axis=-1)


def _wrapped(angle: Array) -> Array:
    return np.arctan2(np.sin(angle), np.cos(angle))
