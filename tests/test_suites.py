"""Frozen suites: the episodes of their version, one tuning for all cases, pages that are generated.

Where a hash differs because the simulation was changed on purpose: raise the version, take the
hash that `kfenv suites` prints, and run the suite anew.
"""

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from dead_runs import somebody_working_in
from kfenv.agents.cli.app import app
from kfenv.agents.contest import suites
from kfenv.agents.contest.recording_hash import recording_hash
from kfenv.agents.contest.rollout import draw_episodes, scenario_and_options
from kfenv.agents.contest.scores import read_values
from kfenv.agents.contest.suite_run import SuiteRun, hash_of, run_suite, suitable, track_cases
from kfenv.agents.contest.suites import IN_DISTRIBUTION, SUITES, Case, Suite
from typer.testing import CliRunner

import kfenv  # noqa: F401
from kfenv.scenarios.faults import resolve_faults

every_suite = pytest.mark.parametrize("name", SUITES)
LINEAR = "kfenv/BistaticTracking-v0"


@every_suite
def test_the_recordings_are_those_of_the_version(name):
    assert hash_of(SUITES[name]) == SUITES[name].recordings


@every_suite
def test_every_case_makes_an_environment(name):
    suite = SUITES[name]
    for case in suite.cases.values():
        gym.make(suite.env_id, **{**suite.kwargs, **case.kwargs})


@pytest.mark.parametrize(
    ("name", "faults"),
    [
        ("radar-2hz", suites.RADAR),
        ("radar-validation", suites.BURSTS),
        ("bistatic", suites.BURSTS),
        ("gnss", suites.GNSS),
        ("ins-gnss", suites.INERTIAL),
    ],
)
def test_faults_that_are_changed_by_parts_are_the_presets(name, faults):
    suite = SUITES[name]
    scenario, _ = scenario_and_options(suite.env_id, dict(suite.kwargs))
    presets = scenario.presets, scenario.known_faults
    assert resolve_faults(faults, *presets) == resolve_faults("random", *presets)


def test_the_hash_sees_a_change_but_no_rounding():
    recording = draw_episodes("kfenv/RadarTracking-v0", {"rate": 2.0}, "test", 0, 2)
    rng = np.random.default_rng(0)
    known = recording_hash([recording])
    for name in ("measurement", "noise", "truth", "mean"):
        values = getattr(recording, name)
        rounded = replace(
            recording, **{name: values * (1.0 + 2e-16 * rng.normal(size=values.shape))}
        )
        changed = replace(recording, **{name: values * (1.0 + 1e-6)})
        assert recording_hash([rounded]) == known != recording_hash([changed])


@pytest.fixture
def tiny(monkeypatch):
    suite = Suite(
        1, "", LINEAR, {"faults": "random", "duration": 10.0},
        {"quiet": Case("no faults", {"faults": "none"}, 4), "other": Case("", {"rate": 1.0}, 4)},
        episodes=5, tuning_episodes=2, tuning_trials=2,
    )  # fmt: skip
    suite = replace(suite, recordings=hash_of(suite))
    monkeypatch.setitem(SUITES, "tiny", suite)
    return suite


def test_a_suite_tunes_once_resumes_and_takes_more_agents(tiny, tmp_path):
    folder = tmp_path / "out"
    first = SuiteRun("tiny", ("huber-gate",), cases=("quiet",))
    results = run_suite(first, folder, processes=1)
    assert [(r["case"], r["agent"]) for r in results] == [
        (case, agent)
        for case in (IN_DISTRIBUTION, "quiet")
        for agent in ("fixed", "fixed-tuned", "huber-gate")
    ]
    assert [r["episodes"] for r in results] == [5, 5, 5, 4, 4, 4]
    for result in results:
        assert (result["suite"], result["version"]) == ("tiny", 1)
        assert result["recordings"] == tiny.recordings and result["machine"]["numpy"]
        assert result["episodes_at_most"] is None and "cost" in result
    values = [read_values(folder / case, "huber-gate") for case in (IN_DISTRIBUTION, "quiet")]
    assert values[0] == values[1] != {"threshold": 1.345, "gate": 30.0, "process_noise": 1.0}
    stamps = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    more = run_suite(SuiteRun("tiny", ("random",)), folder, processes=1, resume=True)
    assert len(more) == 12 and more[2] == results[2]
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    with pytest.raises(FileExistsError, match="--resume"):
        run_suite(first, folder, processes=1)
    with pytest.raises(ValueError, match="another number of episodes"):
        run_suite(replace(first, episodes=3), folder, processes=1, resume=True)


