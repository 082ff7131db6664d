"""Killed at any file operation, a command goes on with --resume and ends as if it had not been.

The ordinary tests kill at a few operations of each; ``pytest -m slow`` at every one.
"""

import json
import re

import numpy as np
import pytest
from dying import be_killed, die, operations
from kfenv.agents.cli import demo as demo_command
from kfenv.agents.contest.contest import Contest
from kfenv.agents.contest.evaluation import evaluate
from kfenv.agents.contest.suite_run import SuiteRun, run_suite
from kfenv.agents.contest.suites import SUITES, Case, Suite
from kfenv.agents.reproduction.experiments import reproduce
from rich.progress import Progress

LINEAR, SHORT = "kfenv/BistaticTracking-v0", {"duration": 2.0}
SEVERAL = 5  # operations that the ordinary tests kill at, besides the first and the last

slow = pytest.mark.slow


def evaluated(folder):
    contest = Contest(LINEAR, SHORT, ("huber-gate",), 3, 0, tuning_episodes=2, tuning_trials=2)
    evaluate(contest, folder, processes=1, resume=folder.exists())


@pytest.fixture
def suite(monkeypatch):
    suite = Suite(
        1, "", LINEAR, {"faults": "random"} | SHORT, {"quiet": Case("", {"faults": "none"}, 3)},
        episodes=3, tuning_episodes=2, tuning_trials=2,
    )  # fmt: skip
    monkeypatch.setitem(SUITES, "tiny", suite)
    return lambda folder: run_suite(SuiteRun("tiny", ()), folder, 1, resume=folder.exists())


def reproduced(folder):
    with Progress(disable=True) as bar:
        reproduce(("E5",), folder, 4, 0, 1, folder.exists(), bar)


def trained(algorithm):
    pytest.importorskip("stable_baselines3")
    from kfenv.agents.learning.reinforcement.training import train

    def run(folder):
        config = folder.parent / "config.toml"
        own = "n_steps = 16\nminibatches = 2\nepochs = 1"
        if algorithm == "sac":
            own = "train_every = 16\ngradient_steps = 1\nbatch_size = 8\nbuffer_size = 1000\n"
            own += "learning_starts = 64"
        config.write_text(f"hidden = [8]\ntorch_threads = 1\ncheckpoint_every = 128\n{own}\n")
        train(
            "Pendulum-v1", algorithm=algorithm, steps=512, seed=1, output=folder, num_envs=4,
            config_path=config, resume=(folder / "config.json").exists(), progress=False,
        )  # fmt: skip

    return run


def taught(folder):
    pytest.importorskip("torch")
    from kfenv.agents.learning.teaching.course import Curriculum
    from kfenv.agents.learning.teaching.training import teach

    teach(
        LINEAR, Curriculum(updates=4), seed=0, output=folder, env_kwargs=SHORT, progress=False,
        resume=(folder / "config.json").exists(), episodes=6, epochs=1, rounds=2, units=4,
        refined_episodes=4, chunk=10, tuning_trials=0, checkpoint_every=2,
    )  # fmt: skip


@pytest.fixture
def demo(monkeypatch):
    """A demonstration of few episodes and lessons."""
    pytest.importorskip("torch")
    for name, value in (
        ("RIVALS", ("huber-gate",)), ("TUNING_EPISODES", 2), ("TUNING_TRIALS", 2), ("UPDATES", 2),
        ("SHORT", {"units": 4, "episodes": 6, "rounds": 1, "epochs": 1, "tuning_trials": 0}),
    ):  # fmt: skip
        monkeypatch.setattr(demo_command, name, value)
    real = demo_command.run_contest

    def alone(*arguments):  # workers of other processes do not write
        *most, _, resume = arguments
        real(*most, 1, resume)

    monkeypatch.setattr(demo_command, "run_contest", alone)
    return lambda folder: demo_command.demo(folder, 0, 3, folder.exists())


def outcome(folder):
    """All results below a folder, without what time, machine and folder put into them."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix == ".json":
            text = re.sub(r'"(seconds|cost|steps_per_second)": [^,}\]]*', "", path.read_text())
            found[name] = text.replace(str(folder), "")
        elif path.suffix == ".npz" and path.parent.name == "scores":
            with np.load(path) as file:
                found[name] = [file[key].tolist() for key in ("rmse", "lost", "values")]
        elif path.suffix in (".md", ".npz"):
            found[name] = None  # it is there
    return json.dumps(found)


def killed_and_resumed(run, tmp_path, several):
    """Kill a run at some of its operations, or all, resume it each time, and compare."""
    run(whole := tmp_path / "whole")
    count = len(operations(run, tmp_path / "counted"))
    wanted = outcome(whole)
    assert outcome(tmp_path / "counted") == wanted
    places = range(count) if several is None else {
        *np.linspace(0, count - 1, several + 2).astype(int).tolist()
    }  # fmt: skip
    for place in places:
        folder = tmp_path / str(place)
        die(run, folder, place)
        run(folder)
        assert outcome(folder) == wanted, place
        assert not list(folder.rglob("*.partial")), place
        yield folder


def consume(found):
    for _ in found:
        pass


def test_evaluate(tmp_path):
    consume(killed_and_resumed(evaluated, tmp_path, SEVERAL))


def test_suite(suite, tmp_path):
    consume(killed_and_resumed(suite, tmp_path, SEVERAL))


def test_taught(tmp_path):
    consume(killed_and_resumed(taught, tmp_path, 1))


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_trained_loses_no_more_than_its_last_interval(algorithm, tmp_path):
    kills_in_training(algorithm, tmp_path, 2)


def kills_in_training(algorithm, tmp_path, several):
    """The episodes after a resume are new ones, so that the end is alike but not the same."""
    run = trained(algorithm)
    done = operations(run, tmp_path / "whole")
    places = range(len(done)) if several is None else {
        *np.linspace(0, len(done) - 1, several + 2).astype(int).tolist()
    }  # fmt: skip
    for place in places:
        folder = tmp_path / str(place)
        before = die(run, folder, place)
        saved = sum(event == "os.rename" and ".checkpoint.zip." in name for event, name in before)
        again = operations(run, folder)
        saves = sum(event == "os.rename" and ".checkpoint.zip." in name for event, name in again)
        assert saves == max(1, 4 - saved), place  # the intervals that were left, or the end alone
        record = json.loads((folder / "training.json").read_text())
        assert record["finished"] and record["steps"] == 512, place
        steps = [row["steps"] for row in record["curve"]]
        assert steps == sorted(set(steps)), place
        assert steps[-1] >= (512 - 128 if saved == 4 else 512), place  # the curve of an interval
        assert not list(folder.rglob("*.partial")), place


def test_killed_indeed(tmp_path):
    """By the system, in a process of its own."""
    evaluated(whole := tmp_path / "whole")
    folder = tmp_path / "killed"
    code = "from pathlib import Path; from test_kills import evaluated; evaluated(Path(folder))"
    be_killed(code, folder, 7)
    evaluated(folder)
    assert outcome(folder) == outcome(whole) and not list(folder.rglob("*.partial"))


@slow
@pytest.mark.parametrize("name", ["evaluate", "suite", "reproduce", "taught", "demo"])
def test_killed_at_every_operation(name, request, tmp_path):
    own = {"evaluate": evaluated, "reproduce": reproduced, "taught": taught}
    run = own[name] if name in own else request.getfixturevalue(name)
    consume(killed_and_resumed(run, tmp_path, None))


@slow
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_trained_and_killed_at_every_operation(algorithm, tmp_path):
    kills_in_training(algorithm, tmp_path, None)
