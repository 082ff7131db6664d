"""RLlib and TorchRL take the vector environments as they are; what would spoil them is refused.

The recipes run where their libraries are: in an environment of its own for each (RLlib pins an
older Gymnasium), `pip install -e '.[rllib,test]'` or `'.[torchrl,test]'`, then
``pytest -n 0 -m slow tests/test_other_learners.py``.
"""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.contestants.learned import Learned
from kfenv.agents.contestants.policy import write_perceptron
from kfenv.agents.learning.rllib import WorkerStreams

import kfenv  # noqa: F401

ENV, SHORT = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 6.0}
RECIPES = Path(__file__).parents[1] / "notebooks"


def made(worker, seed=None, **keywords):
    """A worker's environment when RLlib has made it."""
    env = gym.make_vec(ENV, num_envs=3, **SHORT, **keywords)
    runner = SimpleNamespace(worker_index=worker, config=SimpleNamespace(seed=seed))
    WorkerStreams(seed=0)(env_runner=runner, env=env, env_context={}, metrics_logger=None)
    return env


def test_workers_of_rllib_share_no_episode():
    """By RLlib's own seeds worker 1 would begin with the episodes of 2 that follow its first."""
    begun = np.concatenate([made(worker).reset()[1]["truth"] for worker in (1, 2, 3)])
    assert len(np.unique(begun, axis=0)) == 9
    np.testing.assert_array_equal(begun[3:6], made(2).reset()[1]["truth"])
    plain = [gym.make_vec(ENV, num_envs=3, **SHORT).reset(seed=w)[1]["truth"] for w in (1, 2)]
    np.testing.assert_array_equal(plain[0][1:], plain[1][:-1])


def test_what_rllib_would_spoil_is_refused():
    with pytest.raises(ValueError, match="needs autoreset_mode='next_step'"):
        made(1, autoreset_mode="same_step")
    with pytest.raises(ValueError, match=r"debugging\(seed=None\)"):
        made(1, seed=3)


def test_a_perceptron_of_any_library_becomes_a_policy(tmp_path):
    rng = np.random.default_rng(0)
    layers = [
        (rng.normal(size=(8, 29)), rng.normal(size=8)),
        (rng.normal(size=(10, 8)), np.ones(10)),
    ]
    policy = Learned(write_perceptron(tmp_path / "mine.npz", layers, 5, ENV, SHORT)).policy
    seen = rng.normal(size=(4, 29)).astype(np.float32)
    expected = np.tanh(seen @ layers[0][0].T + layers[0][1]) @ layers[1][0].T[:, :5] + 1.0
    np.testing.assert_allclose(policy.predict(seen), np.clip(expected, -1.0, 1.0), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("recipe", "library"), [("rllib", "ray.rllib"), ("torchrl", "torchrl")])
def test_a_recipe_trains_and_its_policy_plays(recipe, library, tmp_path):
    pytest.importorskip(library, reason=f"needs {recipe}: pip install -e '.[{recipe}]'")
    script = RECIPES / f"{recipe}_ppo.py"
    assert len(script.read_text().splitlines()) <= 30
    policy = tmp_path / "policy.npz"
    run = [sys.executable, str(script), "20000", str(policy)]
    subprocess.run(run, check=True, timeout=600)
    agent = Learned(policy)
    env = gym.make(ENV, rate=2.0)
    agent.check_fits(env.unwrapped.core)
    assert np.isfinite(agent.policy.predict(env.reset(seed=0)[0])).all()


@pytest.mark.slow
def test_torchrl_refuses_what_it_cannot_take_and_resets_by_mask():
    pytest.importorskip("torchrl", reason="needs TorchRL: pip install -e '.[torchrl]'")
    from torchrl.envs import GymWrapper

    with pytest.raises(RuntimeError, match="SAME_STEP or DISABLED"):
        GymWrapper(gym.make_vec(ENV, num_envs=3, **SHORT))
    env = GymWrapper(gym.make_vec(ENV, num_envs=3, autoreset_mode="disabled", **SHORT))
    played = env.rollout(30, break_when_any_done=False)
    assert played["next", "done"].sum() >= 6 and played["observation"].isfinite().all()
