"""A log of plots as episodes: the same numbers as simulated, windows, irregular steps (3 s)."""

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pymap3d
import pytest
from kfenv.agents.cli.app import app
from plot_files import of_episode, truth_of, written
from test_bad_input import complaint
from typer.testing import CliRunner

from kfenv.filters.bank import Bank, Mode, markov
from kfenv.filters.engine import Engine
from kfenv.filters.reference import ReferenceFilter
from kfenv.scenarios.radar.bistatic import BistaticTracking
from kfenv.scenarios.radar.plot_log import FIRST, MAX_STEP, instants_of, make_log, measured_noise
from kfenv.scenarios.radar.plots import Plots
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.radar.validation import RadarValidation
from kfenv.scenarios.windows import PARTS

SIMULATED = RadarTracking(rate=2.0, duration=240.0)


@pytest.fixture(scope="module")
def episode():
    return SIMULATED.sample([np.random.default_rng(5)])


@pytest.fixture(scope="module")
def files(episode, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plots")
    plots = of_episode(folder / "plots.csv", SIMULATED.sensor, episode)
    return plots, truth_of(folder / "truth.csv", episode)


def begun_as(recording, episode, instant):
    """A recording that begins with the truth instead of with what plots tell."""
    return replace(recording, mean=episode.truth[:, instant], factor=episode.factor)


def test_a_simulated_episode_comes_back_with_the_same_results(files, episode):
    log = RadarTracking(plots=files, duration=30.0).log
    first = int(log.plots[FIRST - 1])
    whole = log.recording(np.array([first]), len(log.time) - first)
    assert whole.scored is None
    np.testing.assert_array_equal(whole.times[0], episode.time[first:] - episode.time[first])
    np.testing.assert_allclose(
        whole.measurement[:, 1:], episode.measurement[:, first + 1 :], rtol=1e-14, atol=1e-14
    )
    arrived = ~np.isnan(episode.measurement[:, first:])
    np.testing.assert_allclose(whole.noise[arrived], episode.noise[:, first:][arrived], rtol=1e-14)
    inside = slice(2, -2)  # a spline's ends are freer
    error = (whole.truth - episode.truth[:, first:])[0, inside]
    assert np.abs(error[:, [0, 3, 6]]).max() < 1e-9 and np.abs(error[:, [1, 4, 7]]).max() < 1.0
    same = replace(
        episode, time=episode.time[first:], true_noise=None, true_bias=None,
        **{name: getattr(episode, name)[:, first:]
           for name in ("measurement", "noise", "motion_inputs", "sensor_inputs", "truth")},
    )  # fmt: skip
    without_first = same.measurement.copy()
    without_first[:, 0] = np.nan
    same = begun_as(replace(same, measurement=without_first), episode, first)
    engine = Engine(SIMULATED.motion, SIMULATED.sensor)
    told, expected = engine.run(begun_as(whole, episode, first)), engine.run(same)
    np.testing.assert_allclose(told.mean, expected.mean, rtol=1e-7, atol=1e-5)


def test_windows_do_not_overlap_and_parts_are_disjoint(files):
    scenario = RadarTracking(plots=files[0], duration=15.0)
    log = scenario.log
    size = log.steps(15.0)
    for part, (low, high) in PARTS.items():
        drawn = log.random_starts([np.random.default_rng(i) for i in range(50)], 15.0, part)
        for starts in (drawn, log.starts(15.0, part)):
            assert (log.time[starts] >= low * log.time[-1]).all()
            assert (log.time[starts + size - 1] <= high * log.time[-1] + 1e-9).all()
        assert (np.diff(log.starts(15.0, part)) >= size).all()


def test_without_a_truth_plots_are_withheld_and_count(files):
    scenario = RadarTracking(plots=files[0], duration=18.0)
    log, windows = scenario.log, scenario.recorded("test", 100)
    counts = windows.scored > 0.0
    assert counts.any() and np.isnan(windows.measurement[counts]).all()
    stretch = np.floor(windows.times / 2.0 + 1e-6) % 6 == 5
    assert np.isnan(windows.measurement[stretch]).all()
    starts = log.starts(18.0, "test")
    for window, start in zip(range(len(windows)), starts, strict=True):
        at = start + np.flatnonzero(counts[window])
        np.testing.assert_array_equal(
            windows.truth[window, counts[window]][:, [0, 3, 6]], log.position[at]
        )
    told = RadarTracking(plots=files, duration=18.0).recorded("test", 100)
    assert told.scored is None and np.isnan(told.measurement[:, 1:]).mean() < 0.2


def irregular(seed=0, gap=True):
    """Times 0.1 to 0.9 s apart, and once 20 s."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.1, 0.9, 300))
    return np.where(time > time[150], time + 20.0 * gap, time)


def test_irregular_plots_are_stepped_to_exactly_as_they_came():
    """Over constant acceleration steps compose exactly: the gap's pieces are one step."""
    time = irregular()
    instants, row, every = instants_of(time, "x")
    assert every == 1 and np.diff(instants).max() <= MAX_STEP + 1e-9
    np.testing.assert_array_equal(instants[row], time)
    scenario = BistaticTracking(rate=2.0, duration=60.0)
    rng, n = np.random.default_rng(1), len(time)
    value = np.cumsum(rng.standard_normal((n, 3)) * 10.0, axis=0)
    noise = np.full((n, 3), 3.0)
    log = make_log(Plots("x", time, value, noise), scenario.sensor, noise, None, (instants, row, 1))
    whole = log.recording(np.array([2]), len(log.time) - 2, missing=False)
    told = Engine(scenario.motion, scenario.sensor).run(whole).mean[0, row[2:] - 2]
    reference = ReferenceFilter(scenario.motion, scenario.sensor, "srukf-joseph-exact")
    mean, factor, status = whole.mean, whole.factor, np.zeros(1, np.int64)
    for i in range(3, n):
        step = np.array([time[i] - time[i - 1]])
        predicted = reference.predict(mean, factor, np.zeros((1, 0)), step, status)
        mean, factor = _updated(reference, predicted, value[i], noise[i], status)
        np.testing.assert_allclose(told[i - 2], mean[0], rtol=1e-6, atol=1e-6)


def _updated(reference, predicted, value, noise, status):
    from kfenv.filters.protocol import Knobs, Measurement

    seen = Measurement(np.zeros((1, 0)), value[None], noise[None])
    told = reference.update(predicted, Knobs.nominal(1), seen, status)
    return told.mean, told.factor


def test_windows_of_irregular_plots_are_filtered_each_by_its_own_times(tmp_path):
    time = irregular()
    value = np.cumsum(np.random.default_rng(2).standard_normal((300, 3)) * 10.0, axis=0)
    noise, sensor = np.full((300, 3), 3.0), BistaticTracking().sensor
    path = written(tmp_path / "p.csv", sensor, time, value, noise)
    scenario = BistaticTracking(plots=path, duration=10.0)
    windows = scenario.recorded("test", 5)
    assert windows.time.ndim == 2 and np.ptp(windows.times[:, -1]) > 0.1
    engine = Engine(scenario.motion, scenario.sensor)
    bank = Bank(engine, [Mode(), Mode(noise=3.0)], markov(np.full((2, 2), 0.1)))
    reference = ReferenceFilter(scenario.motion, scenario.sensor, "srukf-joseph-exact")
    for tier, run in ((engine, engine.run), (bank, bank.history), (reference, reference.run)):
        together = run(windows).mean
        for i in range(len(windows)):
            alone = run(replace(windows[[i]], time=windows.times[i])).mean[0]
            np.testing.assert_allclose(together[i], alone, rtol=1e-9, err_msg=str(tier))
    env = gym.make("kfenv/BistaticTracking-v0", recording=windows, observation="full")
    for i in range(len(windows)):
        env.reset(seed=0 if i == 0 else None)
        info = env.step(env.action_space.sample() * 0.0)[-1]
        for _ in range(3):
            info = env.step(env.action_space.sample() * 0.0)[-1]
        assert info["time"] == windows.times[i, 3]
        np.testing.assert_allclose(info["estimate"], engine.run(windows).mean[i, 3], rtol=1e-9)


def test_a_rotating_radar_is_stepped_evenly_from_scan_to_scan():
    time = 4.0 * np.arange(60.0)
    time = np.delete(time, [20, 21, 40])  # missed
    instants, row, every = instants_of(time, "x")
    assert every == 4 and (row % 4 == 0).all()
    np.testing.assert_allclose(np.diff(instants), 1.0)


def test_plots_once_a_second_more_or_less_are_stepped_to_at_once():
    time = np.cumsum(np.random.default_rng(0).uniform(0.95, 1.07, 100))
    instants, _, every = instants_of(time, "x")
    assert every == 1 and len(instants) == 100


def test_the_start_is_consistent():
    """Normalised errors of the initial estimate, over simulated flights without faults."""
    scenario = RadarTracking(rate=2.0, duration=20.0, faults="none")
    recording = scenario.sample([np.random.default_rng(i) for i in range(40)])
    nees = []
    for i in range(40):
        plots = Plots("x", recording.time, recording.measurement[i], recording.noise[i])
        log = make_log(plots, scenario.sensor, plots.deviation, None, instants_of(plots.time, "x"))
        for place in (FIRST - 1, -1):
            instant = log.plots[place]
            mean, factor = log.start(instant)
            white = np.linalg.solve(factor, mean - recording.truth[i, instant])
            nees.append(white @ white / 9.0)
    assert 0.3 < np.median(nees) < 1.3 and np.mean(nees) < 2.0


def test_noise_that_no_file_tells_is_measured(tmp_path):
    scenario = RadarValidation(rate=2.0, duration=200.0, noise_deviation=(25.0, 0.5, 0.7))
    recording = scenario.sample([np.random.default_rng(3)])
    told = measured_noise(recording.time, recording.measurement[0], [1, 2])
    true = [25.0, *np.radians([0.5, 0.7])]
    np.testing.assert_allclose(told, true, rtol=0.25)
    path = written(tmp_path / "p.csv", scenario.sensor, recording.time, recording.measurement[0])
    log = RadarValidation(plots=path, duration=20.0).log
    np.testing.assert_allclose(log.noise[0], true, rtol=0.4)
    given = RadarValidation(plots=path, duration=20.0, noise_deviation=(5.0, 1.0, 1.0)).log
    np.testing.assert_allclose(given.noise[0], [5.0, *np.radians([1.0, 1.0])])


# ----- truth ------------------------------------------------------------------------------


def test_a_flight_is_the_truth_once_the_radars_place_is_told(episode, files, tmp_path):
    site = (45.0, 7.0, 200.0)
    place = pymap3d.enu2geodetic(*episode.truth[0][:, [0, 3, 6]].T, *site)
    flight = tmp_path / "flight.csv"
    table = np.column_stack([episode.time, *place])
    np.savetxt(flight, table, "%.12f", ",", header="t,lat,lon,alt_m", comments="")
    paths = files[0], str(flight)
    told = RadarTracking(plots=paths, radar_position=site, cutoff=3.0, duration=20.0).log
    off = told.truth[told.known][:, [0, 3, 6]] - episode.truth[0][told.known][:, [0, 3, 6]]
    assert told.known.mean() > 0.9 and np.median(np.linalg.norm(off, axis=1)) < 5.0  # smoothed
    said = complaint(ValueError, RadarTracking, plots=(files[0], str(flight)), duration=20.0)
    assert "give radar_position=(lat, lon, height)" in said


def test_a_truth_that_is_another_targets_or_clocks_is_refused(episode, files, tmp_path):
    path = tmp_path / "truth.csv"

    def refused(time, position):
        table = np.column_stack([time, position])
        np.savetxt(path, table, "%.12g", ",", header="t,x_m,y_m,z_m", comments="")
        return complaint(ValueError, RadarTracking, plots=(files[0], str(path)), duration=20.0)

    position = episode.truth[0][:, [0, 3, 6]]
    assert "give the times of both on one clock" in refused(episode.time + 1e4, position)
    assert "are azimuths clockwise" in refused(episode.time, position + np.array([3e4, 0.0, 0.0]))
    mirrored = refused(episode.time, position[:, [1, 0, 2]])
    assert "counts from east against the clock" in mirrored


# ----- doors ------------------------------------------------------------------------------


@pytest.mark.parametrize(("keywords", "said"), [
    ({"faults": "none"}, "faults is for simulated episodes"),
    ({"rate": 5.0}, "rate is the log's, 2 per second"),
    ({"duration": 500.0}, "has no room for a window of 500 s"),
    ({"altitude_offset": 5.0}, "altitude_offset is for simulated episodes"),
])  # fmt: skip
def test_what_does_not_go_with_a_log_is_refused(files, keywords, said):
    assert said in complaint(
        ValueError, RadarTracking, **{"plots": files[0], "duration": 20.0} | keywords
    )


def test_paths_and_gaps_are_checked(tmp_path):
    assert "plots must be the path" in complaint(ValueError, RadarTracking, plots=3)
    with pytest.raises(FileNotFoundError, match=r"there is no plots file \S+none\.csv"):
        RadarTracking(plots=str(tmp_path / "none.csv"))
    time = np.append(0.5 * np.arange(50.0), 100.0 + 0.5 * np.arange(50.0))
    said = complaint(ValueError, instants_of, time, "x.csv")
    assert "x.csv: no plot for 75.5 s after t = 24.5 s" in said


# ----- command line -----------------------------------------------------------------------


def test_a_contest_on_plots(files, tmp_path):
    told = CliRunner().invoke(app, [
        "evaluate", "kfenv/RadarTracking-v0", "--plots", files[0], "--truth", files[1],
        "--option", "duration=20", "--agent", "hmm-noise", "--agent", "imm", "--agent", "learned",
        "--tuning-trials", "0", "--processes", "1", "--output", str(tmp_path / "out"),
    ])  # fmt: skip
    assert told.exit_code == 0, told.output
    assert "windows of a real log" in told.output
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {result["agent"] for result in results} == {"fixed", "hmm-noise", "imm", "learned"}
    assert all(np.isfinite(result["rmse"]) for result in results)
    assert (tmp_path / "out" / "map.png").exists()
    alone = CliRunner().invoke(app, [
        "evaluate", "kfenv/RadarTracking-v0", "--truth", files[1], "--output", str(tmp_path / "no"),
    ])  # fmt: skip
    assert alone.exit_code == 2 and "--truth goes with --plots" in alone.output
