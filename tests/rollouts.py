"""What the environment tests share: every registered id, short episodes, comparisons."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding

import kfenv
from kfenv.scenarios.recording import Recording

every_environment = pytest.mark.parametrize("env_id", kfenv.ENVIRONMENTS)

TRACKING, VALIDATION = "kfenv/RadarTracking-v0", "kfenv/RadarValidation-v0"
BISTATIC = "kfenv/BistaticTracking-v0"
INERTIAL = "kfenv/InsGnss-v0"
GNSS = "kfenv/GnssTracking-v0"
OWN = "kfenv/Filter-v0"

# Faults of every scenario, short and mild enough for short episodes.
FAULTS = {
    "jamming": {"bursts": [1, 2], "duration": [0.5, 1.5], "factor": [2.0, 6.0]},
    "signal_loss": {"duration": [0.3, 0.8]},
    "glint": {"factor": 4.0},
    "noise_misreport": {"factor": [0.7, 1.4]},
}


class Peculiar(NamedTuple):
    """What the tests must know of one environment beyond what it says itself.

    Attributes:
        early_loss: a loss distance at which some short episodes are lost and some not, m.
        default_faults: the environment's own choice.
        faults: spoil its short episodes.
        follows_rate: arguments that take the rate's value, so that every step has a measurement.
    """

    early_loss: float
    default_faults: str = "random"
    faults: dict = FAULTS
    follows_rate: tuple[str, ...] = ()


PECULIAR = {
    TRACKING: Peculiar(90.0),
    VALIDATION: Peculiar(800.0, "none"),
    BISTATIC: Peculiar(9.0),
    INERTIAL: Peculiar(200.0),
    GNSS: Peculiar(20.0, follows_rate=("measurement_rate",)),
    OWN: Peculiar(0.5),
}
assert set(PECULIAR) == set(kfenv.ENVIRONMENTS)


def error_name(env_id: str) -> str:
    """Of the error in info."""
    return "scored_error" if env_id == OWN else "position_error"


def short(env_id: str, **keywords) -> dict:
    """Arguments for episodes of 41 decisions at 10 Hz, with faults, unless told otherwise."""
    peculiar = PECULIAR[env_id]
    arguments = {"duration": 4.0, "rate": 10.0, "faults": peculiar.faults} | keywords
    return dict.fromkeys(peculiar.follows_rate, arguments["rate"]) | arguments


def make(env_id: str, **keywords) -> gym.Env:
    """The bare environment, of short episodes unless told otherwise."""
    return gym.make(env_id, **short(env_id, **keywords)).unwrapped


def make_vec(env_id: str, num_envs: int, **keywords) -> gym.vector.VectorEnv:
    return gym.make_vec(env_id, num_envs=num_envs, **short(env_id, **keywords))


def zeros(env: gym.Env | gym.vector.VectorEnv, *count: int) -> np.ndarray:
    """Nominal actions for it, as many as told."""
    return np.zeros((*count, *env.action_space.shape))


def draw(env_id: str, seeds, **keywords) -> Recording:
    """The episodes that environments seeded so replay first."""
    return make(env_id, **keywords).scenario.sample([seeding.np_random(s)[0] for s in seeds])


def change(recording: Recording, **changes) -> Recording:
    """The recording with other arrays; a function gets the old one's copy to change."""
    for name, value in changes.items():
        if callable(value):
            array = getattr(recording, name).copy()
            value(array)
            changes[name] = array
    return replace(recording, **changes)


def truth_leaves(recording, k, scenario, far=2.0):
    """The truth jumps so many loss distances away at index k: beyond one, the track is lost."""

    def leave(truth):
        truth[:, k:, scenario.yardstick.states[0]] += far * scenario.lost_distance

    return change(recording, truth=leave)


def play(env: gym.Env, actions, seed: int | None = None) -> list[tuple]:
    """Reset and step until the episode ends or the actions do: what came back, in order."""
    heard = [env.reset(seed=seed)]
    for action in actions:
        heard.append(env.step(action))
        if heard[-1][2] or heard[-1][3]:
            break
    return heard


def random_actions(shape: tuple[int, ...], count: int, seed: int = 5) -> list:
    """Mostly small ones, the ends of the knobs among them."""
    rng = np.random.default_rng(seed)
    return list(np.clip(rng.standard_cauchy((count, *shape)) / 20.0, -1, 1).astype(np.float32))


def assert_same(one, other, where: str = "") -> None:
    """The same structure and the same numbers to the last bit, NaN for NaN."""
    assert type(one) is type(other), where
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one:
            assert_same(one[key], other[key], f"{where}[{key!r}]")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), where
        for i, (mine, theirs) in enumerate(zip(one, other, strict=True)):
            assert_same(mine, theirs, f"{where}[{i}]")
    else:
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype, where
        np.testing.assert_array_equal(one, other, err_msg=where)


def assert_same_recording(one: Recording, other: Recording) -> None:
    for field in fields(Recording):
        assert_same(getattr(one, field.name), getattr(other, field.name), field.name)
