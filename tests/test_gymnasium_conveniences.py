"""What users of Gymnasium and Stable-Baselines3 put around an environment works around ours."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from rollouts import every_environment, make_vec, random_actions

ENV, SHORT = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 6.0}  # thirteen decisions


def single(**keywords):
    return gym.make(ENV, **SHORT, **keywords)


def vector(count=2, **keywords):
    return gym.make_vec(ENV, num_envs=count, **SHORT, **keywords)


def to_the_end(env):
    """Every step's observation of one episode of the nominal filter, and the last info."""
    observations, over = [env.reset(seed=1)[0]], False
    while not over:
        observation, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape))
        observations.append(observation)
        over = terminated or truncated
    return observations, info


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_a_limit_of_steps_ends_vectors_as_it_ends_single_ones(mode):
    one = single(max_episode_steps=5)
    assert len(to_the_end(one)[0]) == 6
    many = vector(max_episode_steps=5, autoreset_mode=mode)
    assert many.spec.kwargs["max_episode_steps"] == 5
    first = many.reset(seed=1)[0]
    heard = [many.step(np.zeros(many.action_space.shape)) for _ in range(5)]
    assert [list(truncated) for _, _, _, truncated, _ in heard] == [[False] * 2] * 4 + [[True] * 2]
    assert not any(terminated.any() for _, _, terminated, _, _ in heard)
    np.testing.assert_array_equal(first[0], to_the_end(one)[0][0])
    if mode == AutoresetMode.DISABLED:
        many.reset()
    more = 5 + (mode == AutoresetMode.NEXT_STEP)
    assert [many.step(np.zeros(many.action_space.shape))[3].any() for _ in range(more)] == [
        *[False] * (more - 1), True
    ]  # fmt: skip


def test_a_limit_below_one_is_refused():
    with pytest.raises(ValueError, match="max_episode_steps must be positive"):
        vector(max_episode_steps=0)


@every_environment
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_without_infos_everything_else_is_the_same(env_id, mode):
    told, silent = (make_vec(env_id, 3, autoreset_mode=mode, info=i) for i in ("full", "none"))
    np.testing.assert_array_equal(told.reset(seed=0)[0], silent.reset(seed=0)[0])
    assert silent.reset(seed=0)[1] == {} != told.reset(seed=0)[1]
    for actions in random_actions(told.action_space.shape, 45):
        heard, echo = told.step(actions), silent.step(actions)
        for a, b in zip(heard[:4], echo[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        assert set(echo[4]) <= {"final_obs", "_final_obs"}
        for i in np.flatnonzero(echo[4].get("_final_obs", np.zeros(3, bool))):
            np.testing.assert_array_equal(heard[4]["final_obs"][i], echo[4]["final_obs"][i])
    with pytest.raises(ValueError, match="Did you mean 'none'"):
        make_vec(env_id, 3, info="nome")


def test_time_aware_observation():
    env = wrappers.TimeAwareObservation(single(max_episode_steps=12), normalize_time=True)
    observations, _ = to_the_end(env)
    assert [observation in env.observation_space for observation in observations] == [True] * 13
    np.testing.assert_allclose([o[-1] for o in observations], np.arange(13) / 12.0)


def test_episode_statistics_of_single_ones_and_vectors():
    rewards, env = [], wrappers.RecordEpisodeStatistics(single())
    env.reset(seed=1)
    while "episode" not in (step := env.step(np.zeros(env.action_space.shape)))[4]:
        rewards.append(step[1])
    rewards.append(step[1])
    told = step[4]["episode"]
    assert told["l"] == len(rewards) == 13 and told["r"] == pytest.approx(sum(rewards))
    for keywords in ({}, {"info": "none"}):
        many = wrappers.vector.RecordEpisodeStatistics(vector(**keywords))
        many.reset(seed=1)
        while "episode" not in (info := many.step(np.zeros(many.action_space.shape))[4]):
            continue
        assert info["episode"]["l"][0] == 13
        assert info["episode"]["r"][0] == pytest.approx(told["r"])


def test_normalised_observations_and_rewards():
    env = wrappers.NormalizeReward(wrappers.NormalizeObservation(single()))
    assert np.isfinite(to_the_end(env)[0]).all()
    many = wrappers.vector.NormalizeObservation(vector(8))
    many.reset(seed=1)
    seen = [many.step(np.zeros(many.action_space.shape))[0] for _ in range(11)]
    assert np.abs(np.mean(seen[-1])) < 1.0 and np.std(seen[-1]) < 3.0


def test_record_video(tmp_path):
    pytest.importorskip("moviepy", reason="RecordVideo needs moviepy")
    env = wrappers.RecordVideo(single(render_mode="rgb_array"), str(tmp_path))
    to_the_end(env)
    env.close()
    [film] = tmp_path.glob("*.mp4")
    assert film.stat().st_size > 1000


# What a hyperparameter file of rl-zoo3 holds for an environment.
ZOO = {
    "n_envs": 4,
    "n_timesteps": 128,
    "policy": "MlpPolicy",
    "normalize": True,
    "env_wrapper": wrappers.TimeAwareObservation,
    "n_steps": 16,
    "batch_size": 32,
    "n_epochs": 1,
    "gamma": 0.99,
    "learning_rate": 3e-4,
    "policy_kwargs": {"net_arch": {"pi": [8], "vf": [8]}},
}


def test_hyperparameters_of_rl_zoo3_and_vec_normalize(tmp_path):
    baselines = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    given = dict(ZOO)
    count, steps, wrapper = (given.pop(key) for key in ("n_envs", "n_timesteps", "env_wrapper"))
    keywords = SHORT | {"max_episode_steps": 12}  # which TimeAwareObservation wants to know
    env = make_vec_env(ENV, count, seed=0, env_kwargs=keywords, wrapper_class=wrapper)
    env = VecNormalize(env) if given.pop("normalize") else env
    model = baselines.PPO(env=env, seed=0, device="cpu", **given).learn(steps)
    assert model.num_timesteps == steps
    env.save(str(tmp_path / "statistics.pkl"))
    again = make_vec_env(ENV, count, seed=0, env_kwargs=keywords, wrapper_class=wrapper)
    again = VecNormalize.load(str(tmp_path / "statistics.pkl"), again)
    assert np.isfinite(model.predict(again.reset())[0]).all()