def test_a_suites_folder_takes_one_run_at_a_time_until_it_is_dead(tiny, tmp_path):
    run, folder = SuiteRun("tiny", (), cases=()), tmp_path / "out"
    folder.mkdir()
    with somebody_working_in(folder) as other:
        with pytest.raises(RuntimeError, match=rf"process {other} works in .*out: wait"):
            run_suite(run, folder, processes=1)
    assert run_suite(run, folder, processes=1)


def test_agents_expect_the_faults_that_they_were_tuned_to(tiny):
    """Nobody is told that a case lies out of distribution."""
    run = SuiteRun("tiny", ("hmm-noise",))
    contest = run.contest(tiny.cases["quiet"], run.agents)
    assert contest.env_kwargs["faults"] == "none"
    assert contest.expected_place == (LINEAR, {"duration": 10.0, "faults": "random"})
    assert contest.tuning_place == (LINEAR, {"duration": 10.0, "faults": "random"})


def test_unknown_names_are_told(tmp_path):
    with pytest.raises(ValueError, match="Did you mean 'radar-2hz'"):
        run_suite(SuiteRun("radar-2h", ()), tmp_path / "out")
    with pytest.raises(ValueError, match="Did you mean 'long-bursts'"):
        run_suite(SuiteRun("radar-2hz", (), cases=("long-burst",)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_real_flights_are_further_cases(tmp_path):
    (tmp_path / "one.csv").write_text("t,lat,lon,alt_m\n")
    cases = track_cases(SUITES["radar-2hz"], [tmp_path])
    assert cases["flight-one"].kwargs == {"track": str((tmp_path / "one.csv").resolve())}
    with pytest.raises(ValueError, match="flies no tracks"):
        track_cases(SUITES["bistatic"], [tmp_path])


def test_the_leaderboard_is_generated(tiny, tmp_path):
    folder, page = tmp_path / "out", tmp_path / "page.md"
    page.write_text("# Mine\n\nkept\n")
    told = kfenv_command("suite", "tiny", "--agent", "huber-gate", "--against", "huber-gate",
                         "--output", folder, "--processes", "1", "--episodes", "3")  # fmt: skip
    assert "a first look" in told.output
    for _ in range(2):
        kfenv_command("leaderboard", folder, "--page", page)
    text = page.read_text()
    assert text.startswith("# Mine\n\nkept\n") and text.count("## tiny, version 1") == 1
    assert "Shortened to at most 3 episodes" in text and "quiet: no faults" in text
    results = json.loads((folder / "results.json").read_text())
    for agent in ("fixed", "fixed-tuned", "huber-gate"):
        median = next(r["rmse_median"] for r in results if r["agent"] == agent)
        assert any(f"| `{agent}` | {median:.3g} " in line for line in text.splitlines())
    assert f"kfenv suite tiny --output {folder}" in text and "--against huber-gate" in text
    assert (folder / "error-cost.png").read_bytes().startswith(b"\x89PNG")


def test_results_of_other_recordings_are_refused(tiny, tmp_path, monkeypatch):
    run_suite(SuiteRun("tiny", (), cases=()), tmp_path / "out", processes=1)
    monkeypatch.setitem(SUITES, "tiny", replace(tiny, recordings="0123"))
    page = ("--page", tmp_path / "page.md")
    told = kfenv_command("leaderboard", tmp_path / "out", *page, code=2)
    assert "run the suite anew" in told.output and not (tmp_path / "page.md").exists()


def kfenv_command(*arguments, code=0):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result


def test_who_does_not_suit_a_suite_is_left_out_unasked():
    radar, gnss = (suitable(SUITES[name]) for name in ("radar-2hz", "gnss"))
    assert "raim" in gnss and "raim" not in radar
    assert {"imm-rq", "hmm-noise", "okf", "clairvoyant-rq"} <= set(radar)
