"""Contests on windows of a real inertial log: what is told, and what is refused (about 3 s)."""

import json

import pytest
from inertial_logs import drive
from kfenv.agents.cli.app import app
from typer.testing import CliRunner

INERTIAL = "kfenv/InsGnss-v0"
AGENTS = (
    "innovation-fading", "innovation-fading-printed", "huber-gate", "innovation-noise",
    "pooled-noise", "hmm-noise", "hmm-turn",
)  # fmt: skip


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    return drive()[0].write(tmp_path_factory.mktemp("log"))


def on_log(command, paths, output, *options):
    arguments = [
        command, INERTIAL, "--option", f"log={json.dumps(paths)}", "--output", str(output),
        "--rate", "10", *options,
    ]  # fmt: skip
    return CliRunner().invoke(app, arguments)


def contest(paths, output, duration, *options):
    few = ("--episodes", "6", "--tuning-trials", "0", "--processes", "1")
    return on_log("evaluate", paths, output, "--option", f"duration={duration}", *few, *options)


def test_a_contest_says_that_its_episodes_are_windows(paths, tmp_path):
    told = contest(paths, tmp_path / "out", 80)
    assert told.exit_code == 0, told.output
    assert "5 of 6 asked windows of a real log" in told.output
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    names = {result["agent"] for result in results}
    assert names == {"fixed", *AGENTS, "random"}  # nobody knows the log's noise
    assert all(result["episodes"] == 5 and result["episodes_asked"] == 6 for result in results)


@pytest.mark.parametrize(("files", "duration", "options", "said"), [
    (3, 80, ("--faults", "{}"), "gives 1 window for test"),
    (2, 40, ("--faults", "none"), "longer outages"),
])  # fmt: skip
def test_a_contest_that_a_log_cannot_give_is_refused_before_it_begins(
    paths, tmp_path, files, duration, options, said
):
    told = contest(paths[:files], tmp_path / "out", duration, *options)
    assert told.exit_code == 2 and said in told.output
    assert not (tmp_path / "out").exists()


def test_training_that_could_not_be_validated_is_refused(paths, tmp_path):
    pytest.importorskip("torch")
    told = on_log("train", paths, tmp_path / "out", "--option", "duration=40", "--steps", "1",
                  "--faults", "{}")  # fmt: skip
    assert told.exit_code == 2 and "1 window for validation" in told.output
    assert not (tmp_path / "out").exists()
