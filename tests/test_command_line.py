"""The command line does what its help says, and complains in one sentence."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest
import typer
from kfenv.agents.bench import Row
from kfenv.agents.cli import speed
from kfenv.agents.cli.app import app
from kfenv.agents.cli.console import complaints
from numba import config
from typer.testing import CliRunner

ENV = "kfenv/RadarTracking-v0"
QUICK = ["--episodes", "3", "--tuning-trials", "2", "--tuning-episodes", "2", "--processes", "1",
         "--rate", "2", "--option", "duration=15"]  # fmt: skip


def kfenv(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_help_names_every_command():
    text = kfenv("--help").output
    for command in ("envs", "train", "evaluate", "suite", "leaderboard", "bench", "demo"):
        assert command in text


def test_who_resumes_training_is_told_that_it_runs_code():
    for command in ("train", "demo"):
        text = " ".join(re.sub("[^a-zA-Z-]", " ", kfenv(command, "--help").output).split())
        assert "Only with one of your own" in text and "pickles" in text


def test_bench_tells_its_rows_as_a_table_or_as_json(monkeypatch):
    row = Row("engine", "5 steps/s", "2 x another", "1 x")
    monkeypatch.setattr(speed, "_own", lambda advance: [row])
    assert all(part in kfenv("bench").output for part in row)
    assert json.loads(kfenv("bench", "--json").output) == [row._asdict()]


def test_envs_lists_every_id():
    output = kfenv("envs").output
    assert ENV in output and "kfenv/RadarValidation-v0" in output


def test_evaluate_writes_results_and_figures(tmp_path):
    folder = tmp_path / "out"
    result = kfenv("evaluate", ENV, "--agent", "huber-gate", "--output", folder, *QUICK)
    assert result.exit_code == 0, result.output
    results = json.loads((folder / "results.json").read_text())
    assert [r["agent"] for r in results] == ["fixed", "fixed-tuned", "huber-gate"]
    assert results[0]["env_kwargs"] == {"duration": 15, "rate": 2.0}
    for figure in ("rmse.png", "improvement.png", "episode.png"):
        assert (folder / figure).read_bytes().startswith(b"\x89PNG")
    assert "huber-gate" in result.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--agent", "hubergate"], "Did you mean 'huber-gate'"),
        (["--option", "fualts=1"], "Did you mean 'faults'"),
        (["--faults", '{"jaming": {}}'], "Did you mean 'jamming'"),
        (["--rate", "-2"], "rate"),
        (["--option", "rate"], "KEY=VALUE"),
        (["--track", "no_such.csv"], "no_such.csv"),
        (["--executor", "processses"], "Did you mean 'processes'"),
        (["--agent", __file__], "test_command_line.py"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(tmp_path, arguments, said):
    folder = tmp_path / "out"
    result = kfenv("evaluate", ENV, "--output", folder, *arguments)
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())
    assert "Traceback" not in result.output
    assert not folder.exists()


def test_an_output_folder_that_exists_is_refused(tmp_path):
    (tmp_path / "mine").write_text("")
    for command in (["evaluate", ENV], ["train", ENV], ["demo"]):
        result = kfenv(*command, "--output", tmp_path)
        assert result.exit_code == 2 and "resume" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_unknown_environment_is_named(tmp_path):
    result = kfenv("evaluate", "kfenv/RadarTraking-v0", "--output", tmp_path / "out")
    assert result.exit_code == 2 and "RadarTracking" in result.output


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    folder = tmp_path_factory.mktemp("training") / "agent"
    settings = folder.with_name("quick.toml")
    settings.write_text("num_envs = 8\nn_steps = 32\nminibatches = 2\nepochs = 1\n")
    result = kfenv("train", ENV, "--steps", 256, "--output", folder, "--config", settings,
                   "--rate", 2, "--option", "duration=15",
                   "--option", 'actions=["measurement_noise"]')  # fmt: skip
    assert result.exit_code == 0, result.output
    return folder


def test_a_trained_policy_can_be_contested(trained, tmp_path):
    folder = tmp_path / "out"
    result = kfenv("evaluate", ENV, "--agent", f"mine={trained}", "--output", folder, *QUICK)
    assert result.exit_code == 0, result.output
    names = [r["agent"] for r in json.loads((folder / "results.json").read_text())]
    assert names == ["fixed", "fixed-tuned", "mine"]


def test_a_damaged_cache_of_compiled_code_is_told_in_a_sentence(tmp_path, monkeypatch, capsys):
    module = tmp_path / "compiled_once.py"
    module.write_text("from numba import njit\n\n@njit(cache=True)\ndef f(x):\n    return x + 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(config, "CACHE_DIR", "")  # beside the module, wherever others are kept
    assert importlib.import_module("compiled_once").f(1) == 2
    [index] = tmp_path.rglob("*.nbi")
    for content in (b"", index.read_bytes()[:40]):
        index.write_bytes(content)
        sys.modules.pop("compiled_once")
        with pytest.raises(typer.Exit), complaints():
            importlib.import_module("compiled_once").f(1)
        told = capsys.readouterr().err
        assert "set NUMBA_CACHE_DIR" in told and "delete all *.nbi files" in told


def test_where_no_cache_can_be_written_the_command_line_says_what_to_set(tmp_path):
    nowhere = (
        "from numba.core import caching; caching.CacheImpl._locator_classes = []; "
        "from kfenv.agents.cli.app import app; app()"
    )
    command = [sys.executable, "-c", nowhere, "evaluate", ENV, "--output", str(tmp_path / "out")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 2 and "Traceback" not in run.stderr
    assert "set NUMBA_CACHE_DIR to a new folder" in run.stderr


def test_ctrl_c_in_training_keeps_a_checkpoint_and_resumes(tmp_path):
    pytest.importorskip("stable_baselines3")
    folder, settings = tmp_path / "agent", tmp_path / "quick.toml"
    settings.write_text("num_envs = 8\nn_steps = 32\nminibatches = 2\nepochs = 1\n")
    command = [sys.executable, "-m", "kfenv.agents.cli", "train", ENV, "--output", str(folder),
               "--config", str(settings), "--rate", "2", "--option", "duration=15"]  # fmt: skip
    process = subprocess.Popen([*command, "--steps", "100000000"], stderr=subprocess.PIPE)
    deadline = time.monotonic() + 300.0
    while not (folder / "tensorboard").exists() and time.monotonic() < deadline:
        time.sleep(0.2)
    time.sleep(2.0)
    os.kill(process.pid, signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 130
    assert b"Traceback" not in errors
    assert (folder / "checkpoint.zip").exists()
    done = json.loads((folder / "training.json").read_text())["steps"]
    again = subprocess.run(
        [*command, "--steps", str(done + 256), "--resume"], capture_output=True, timeout=300
    )
    assert again.returncode == 0, again.stderr.decode()
    assert json.loads((folder / "training.json").read_text())["steps"] >= done + 256
