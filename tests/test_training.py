"""Training: the adapter tells the truth, runs repeat, stop, resume and refuse bad input."""

import itertools
import json
import signal

import gymnasium as gym
import numpy as np
import pytest
from dead_runs import die_writing, somebody_working_in
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from hypothesis import given
from hypothesis import strategies as st
from rollouts import BISTATIC, change, draw, make, short, truth_leaves

from kfenv.envs.options import REWARDS

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from kfenv.agents.contestants.policy import NumpyPolicy
from kfenv.agents.learning.reinforcement import checkpoints, training
from kfenv.agents.learning.reinforcement.scaling import scaling_for
from kfenv.agents.learning.reinforcement.stable_baselines import VectorEnvAdapter
from kfenv.agents.learning.reinforcement.training import TrainingInterrupted, train
from kfenv.agents.learning.settings import PPOSettings, read_settings
from stable_baselines3.common.monitor import Monitor

PENDULUM = "Pendulum-v1"
TINY = {
    "ppo": "n_steps = 16\nminibatches = 2\nepochs = 1",
    "sac": "train_every = 16\ngradient_steps = 1\nbatch_size = 8\nbuffer_size = 1000\n"
    "learning_starts = 64",
}


class Counting(VectorEnv):
    """Sub-environment i observes (i, t), earns i + t; 0 terminates at t=3, the others truncate
    at t=5, and 1 does both at once."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    render_mode = None

    def __init__(self, num_envs=4):
        self.num_envs = num_envs
        self.single_observation_space = gym.spaces.Box(-9, 99, (2,), np.float32)
        self.single_action_space = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed=None, options=None):
        self.seed_given, self.options_given = seed, options
        self.t = np.zeros(self.num_envs)
        return self._observe(), {}

    def step(self, actions):
        self.t += 1
        number = np.arange(self.num_envs)
        reward = number + self.t
        terminated = ((number == 0) & (self.t == 3)) | ((number == 1) & (self.t == 5))
        truncated = (number > 0) & (self.t == 5)
        done = terminated | truncated
        info = {"final_obs": self._observe(), "_final_obs": done} if done.any() else {}
        self.t[done] = 0
        return self._observe(), reward, terminated, truncated, info

    def _observe(self):
        return np.stack([np.arange(self.num_envs), self.t], axis=1).astype(np.float32)


def _adapted_steps(env, number):
    env.reset()
    action = np.zeros((env.num_envs, *env.action_space.shape), np.float32)
    return [env.step(action) for _ in range(number)]


def test_adapter_reports_the_last_observation_and_why_the_episode_ended():
    steps = _adapted_steps(VectorEnvAdapter(Counting()), 5)
    assert all(info == {} for info in steps[0][3])
    observation, _, done, infos = steps[2]
    assert done.tolist() == [True, False, False, False]
    assert infos[0]["terminal_observation"].tolist() == [0, 3]
    assert infos[0]["TimeLimit.truncated"] is False
    assert observation[0].tolist() == [0, 0]
    infos = steps[4][3]
    assert infos[0] == {}
    assert infos[1]["TimeLimit.truncated"] is False  # terminated as well
    assert infos[2]["TimeLimit.truncated"] is True
    assert infos[3]["terminal_observation"].tolist() == [3, 5]


def test_adapter_counts_return_and_length_of_each_episode_anew():
    steps = _adapted_steps(VectorEnvAdapter(Counting()), 10)
    for _, _, _, infos in (steps[4], steps[9]):
        assert [info["episode"]["r"] for info in infos[2:]] == [25.0, 30.0]
        assert [info["episode"]["l"] for info in infos[2:]] == [5, 5]
    assert steps[5][3][0]["episode"]["r"] == 6.0


def test_adapter_scales_and_limits_what_learning_sees_but_not_the_return():
    steps = _adapted_steps(VectorEnvAdapter(Counting(), reward_scale=0.5, reward_limit=2.0), 5)
    assert steps[0][1].tolist() == [0.5, 1.0, 1.5, 2.0]
    assert steps[4][1].max() == 2.0
    assert steps[4][3][3]["episode"]["r"] == 30.0


def test_adapter_lets_an_episode_end_in_time_if_told():
    steps = _adapted_steps(VectorEnvAdapter(Counting(), ends_in_time=True), 5)
    assert not any(info["TimeLimit.truncated"] for info in steps[4][3][1:])


def test_adapter_agrees_with_the_synchronous_vector_environment_under_it():
    how = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": "SameStep"}}
    plain = gym.make_vec(PENDULUM, num_envs=3, max_episode_steps=5, **how)
    adapter = VectorEnvAdapter(gym.make_vec(PENDULUM, num_envs=3, max_episode_steps=5, **how))
    adapter.seed(7)
    np.testing.assert_array_equal(adapter.reset(), plain.reset(seed=7)[0])
    for _ in range(11):
        actions = plain.action_space.sample()
        wanted, reward, _, truncated, info = plain.step(actions)
        got, learned, done, infos = adapter.step(actions)
        np.testing.assert_array_equal(got, wanted)
        np.testing.assert_array_equal(learned, reward.astype(np.float32))
        np.testing.assert_array_equal(done, truncated)
        for i in np.flatnonzero(done):
            np.testing.assert_array_equal(infos[i]["terminal_observation"], info["final_obs"][i])
            assert infos[i]["TimeLimit.truncated"]


def test_adapter_seeds_the_next_reset_once_and_answers_for_attributes():
    env = VectorEnvAdapter(Counting())
    assert env.seed(5) == [5, 6, 7, 8]
    env.reset()
    assert env.env.seed_given == 5
    env.reset()
    assert env.env.seed_given is None
    env.set_attr("note", 1)
    assert env.get_attr("note", indices=[0, 2]) == [1, 1]
    assert not env.has_attr("nonsense")
    assert env.env_is_wrapped(Monitor) == [True] * 4
    with pytest.raises(NotImplementedError, match="leave out indices"):
        env.set_attr("note", 2, indices=0)


def test_adapter_refuses_an_environment_that_resets_a_step_later():
    with pytest.raises(ValueError, match="SAME_STEP"):
        VectorEnvAdapter(gym.make_vec(PENDULUM, num_envs=1, vectorization_mode="sync"))


@pytest.fixture
def tiny(tmp_path):
    """Trains a very small agent on the pendulum; every argument can be replaced."""

    def run(output="run", algorithm="ppo", config=None, **arguments):
        path = tmp_path / f"{algorithm}.toml"
        path.write_text(config or f"hidden = [8]\ntorch_threads = 1\n{TINY[algorithm]}\n")
        wanted = {"env_id": PENDULUM, "steps": 512, "seed": 1, "num_envs": 4, "config_path": path}
        return train(output=tmp_path / output, algorithm=algorithm, **wanted | arguments)

    return run


@pytest.fixture
def press_ctrl_c(monkeypatch):
    """Press Ctrl-C, or send another signal, in the given vector step of the next run."""

    def at(step, number=signal.SIGINT):
        calls, original = iter(range(1, 10**6)), VectorEnvAdapter.step_wait

        def step_wait(self):
            if next(calls) == step:
                signal.raise_signal(number)
            return original(self)

        monkeypatch.setattr(VectorEnvAdapter, "step_wait", step_wait)

    return at


def _record(path):
    return json.loads((path / "training.json").read_text())


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_training_writes_all_that_is_promised(tiny, algorithm, tmp_path):
    policy = tiny(algorithm=algorithm, steps=500)
    folder = tmp_path / "run"
    assert policy == folder / "policy.npz"
    wanted = {"config.json", "checkpoint.zip", "policy.npz", "training.json", "tensorboard",
              ".lock"}  # fmt: skip
    wanted |= {"replay_buffer.pkl"} if algorithm == "sac" else set()
    assert {path.name for path in folder.iterdir()} == wanted
    config = json.loads((folder / "config.json").read_text())
    assert config["settings"]["num_envs"] == 4
    assert {"torch", "stable_baselines3", "kfenv"} < config["versions"].keys()
    record = _record(folder)
    assert record["finished"] and record["steps"] == 512  # whole updates of 64 steps
    assert [row["steps"] for row in record["curve"]] == list(range(64, 513, 64))
    assert any((folder / "tensorboard").iterdir())
    loaded = NumpyPolicy.load(policy)
    assert loaded.env_id == PENDULUM
    assert loaded.metadata["steps_done"] == 512


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_same_seed_same_policy(tiny, algorithm):
    one = tiny("one", algorithm).read_bytes()
    assert tiny("two", algorithm).read_bytes() == one
    assert tiny("three", algorithm, seed=2).read_bytes() != one


@pytest.mark.parametrize(
    ("algorithm", "number"),
    [("ppo", signal.SIGINT), ("sac", signal.SIGINT), ("ppo", signal.SIGTERM)],
)
def test_ctrl_c_saves_and_resume_ends_at_the_same_step(
    tiny, press_ctrl_c, algorithm, number, tmp_path
):
    press_ctrl_c(70, number)  # of 128: in the middle of a rollout of 16
    with pytest.raises(TrainingInterrupted, match=r"256 of 512 steps.*--resume"):
        tiny(algorithm=algorithm)
    record = _record(tmp_path / "run")
    assert record["steps"] == 256 and not record["finished"]
    tiny(algorithm=algorithm, resume=True)
    record = _record(tmp_path / "run")
    assert record["finished"] and record["steps"] == 512
    steps = [row["steps"] for row in record["curve"]]
    assert steps == sorted(set(steps)) and steps[-1] == 512


def test_ctrl_c_is_back_to_normal_after_a_run(tiny):
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.getsignal(number) for number in numbers]
    tiny()
    assert [signal.getsignal(number) for number in numbers] == before


def test_resume_keeps_the_replay_buffer(tiny, tmp_path):
    tiny(algorithm="sac")
    model = checkpoints.load_checkpoint(tmp_path / "run", "sac", _pendulum_adapter())
    assert model.replay_buffer.size() * model.n_envs == 512


def test_resume_without_a_buffer_that_was_too_large_gathers_a_new_one(tiny, monkeypatch, tmp_path):
    monkeypatch.setattr(checkpoints, "LARGEST_REPLAY_BUFFER", 100)
    with pytest.warns(UserWarning, match="too large to be saved"):
        tiny(algorithm="sac")
    assert not (tmp_path / "run" / "replay_buffer.pkl").exists()
    model = checkpoints.load_checkpoint(tmp_path / "run", "sac", _pendulum_adapter())
    assert model.learning_starts == 512 + 64


def _pendulum_adapter():
    settings = read_settings("sac", num_envs=4)
    return training.make_training_env(PENDULUM, {}, settings)


def test_checkpoints_come_every_so_many_steps(tiny, monkeypatch):
    saved = []
    original = checkpoints.Bookkeeper.save
    monkeypatch.setattr(
        checkpoints.Bookkeeper,
        "save",
        lambda self: (original(self), saved.append(self.model.num_timesteps)),
    )
    tiny(config="hidden = [8]\ncheckpoint_every = 128\n" + TINY["ppo"])
    assert saved == [128, 256, 384, 512]


def test_a_finished_run_can_be_given_more_steps(tiny, tmp_path):
    tiny()
    tiny(steps=1024, resume=True)
    assert _record(tmp_path / "run")["steps"] == 1024


def test_an_occupied_folder_is_refused_and_left_alone(tiny, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "thesis.txt").write_text("years of work")
    with pytest.raises(FileExistsError, match=r"choose another output.*--resume"):
        tiny()
    assert [path.name for path in folder.iterdir()] == ["thesis.txt"]


def test_resume_refuses_another_configuration_and_names_the_key(tiny, tmp_path):
    tiny()
    before = (tmp_path / "run" / "checkpoint.zip").read_bytes()
    cases = [
        ({"seed": 3}, "seed was 1 and is now 3"),
        ({"env_kwargs": {"g": 5.0}}, "env_kwargs.g was None and is now 5.0"),
        ({"num_envs": 8}, "settings.num_envs was 4 and is now 8"),
    ]
    for other, sentence in cases:
        with pytest.raises(ValueError, match=f"cannot resume.*{sentence}; give the former value"):
            tiny(resume=True, **other)
    assert (tmp_path / "run" / "checkpoint.zip").read_bytes() == before


def test_resume_refuses_a_folder_without_a_run_or_with_a_damaged_one(tiny, tmp_path):
    with pytest.raises(FileNotFoundError, match="no run to resume"):
        tiny(resume=True)
    assert not (tmp_path / "run").exists()
    tiny()
    checkpoint = tmp_path / "run" / "checkpoint.zip"
    checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"checkpoint .* is damaged"):
        tiny(resume=True)


def test_a_lost_checkpoint_is_no_silent_restart(tiny, tmp_path):
    policy = tiny()
    before = policy.read_bytes()
    (tmp_path / "run" / "checkpoint.zip").unlink()
    with pytest.raises(FileNotFoundError, match=r"lost its checkpoint.*put the checkpoint back"):
        tiny(resume=True)
    assert policy.read_bytes() == before


def test_a_damaged_record_is_named(tiny, tmp_path):
    tiny()
    for content in ("[]", "3", "{"):
        (tmp_path / "run" / "training.json").write_text(content)
        with pytest.raises(ValueError, match=r"training.json is damaged: delete it; the run goes"):
            tiny(resume=True)


def test_a_folder_takes_one_training_at_a_time_until_it_is_dead(tiny, tmp_path):
    tiny()
    with somebody_working_in(tmp_path / "run") as other:
        with pytest.raises(RuntimeError, match=rf"process {other} works in .*run: wait"):
            tiny(steps=1024, resume=True)
    assert _record(tmp_path / "run")["steps"] == 512
    tiny(steps=1024, resume=True)
    assert _record(tmp_path / "run")["steps"] == 1024


def test_a_training_that_was_killed_at_its_first_file_begins_anew(tiny, tmp_path):
    (tmp_path / "run").mkdir()
    die_writing(tmp_path / "run" / "config.json")
    tiny()
    assert not list((tmp_path / "run").glob(".config*"))


def test_bad_input_is_refused_before_anything_is_written(tiny, tmp_path):
    cases = [
        ({"config": "gama = 0.9"}, "gamma"),
        ({"config": "gamma = 1.5"}, "gamma = 1.5"),
        ({"config": "gamma = 'high'"}, "gamma = 'high'"),
        ({"config": "hidden = 64"}, "hidden = 64"),
        ({"config": "activation = 'tahn'"}, "tanh"),
        ({"config": "minibatches = 7"}, "minibatches = 7"),
        ({"config": "gamma == 1"}, "not a TOML file"),
        ({"num_envs": 0}, "num_envs = 0"),
        ({"steps": 0}, "steps = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"env_id": "Pendulun-v1"}, "Pendulum"),
        ({"env_id": "MountainCar-v0"}, "not a flat Box"),
    ]
    for arguments, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            tiny(**arguments)
    with pytest.raises(ValueError, match="ppo"):
        read_settings("pppo")
    assert not (tmp_path / "run").exists()


def test_bundled_settings_are_complete_and_use_large_minibatches():
    settings = read_settings("ppo")
    assert isinstance(settings, PPOSettings)
    assert settings.block // settings.minibatches >= 2048
    assert read_settings("sac").block > 0


@pytest.mark.parametrize("reward", REWARDS)
def test_losing_never_pays_as_learning_sees_it(reward):
    """A track lost, or barely kept to the end: as long before it as may be, or just before."""
    recording = draw(BISTATIC, [0], faults="none")
    scenario = make(BISTATIC).scenario
    deaf = change(recording, measurement=np.full_like(recording.measurement, np.nan))
    for lost_at, gamma in itertools.product((0, 39, 40), (None, 0.5)):
        learned = []
        for far in (2.0, 0.9):
            played = {"recording": truth_leaves(deaf, lost_at, scenario, far), "reward": reward}
            overrides = {"num_envs": 1} | ({} if gamma is None else {"gamma": gamma})
            settings = read_settings("ppo", None, reward, **overrides)
            env = training.make_training_env(BISTATIC, short(BISTATIC) | played, settings)
            env.reset()
            value, done, weight = 0.0, [False], 1.0
            while not done[0]:
                _, earned, done, infos = env.step(np.zeros((1, *env.action_space.shape)))
                value, weight = value + weight * float(earned[0]), weight * settings.gamma
            assert not infos[0]["TimeLimit.truncated"]  # or what follows would be valued
            learned.append(value)
        assert learned[0] <= learned[1] + 1e-6


@given(n=st.integers(1, 10_000), gamma=st.floats(0.0, 1.0, exclude_max=True))
def test_no_play_costs_more_than_the_loss_under_improvement(n, gamma):
    scale, limit, ends = scaling_for(BISTATIC, {"reward": "improvement"}, gamma)
    worst_play = scale * 3.0 * np.sum(gamma ** np.arange(n))
    assert ends and worst_play <= min(scale * 3.0 * n, limit) + 1e-9


@pytest.mark.parametrize("gamma", [0.9, 1.0])
@pytest.mark.parametrize("reward", ["rmse", "log-rmse"])
def test_a_return_is_learnt_whole(reward, gamma):
    """Nothing is cut, and an episode that earns the same in every decision has its return."""
    keywords = {"reward": reward, "duration": 4.0, "rate": 10.0, "decision_interval": 2}
    scale, limit, ends = scaling_for(BISTATIC, keywords, gamma)
    assert scale * np.sum(gamma ** np.arange(21)) == pytest.approx(21.0)
    assert limit == np.inf and ends


def test_a_discount_under_which_losing_is_free_is_refused(tiny, tmp_path):
    config = f"gamma = 1.0\n{TINY['ppo']}"
    for place in ({"env_id": BISTATIC}, {}):
        with pytest.raises(ValueError, match=r"gamma = 1.0 .* a lost track would cost nothing"):
            tiny(config=config, **place)
    assert not (tmp_path / "run").exists()


def test_settings_follow_the_reward(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text("gamma = 0.7\n[log-rmse]\ngamma = 0.8\n")
    assert read_settings("ppo", path, "log-rmse").gamma == 0.8
    assert read_settings("ppo", path, "improvement").gamma == 0.7
    assert read_settings("ppo", path).gamma == 0.7
    path.write_text("[log-rmse]\ngama = 0.8\n")
    with pytest.raises(ValueError, match="gamma"):
        read_settings("ppo", path, "log-rmse")
    path.write_text("[lograms]\ngamma = 0.8\n")
    with pytest.raises(ValueError, match="lograms"):
        read_settings("ppo", path, "log-rmse")


@pytest.mark.parametrize("reward", REWARDS)
def test_every_reward_trains_with_its_own_settings(tiny, reward, tmp_path):
    tiny(env_id=BISTATIC, env_kwargs={"reward": reward, "duration": 2.0})
    assert np.isfinite([row["mean_reward"] for row in _record(tmp_path / "run")["curve"]]).all()


def test_training_on_radar_tracking_uses_the_improvement_as_reward(tiny, tmp_path):
    options = {"faults": "none"}
    tiny(env_id="kfenv/RadarTracking-v0", env_kwargs=options)
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["env_kwargs"] == {"reward": "improvement", "faults": "none"}
    chosen = training.with_training_reward("kfenv:kfenv/RadarTracking-v0", {"reward": "rmse"})
    assert chosen == {"reward": "rmse"}
    assert training.with_training_reward(PENDULUM, {}) == {}
