"""`kfenv run`: what the files hold is what the filter said, and a loss is told (about 4 s)."""

import csv
import json
from xml.etree import ElementTree

import numpy as np
import pymap3d
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.rollout import draw_episodes
from kfenv.agents.running.filtering import filtered
from kfenv.agents.running.parameters import tuned_values
from plot_files import of_episode, truth_of, written
from typer.testing import CliRunner

from kfenv.filters.engine import Engine
from kfenv.filters.reference import ReferenceFilter
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.tracking import RadarTracking

RADAR = "kfenv/RadarTracking-v0"
SITE = [45.0, 7.0, 200.0]
SIMULATED = RadarTracking(rate=2.0, duration=100.0, faults="none")


def kfenv(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def table(folder):
    """The columns of estimate.csv, NaN for empty cells."""
    with (folder / "estimate.csv").open() as file:
        names, *rows = csv.reader(file)
    values = np.array([[float(cell or "nan") for cell in row] for row in rows])
    return dict(zip(names, values.T, strict=True))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plots")
    episode = SIMULATED.sample([np.random.default_rng(7)])
    plots = of_episode(folder / "plots.csv", SIMULATED.sensor, episode)
    return plots, truth_of(folder / "truth.csv", episode)


def test_the_whole_log_is_in_the_table_and_on_the_maps(files, tmp_path):
    folder = tmp_path / "out"
    told = kfenv(
        "run", RADAR, "--plots", files[0], "--truth", files[1], "--agent", "fixed",
        "--option", f"radar_position={SITE}", "--output", folder,
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    columns = table(folder)
    log = RadarTracking(plots=files, duration=20.0)
    whole = log.whole().recording
    models = SIMULATED.motion, SIMULATED.sensor
    expected = Engine(*models).run(whole)
    history = ReferenceFilter(*models, "srukf-joseph-exact").history(whole)
    np.testing.assert_allclose(columns["t_s"], 2.0 + whole.times[0])
    np.testing.assert_allclose(columns["nis"], expected.nis[0], rtol=1e-9)
    deviation = np.sqrt(np.diagonal(history.covariance[0], axis1=1, axis2=2))
    for i, state in enumerate(SIMULATED.motion.states):
        mean = columns[f"{state.name}_{state.unit}"]
        np.testing.assert_allclose(mean, expected.mean[0, :, i], rtol=1e-9, atol=1e-9)
        spread = columns[f"{state.name}_std_{state.unit}"]
        np.testing.assert_allclose(spread, deviation[:, i], rtol=1e-6)
    assert (columns["knob_fading"] == 1.0).all() and (columns["stretch"] == 1.0).all()
    off = expected.mean[0] - whole.truth[0]
    np.testing.assert_allclose(
        columns["error_m"], np.linalg.norm(off[:, [0, 3, 6]], axis=1), rtol=1e-6
    )
    place = pymap3d.enu2geodetic(*expected.mean[0][:, [0, 3, 6]].T, *SITE)
    for name, values in zip(("lat_deg", "lon_deg", "height_m"), place, strict=True):
        np.testing.assert_allclose(columns[name], values, rtol=1e-9)
    _check_maps(folder, place, len(whole.times[0]))
    summary = json.loads((folder / "run.json").read_text())
    assert summary["ended"] == [] and summary["instants"] == len(whole.times[0])
    assert summary["rmse"] == pytest.approx(np.sqrt(np.mean(columns["error_m"] ** 2)))
    assert (folder / "map.png").read_bytes().startswith(b"\x89PNG")


def _check_maps(folder, place, count):
    lines = json.loads((folder / "track.geojson").read_text())["features"]
    assert [line["properties"]["name"] for line in lines] == ["estimate", "truth"]
    assert len(lines[0]["geometry"]["coordinates"]) == count == len(lines[0]["properties"]["times"])
    np.testing.assert_allclose(
        lines[0]["geometry"]["coordinates"], np.column_stack(place)[:, [1, 0, 2]], atol=1e-3
    )
    space = {"k": "http://www.opengis.net/kml/2.2"}
    root = ElementTree.parse(folder / "track.kml").getroot()
    drawn = root.findall(".//k:LineString/k:coordinates", space)
    first = [float(number) for number in drawn[0].text.split()[0].split(",")]
    np.testing.assert_allclose(first, lines[0]["geometry"]["coordinates"][0], atol=1e-6)


@pytest.mark.parametrize("agent", ["huber-gate", "hmm-noise", "learned", "imm", "ekf-joseph"])
def test_any_agent_runs(files, agent):
    run = filtered(RADAR, {"plots": files, "duration": 20.0}, agent)
    assert len(run.time) == len(run.nis) == len(run.factors) and not run.ended
    assert np.nanmax(run.error[20:]) < 100.0
    assert bool(run.knobs) == (agent not in ("imm", "ekf-joseph"))


def test_parameters_are_taken_from_the_line_and_from_a_contest(files, tmp_path):
    contest, kwargs = tmp_path / "contest", ["--plots", files[0], "--option", "duration=15"]
    told = kfenv("evaluate", RADAR, *kwargs, "--agent", "huber-gate", "--tuning-trials", 2,
                 "--processes", 1, "--output", contest)  # fmt: skip
    assert told.exit_code == 0, told.output
    told = kfenv("run", RADAR, *kwargs, "--agent", "fixed-tuned", "--tuned", contest,
                 "--value", "process_noise=7", "--output", tmp_path / "run")  # fmt: skip
    assert told.exit_code == 0, told.output
    columns = table(tmp_path / "run")
    np.testing.assert_allclose(columns["knob_process_noise"], 7.0)
    assert "error_m" not in columns and "lat_deg" not in columns
    from kfenv.agents.contest.scores import read_values

    tuned = read_values(contest, "fixed-tuned")["range_noise"]
    np.testing.assert_allclose(columns["knob_range_noise"], tuned, rtol=1e-9)


def test_static_noise_and_rules_that_tune_chose_are_taken(tmp_path):
    chosen = {"process_noise": {"value": 0.5}, "range_noise": {"value": 2.0}}
    report = {"by": ["likelihood"], "static": {"likelihood": {"parameters": chosen}},
              "rules": [{"name": "huber-gate", "values": {"threshold": 3.0}}]}  # fmt: skip
    (tmp_path / "report.json").write_text(json.dumps(report))
    expected = {"process_noise": 0.5, "range_noise": 2.0}
    assert tuned_values(tmp_path, "fixed-tuned") == expected
    assert tuned_values(tmp_path, "huber-gate") == {"threshold": 3.0}
    with pytest.raises(ValueError, match="tells nothing of nis-gate, but of fixed-tuned, huber"):
        tuned_values(tmp_path, "nis-gate")


def test_a_simulated_episode_is_the_first_that_a_contest_tests_on(tmp_path):
    kwargs = {"rate": 2.0, "duration": 15.0}
    told = kfenv("run", RADAR, "--rate", 2, "--option", "duration=15", "--seed", 4,
                 "--output", tmp_path / "out")  # fmt: skip
    assert told.exit_code == 0, told.output
    episode = draw_episodes(RADAR, kwargs, "test", 4, 1)
    expected = Engine(SIMULATED.motion, SIMULATED.sensor).run(episode).mean[0]
    np.testing.assert_allclose(table(tmp_path / "out")["x_m"], expected[:, 0], rtol=1e-9)
    assert not (tmp_path / "out" / "track.kml").exists()


def test_a_lost_track_is_told_and_begun_anew(tmp_path):
    """Ten seconds of plots are those of another target, a hundred kilometres away."""
    scenario, rng = BistaticTracking(), np.random.default_rng(0)
    time = 0.5 * np.arange(200.0)
    value = rng.standard_normal((200, 3))
    value[100:120] += 1e5
    truth = tmp_path / "truth.csv"
    np.savetxt(truth, np.column_stack([time, 0.0 * value]), "%g", ",", header="t,x_m,y_m,z_m",
               comments="")  # fmt: skip
    path = written(tmp_path / "plots.csv", scenario.sensor, time, value, np.full((200, 3), 2.0))
    told = kfenv("run", "kfenv/BistaticTracking-v0", "--plots", path, "--truth", truth,
                 "--output", tmp_path / "out")  # fmt: skip
    assert told.exit_code == 0, told.output
    assert "The track was lost at t = 50 s" in " ".join(told.output.split())
    columns = table(tmp_path / "out")
    assert columns["stretch"].max() > 1.0 and columns["t_s"][-1] == 99.5
    near = (columns["t_s"] < 50.0) | (columns["t_s"] > 65.0)
    assert (columns["error_m"][near] < 10.0).all()


@pytest.mark.parametrize(("more", "said"), [
    (["--agent", "huber-gate", "--value", "treshold=3"], "Unknown parameter of huber-gate"),
    (["--value", "process_noise"], "is not of the form KEY=NUMBER"),
    (["--agent", "clairvoyant"], "is shown what nobody knows of a real log"),
    (["--tuned", "nowhere"], "nowhere holds nothing of fixed"),
])  # fmt: skip
def test_what_cannot_be_run_is_refused_before_anything_is_written(files, tmp_path, more, said):
    told = kfenv("run", RADAR, "--plots", files[0], "--output", tmp_path / "out", *more)
    assert told.exit_code == 2 and said in " ".join(told.output.split())
    assert not (tmp_path / "out").exists()


def test_what_is_scored_but_no_position_is_drawn_over_time(tmp_path):
    told = kfenv("run", "kfenv/Filter-v0", "--option", "duration=5", "--output", tmp_path / "out")
    assert told.exit_code == 0, told.output
    columns = table(tmp_path / "out")
    [error] = (columns[name] for name in columns if name.startswith("error"))
    assert np.isfinite(error).all() and not (tmp_path / "out" / "track.kml").exists()
    assert (tmp_path / "out" / "map.png").read_bytes().startswith(b"\x89PNG")
