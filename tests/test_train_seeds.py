"""Training with several seeds: the runs of single seeds, kept whole, and their median."""

import json

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contestants.policy import NumpyPolicy
from kfenv.agents.learning.seeds import FIGURES, train_seeds
from typer.testing import CliRunner

ENV = "kfenv/RadarTracking-v0"


def pretend(seed, folder):
    """A training that comes to an error of its seed; that of 13 fails."""
    if seed == 13:
        raise RuntimeError("unlucky")
    (folder / "tensorboard").mkdir(parents=True)
    (folder / "tensorboard" / "events").write_text("log")
    results = [dict.fromkeys(FIGURES, 50.0), dict.fromkeys(FIGURES, 10.0 + seed)]
    (folder / "results.json").write_text(json.dumps(results))


def several(seeds, folder, processes=1, resume=False, told="ppo"):
    return train_seeds(pretend, {"algo": told}, seeds, folder, processes, resume, lambda seed: None)


@pytest.mark.parametrize("processes", [1, 2])
def test_each_seed_has_a_folder_and_the_median_is_told(tmp_path, processes):
    summary = several([0, 1, 7], tmp_path / "out", processes)
    assert summary == json.loads((tmp_path / "out" / "seeds.json").read_text())
    assert summary["rmse_median"] == {
        "each": [10.0, 11.0, 17.0], "median": 11.0, "least": 10.0, "greatest": 17.0
    }  # fmt: skip
    assert (tmp_path / "out" / "seed-7" / "tensorboard" / "events").read_text() == "log"


def test_finished_seeds_are_kept(tmp_path):
    folder = tmp_path / "out"
    with pytest.raises(RuntimeError, match="unlucky"):
        several([0, 13], folder)
    assert [path.name for path in folder.glob("seed-*")] == ["seed-0"]
    stamp = (folder / "seed-0" / "results.json").stat().st_mtime_ns
    with pytest.raises(FileExistsError, match="--resume"):
        several([0, 1], folder)
    with pytest.raises(ValueError, match="other runs"):
        several([0, 1], folder, resume=True, told="sac")
    assert several([0, 1], folder, resume=True)["seeds"] == [0, 1]
    assert (folder / "seed-0" / "results.json").stat().st_mtime_ns == stamp
    with pytest.raises(ValueError, match="Each seed once"):
        several([0, 0], folder)


def test_the_command_trains_as_with_single_seeds(tmp_path):
    pytest.importorskip("stable_baselines3")
    settings = tmp_path / "quick.toml"
    settings.write_text("num_envs = 8\nn_steps = 32\nminibatches = 2\nepochs = 1\n")
    common = ["train", ENV, "--steps", "256", "--config", settings, "--rate", "2",
              "--option", "duration=15"]  # fmt: skip
    command(*common, "--seeds", "3", "4", "--processes", "1", "--output", tmp_path / "several")
    command(*common, "--seed", "4", "--output", tmp_path / "single")
    several, single = (
        NumpyPolicy.load(tmp_path / folder / "policy.npz")
        for folder in ("several/seed-4", "single")
    )
    assert several.digest == single.digest
    told = json.loads((tmp_path / "several" / "seeds.json").read_text())
    assert told["seeds"] == [3, 4] and np.isfinite(told["rmse_geometric_mean"]["median"])


@pytest.mark.parametrize("arguments", [("7",), ("--seeds", "0-4"), ("--seeds", "1", "1")])
def test_what_are_no_seeds_is_told(tmp_path, arguments):
    pytest.importorskip("stable_baselines3")
    command("train", ENV, *arguments, "--output", tmp_path / "out", code=2)
    assert not (tmp_path / "out").exists()


def command(*arguments, code=0):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
