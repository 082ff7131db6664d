"""Recorded episodes are those of the environment: whoever repeats the actions meets them again."""

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest import dataset
from kfenv.agents.contest.dataset import Order, write_dataset
from typer.testing import CliRunner

import kfenv  # noqa: F401
from kfenv.envs.knobs import WIDEST_FADING

ENV, SHORT = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 8.0, "reward": "improvement"}


def load(folder, name, monkeypatch):
    monkeypatch.setenv(dataset.ROOT, str(folder))
    return pytest.importorskip("minari").load_dataset(name)


@pytest.mark.parametrize(("agent", "processes"), [("clairvoyant", 1), ("random", 2)])
def test_episodes_can_be_repeated(agent, processes, tmp_path, monkeypatch):
    pytest.importorskip("minari", reason="needs Minari: pip install -e '.[dataset]'")
    monkeypatch.setattr(dataset, "BLOCK", 3)
    name = write_dataset(Order(ENV, SHORT, agent, 7, seed=5), tmp_path / "out", processes)
    found = load(tmp_path / "out", name, monkeypatch)
    assert found.total_episodes == 7 and found.storage.metadata["algorithm_name"] == agent
    env = found.recover_environment().unwrapped
    knobs = {"most_fading": WIDEST_FADING} if agent == "clairvoyant" else {}
    assert (
        env.spec.id == ENV
        and env.core.knobs == gym.make(ENV, **SHORT, **knobs).unwrapped.core.knobs
    )
    for i, episode in enumerate(found.iterate_episodes()):
        observations, rewards = [env.reset(seed=5 + i)[0]], []
        for action in episode.actions:
            observation, reward, terminated, truncated, _ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        np.testing.assert_array_equal(observations, episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        assert (terminated, truncated) == (episode.terminations[-1], episode.truncations[-1])
        assert not (episode.terminations[:-1].any() or episode.truncations[:-1].any())


def test_what_cannot_be_recorded_is_told(tmp_path):
    pytest.importorskip("minari", reason="needs Minari: pip install -e '.[dataset]'")
    for arguments, said in (
        (("--agent", "imm"), "takes no actions"),
        (("--agent", "clairvoyan"), "Did you mean 'clairvoyant'"),
        (("--option", "fualts=1"), "Did you mean 'faults'"),
    ):
        command = ("dataset", ENV, "--output", str(tmp_path / "out"), *arguments)
        told = CliRunner().invoke(app, command)
        assert told.exit_code == 2 and said in " ".join(told.output.split())
    assert not list(tmp_path.iterdir())
