"""A decision in place and in threads gives the bits of one step by step and alone."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from rollouts import (
    GNSS,
    INERTIAL,
    PECULIAR,
    TRACKING,
    assert_same,
    change,
    draw,
    every_environment,
    make_vec,
    random_actions,
)

from kfenv.filters.engine import Engine

SETTINGS = (
    {},
    {"observation": "full", "actions": ["fading", "measurement_noise", "channel_noise"]},
    {"reward": "improvement", "decision_interval": 3},
    {"reward": "likelihood", "decision_interval": 2},
)
MANY = 20  # three blocks of the engine, the last of them half full


class Beside:
    """Hands out results of its own, as filters other than the engine do."""

    def __init__(self, filter):
        self._filter = filter

    def __getattr__(self, name):
        return getattr(self._filter, name)


@pytest.fixture(autouse=True)
def tracks_are_lost_early(monkeypatch):
    """Episodes then end at different times, some terminated and some truncated."""
    for env_id, peculiar in PECULIAR.items():
        environment = load_env_creator(gym.spec(env_id).entry_point)
        monkeypatch.setattr(environment.scenario_class, "lost_distance", peculiar.early_loss)


def heard(vector, count=45):
    """All that a vector environment tells, resets included."""
    actions = random_actions(vector.action_space.shape, count)
    told = [vector.reset(seed=3), *map(vector.step, actions)]
    for *_, info in told:
        if "final_obs" in info:
            info["final_obs"] = list(info["final_obs"])  # arrays inside an array compare badly
    return told


@every_environment
@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: str(list(setting.values())[:1]))
def test_the_engine_in_place_gives_the_bits_of_a_filter_beside(env_id, setting):
    in_place, beside = (make_vec(env_id, 11, autoreset_mode="next_step", **setting) for _ in "ab")
    assert isinstance(in_place.core.filter, Engine)
    beside.core.filter = Beside(beside.core.filter)
    mine, theirs = heard(in_place), heard(beside)
    assert_same(mine, theirs)
    assert_same(in_place.core.state(), beside.core.state())
    assert any(step[2].any() or step[3].any() for step in mine[1:])


@pytest.mark.parametrize("env_id", [TRACKING, INERTIAL])
def test_a_failure_is_the_same_in_place_and_beside(env_id):
    def spoil(measurement):
        measurement[4, 5] = 1e300

    recording = change(draw(env_id, range(9)), measurement=spoil)
    both = [make_vec(env_id, 9, recording=recording, observation="full") for _ in "ab"]
    both[1].core.filter = Beside(both[1].core.filter)
    mine, theirs = (heard(vector, 12) for vector in both)
    assert_same(mine, theirs)
    assert any(step[2][4] for step in mine[1:])


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("env_id", [TRACKING, GNSS])
def test_threads_give_the_bits_of_one(env_id, mode):
    setting = {"autoreset_mode": mode, "observation": "full"}
    one, two = (make_vec(env_id, MANY, threads=n, **setting) for n in (1, 2))
    assert_same(heard(one), heard(two))
    assert_same(one.core.factors, two.core.factors)
    copy = pickle.loads(pickle.dumps(two))
    action = np.zeros(two.action_space.shape)
    assert_same(two.step(action), copy.step(action))


def test_there_are_never_more_threads_than_blocks():
    vector = make_vec(TRACKING, 3, threads=4, autoreset_mode="disabled", info="none")
    vector.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    observation, _ = vector.reset(seed=7, options={"reset_mask": np.array([False, True, False])})
    assert observation.shape == vector.observation_space.shape
    assert vector.step(np.zeros(vector.action_space.shape))[1].shape == (3,)


@pytest.mark.parametrize("threads", [0, 1.5, True])
def test_threads_are_a_positive_whole_number(threads):
    with pytest.raises(ValueError, match="threads must be a positive whole number"):
        make_vec(TRACKING, 3, threads=threads)
