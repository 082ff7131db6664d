"""Learning that goes on from a taught policy, and recurrent learning."""

import json
import sys

import numpy as np
import pytest
from policies import RADAR, trained_on
from rollouts import BISTATIC

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contestants.learned import Learned
from kfenv.agents.contestants.policy import NumpyPolicy
from kfenv.agents.learning.reinforcement.models import model_class
from kfenv.agents.learning.reinforcement.training import train

SHORT = {"duration": 2.0, "actions": ["fading", "measurement_noise"]}
OF_PPO = "n_steps = 16\nminibatches = 2\nepochs = 1\n"
TINY = {
    "ppo": OF_PPO,
    "recurrent-ppo": OF_PPO,
    "sac": "train_every = 16\ngradient_steps = 1\nbatch_size = 8\nbuffer_size = 1000\n"
    "learning_starts = 64\n",
}
STILL = "learning_rate = 0.0\nfinal_learning_rate = 0.0\n"
FROM = {"ppo": "mlp-log-factors", "sac": "mlp-log-factors", "recurrent-ppo": "gru"}


@pytest.fixture(params=FROM)
def algorithm(request):
    if request.param == "recurrent-ppo":
        pytest.importorskip("sb3_contrib")
    return request.param


@pytest.fixture
def go(tmp_path):
    """Trains for a moment; every argument can be replaced."""

    def run(algorithm, output="run", config="", **arguments):
        path = tmp_path / "own.toml"
        path.write_text(f"hidden = [8]\n{TINY[algorithm]}{config}")
        wanted = {"env_id": BISTATIC, "steps": 256, "seed": 1, "num_envs": 4, "config_path": path}
        return train(output=tmp_path / output, algorithm=algorithm, **wanted | arguments)

    return run


@pytest.fixture
def taught(tmp_path):
    return lambda kind: trained_on(tmp_path / "taught.npz", BISTATIC, kind, **SHORT)


def _parameters(path):
    return NumpyPolicy.load(path).network.parameters


def test_a_run_starts_from_the_policy_itself(algorithm, go, taught):
    start = taught(FROM[algorithm])
    left = go(algorithm, config=STILL, init=start, env_kwargs={"duration": 2.0})
    for before, after in zip(_parameters(start), _parameters(left), strict=True):
        np.testing.assert_array_equal(before, after)
    policy = NumpyPolicy.load(left)
    assert policy.knobs == NumpyPolicy.load(start).knobs
    assert policy.env_kwargs["actions"] == SHORT["actions"]  # the policy's own, not given again


def test_the_model_acts_as_its_policy_does_and_learns(algorithm, go, taught):
    start = taught(FROM[algorithm])
    path = go(algorithm, init=start)
    policy, model = NumpyPolicy.load(path), model_class(algorithm).load(path.parent / "checkpoint")
    assert np.abs(_parameters(start)[0] - _parameters(path)[0]).max() == 0.0  # the features' mean
    assert any((a != b).any() for a, b in zip(_parameters(start), _parameters(path), strict=True))
    rng, state, memory = np.random.default_rng(0), None, policy.start(6)
    for _ in range(10):
        seen = rng.normal(0.0, 2.0, (6, policy.observation_size)).astype(np.float32)
        wanted, memory = policy.decide(seen, memory)
        acted, state = model.predict(seen, state, deterministic=True)
        limit = 0.999 if algorithm == "sac" else 1.0
        np.testing.assert_allclose(acted, wanted.clip(-limit, limit), atol=1e-5)


def test_a_run_from_a_policy_resumes_with_the_same_policy_only(algorithm, go, taught, tmp_path):
    start = taught(FROM[algorithm])
    go(algorithm, init=start)
    go(algorithm, init=start, steps=512, resume=True)
    assert json.loads((tmp_path / "run" / "training.json").read_text())["steps"] == 512
    with pytest.raises(ValueError, match=r"init was '.*' and is now None"):
        go(algorithm, steps=512, env_kwargs={"actions": SHORT["actions"]}, resume=True)


def test_recurrent_learning_from_scratch_repeats_and_can_be_contested(go):
    pytest.importorskip("sb3_contrib")
    first = go("recurrent-ppo", "first", env_kwargs=SHORT)
    second = go("recurrent-ppo", "second", env_kwargs=SHORT)
    assert NumpyPolicy.load(first).digest == NumpyPolicy.load(second).digest
    agent = Learned(first)
    assert agent.policy.start(1).shape == (1, 8)
    episodes = draw_episodes(BISTATIC, SHORT, "test", 0, 2)
    assert np.isfinite(rollout(agent, BISTATIC, SHORT, episodes).rmse).all()


def test_a_missing_library_is_named(go, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    monkeypatch.delitem(sys.modules, "kfenv.agents.learning.reinforcement.recurrent", raising=False)
    with pytest.raises(ValueError, match="recurrent-ppo needs sb3-contrib"):
        go("recurrent-ppo")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("algorithm", "kind", "said"),
    [("ppo", "gru", "has a memory: start recurrent-ppo"),
     ("sac", "gru", "has a memory: start recurrent-ppo"),
     ("recurrent-ppo", "mlp-log-factors", "has no memory: start ppo or sac")],
)  # fmt: skip
def test_a_policy_of_the_wrong_kind_is_refused(algorithm, kind, said, go, taught, tmp_path):
    with pytest.raises(ValueError, match=said):
        go(algorithm, init=taught(kind))
    assert not (tmp_path / "run").exists()


def test_a_policy_of_another_environment_is_refused(go, tmp_path):
    start = trained_on(tmp_path / "taught.npz", RADAR, "mlp-log-factors")
    with pytest.raises(ValueError, match=f"was trained on {RADAR}, and this is BistaticTracking"):
        go("ppo", init=start)
    start = trained_on(tmp_path / "taught.npz", BISTATIC, "mlp-log-factors", **SHORT)
    with pytest.raises(ValueError, match="its observation had"):
        go("ppo", init=start, env_kwargs={"actions": ["fading"]})
    with pytest.raises(ValueError, match="kind 'mlp' is not the one to start from here"):
        go("ppo", "again", init=go("ppo"))
    for algorithm in ("recurrent-ppo", "ppo"):
        with pytest.raises(ValueError, match="for environments of kfenv"):
            go(algorithm, "again", init=start, env_id="Pendulum-v1")
