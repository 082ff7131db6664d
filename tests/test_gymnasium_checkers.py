"""The checkers of Gymnasium and stable-baselines3 find nothing, by every way to make an id."""

import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from rollouts import every_environment

import kfenv


@pytest.fixture(autouse=True)
def warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # the machine's lack of a screen, which the checker of render_mode="human" meets
        warnings.filterwarnings("ignore", ".*opens no window")
        yield


@every_environment
@pytest.mark.parametrize("keywords", [{}, {"decision_interval": 3, "actions": ["fading"]}])
def test_gymnasium(env_id, keywords):
    check_env(gym.make(env_id, **keywords).unwrapped)


@every_environment
def test_stable_baselines3(env_id):
    with warnings.catch_warnings():  # what importing torch warns of is not ours
        warnings.simplefilter("ignore")
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(env_id).unwrapped)


@every_environment
def test_the_checkers_can_complain(env_id):
    env = gym.make(env_id).unwrapped
    env.observation_space = gym.spaces.Box(-1e-3, 1e-3, env.observation_space.shape, np.float32)
    with pytest.raises((AssertionError, UserWarning)):
        check_env(env)


@every_environment
def test_many_environments_are_made_as_one(env_id):
    env = gym.make_vec(env_id, num_envs=256, duration=10.0)
    observation, _ = env.reset(seed=0)
    assert isinstance(env, gym.vector.VectorEnv) and not isinstance(env, gym.vector.SyncVectorEnv)
    assert env.observation_space.contains(observation) and len(observation) == 256
    observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)
    assert reward.shape == terminated.shape == truncated.shape == (256,)
    single = gym.make(env_id)
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space


def test_gymnasium_imports_the_package_by_the_id():
    code = (
        "import sys, gymnasium as gym\n"
        "assert 'kfenv' not in sys.modules\n"
        f"for name in {kfenv.ENVIRONMENTS!r}:\n"
        "    env = gym.make('kfenv:' + name)\n"
        "    assert env.observation_space.contains(env.reset(seed=0)[0])\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
