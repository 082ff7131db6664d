"""A user's inertial and GNSS log: checked at the door, aligned, scored on withheld fixes."""

import json
import pickle
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from inertial_logs import CLOCK, drive
from kfenv.agents.cli.app import app
from rollouts import INERTIAL, assert_same, play, random_actions
from test_bad_input import complaint
from typer.testing import CliRunner

from kfenv.models.rotations import matrix_from_angles
from kfenv.models.strapdown import GRAVITY
from kfenv.scenarios.inertial.files import check_together, read_fixes, read_imu
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.inertial.log import level
from kfenv.scenarios.inertial.reading import read_log

GOOD_UNIT = {"duration": 40.0}


@pytest.fixture(scope="module")
def simulated():
    return drive()


@pytest.fixture(scope="module")
def paths(simulated, tmp_path_factory):
    return simulated[0].write(tmp_path_factory.mktemp("log"))


# ----- what an episode is ---------------------------------------------------------------


def test_samples_and_fixes_arrive_unchanged(tmp_path):
    """Without noise the windows hold the flight's own samples, and fixes on its track."""
    perfect, flight = drive(duration=100.0, noisy=False)
    log = read_log(perfect.write(tmp_path), 100.0)
    np.testing.assert_allclose(log.samples[1:], perfect.imu[1:, 1:], atol=1e-6)
    assert log.steps_per_fix == 20 and log.time[0] == CLOCK
    start = log.starts(20.0, "tuning")[0]
    window, k = log.window(start, 20.0), log.row[start]
    assert window.arrived.sum() == 100 and window.arrived[20::20].all()
    way = flight[k : k + 2001, :3] - flight[k, :3]
    np.testing.assert_allclose(window.truth[:, :2], way[:, :2], atol=0.02)
    np.testing.assert_allclose(window.truth[:, 2], way[:, 2], atol=0.5)  # the Earth is round
    np.testing.assert_allclose(window.fix[20::20, 3:], flight[k + 20 : k + 2001 : 20, 3:6])


def test_alignment(simulated, paths):
    """Within a few degrees, in turns too, for which gravity alone would be wrong by the bank."""
    log, flight = read_log(paths[:2], 100.0), simulated[1]
    starts = np.concatenate([log.starts(40.0, part) for part in ("tuning", "validation", "test")])
    off, banks = [], []
    for start in starts[::20]:
        true = flight[log.row[start], 6:]
        found = log.aligned(start)
        turn = matrix_from_angles(found).T @ matrix_from_angles(true)
        off.append(np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))
        banks.append(abs(np.degrees(true[0])))
    assert max(banks) > 20.0 and np.median(off) < 4.0 and np.percentile(off, 90) < 12.0


@pytest.mark.parametrize("angles", [(0, 0, 0), (0.4, -0.2, 2.0), (-0.7, 0.3, -3.0)])
def test_level_inverts_the_rotation(angles):
    pull = np.array([0.8, -1.5, 0.4 - GRAVITY])
    force = matrix_from_angles(angles).T @ pull
    np.testing.assert_allclose(level(force, pull, angles[2]), angles, atol=1e-12)


def test_another_rate_averages_the_samples(paths):
    fine, coarse = read_log(paths[:2], 100.0), read_log(paths[:2], 20.0)
    mean = fine.samples[1:].reshape(-1, 5, 6).mean(axis=1)
    np.testing.assert_allclose(coarse.samples[1:], mean, atol=1e-6)
    assert coarse.steps_per_fix == 4


def test_the_parts_do_not_overlap(paths):
    scenario = InsGnss(log=paths[:2], **GOOD_UNIT)
    log = scenario._log
    ends = []
    for part in ("tuning", "validation", "test"):
        rows = log.row[log.starts(40.0, part)]
        ends.append((rows.min(), rows.max() + 4000))
    assert ends[0][1] <= ends[1][0] and ends[1][1] <= ends[2][0]
    assert np.diff(log.row[log.apart(40.0, "test", 15.0)]).min() == 1500
    assert len(scenario.recorded("test", 99)) == 8 and len(scenario.recorded("tuning", 17)) == 17
    apart = replace(scenario, faults={"glint": {}})
    assert apart.recorded("tuning", 5) is None and len(apart.recorded("test", 99)) == 3


# ----- in the environment ---------------------------------------------------------------


def test_it_runs_without_attitude_and_scores_withheld_fixes(paths):
    env = gym.make(INERTIAL, log=paths[:2], **GOOD_UNIT).unwrapped
    assert env.scenario.sensor.groups == ("position", "velocity")
    assert env.action_space.shape == (5,) and env.core.interval == 20
    recording = env.scenario.sample([np.random.default_rng(0)])
    ((label, start, stop),) = recording.faults[0]
    assert label == "signal loss" and 5.0 <= stop - start <= 15.0
    inside = (recording.time >= start) & (recording.time < stop)
    scored = recording.scored[0] == 1.0
    assert not scored[~inside].any() and scored.sum() == pytest.approx(5 * (stop - start), abs=1.5)
    assert np.isnan(recording.measurement[0][scored]).all()
    heard = play(env, np.zeros((999, 5)), seed=0)
    assert len(heard) == 1 + 201 and heard[-1][3]
    rewards = np.array([step[1] for step in heard[1:]])
    told = np.array([step[4].get("position_error", np.nan) for step in heard[1:]])
    np.testing.assert_array_equal(np.isnan(told), rewards == 0.0)
    rmse = np.sqrt(np.nanmean(told**2))
    assert rewards.sum() == pytest.approx(-rmse / 20.0)
    assert 20 < (rewards < 0.0).sum() < 80 and rmse < 20.0
    twin = pickle.loads(pickle.dumps(gym.make(INERTIAL, log=paths[:2], **GOOD_UNIT)))
    assert_same(heard[:9], play(twin.unwrapped, np.zeros((8, 5)), seed=0))


def test_errors_are_distances_to_the_withheld_fixes(simulated, paths):
    """Summed by hand over the true track, which the fixes follow to their noise."""
    scores = {}
    for files in (paths[:2], paths):
        scenario = InsGnss(log=files, **GOOD_UNIT)
        env = gym.make(INERTIAL, log=files, **GOOD_UNIT).unwrapped
        recording = scenario.recorded("test", 3)
        env = gym.make(INERTIAL, log=files, recording=recording[[0]], **GOOD_UNIT).unwrapped
        play(env, np.zeros((999, 5)), seed=0)
        scored = recording.scored_instants[0]
        assert env.core.total_scored[0] == scored
        scores[len(files)] = np.sqrt(env.core.total_squared_error[0] / scored)
    assert scores[3] < scores[2] < 30.0  # an outage is where errors are large


def test_a_log_with_truth_is_scored_everywhere(paths):
    recording = InsGnss(log=paths, **GOOD_UNIT).sample([np.random.default_rng(0)])
    assert recording.scored is None and np.isfinite(recording.truth).all()


def test_the_same_seed_gives_the_same_bits_in_a_vector(paths):
    vector = gym.make_vec(INERTIAL, num_envs=3, log=paths[:2], **GOOD_UNIT)
    single = gym.make(INERTIAL, log=paths[:2], **GOOD_UNIT)
    observation, _ = vector.reset(seed=5)
    for i in range(3):
        np.testing.assert_array_equal(observation[i], single.reset(seed=5 + i)[0])
    for action in random_actions((3, 5), 5):
        assert vector.observation_space.contains(vector.step(action)[0])


def test_a_log_is_read_again_when_a_file_changes(simulated, tmp_path):
    paths = simulated[0].write(tmp_path)
    before = read_log(paths[:2], 100.0)
    assert read_log(paths[:2], 100.0) is before
    simulated[0]._replace(gnss=simulated[0].gnss[::2]).write(tmp_path)
    assert read_log(paths[:2], 100.0).steps_per_fix == 2 * before.steps_per_fix


def test_a_log_is_drawn(paths):
    env = gym.make(INERTIAL, log=paths[:2], render_mode="rgb_array", **GOOD_UNIT).unwrapped
    env.reset(seed=0)
    first = env.render()
    for _ in range(60):
        env.step(np.zeros(5))
    assert (env.render() != first).any()


def test_a_fix_that_cannot_be_weighed_is_named_with_its_file(paths, monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    scenario = InsGnss(log=paths, duration=10.0, bias_time=(500.0, 500.0))
    monkeypatch.setattr(np.linalg, "solve", singular)
    with pytest.raises(ValueError, match=r"fix at t = .* cannot be weighed") as caught:
        scenario.sample([np.random.default_rng(0)])
    assert str(paths[1]) in str(caught.value) and str(paths[0]) in str(caught.value)


def test_faults_that_raise_the_noise_add_what_is_missing(paths):
    faults = {"glint": {"probability": 1.0, "fraction": 1.0, "factor": 10.0}}
    loud = InsGnss(log=paths[:2], faults=faults, **GOOD_UNIT)
    plain = InsGnss(log=paths[:2], faults="none", **GOOD_UNIT)
    rngs = [[np.random.default_rng(s)] for s in (3, 3)]
    spoilt, clean = loud.sample(rngs[0]), plain.sample(rngs[1])
    off = (spoilt.measurement - clean.measurement) / clean.noise
    np.testing.assert_allclose(np.nanstd(off, axis=(0, 1)), np.sqrt(99.0), rtol=0.2)
    np.testing.assert_allclose(spoilt.true_noise, 10.0 * clean.noise)
    assert not clean.scored.any()


def test_evaluate_on_a_log(paths, tmp_path):
    arguments = [
        "evaluate", INERTIAL, "--option", f"log={json.dumps(paths[:2])}",
        "--option", "duration=40",
        "--agent", "fixed", "--episodes", "2", "--tuning-trials", "0", "--processes", "1",
        "--output", str(tmp_path / "contest"),
    ]  # fmt: skip
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 0, told.output
    (result,) = json.loads((tmp_path / "contest" / "results.json").read_text())
    assert result["episodes"] == 2 and 0.5 < result["rmse"] < 30.0 and result["track_loss"] == 0.0


# ----- complaints -----------------------------------------------------------------------


def scaled(columns, factor):
    def change(table):
        table[:, columns] *= factor

    return change


def shuffled(table):
    table[[3, 4]] = table[[4, 3]]


def gap(table):
    table[500:, 0] += 2.0


def missing(table):
    table[7, 2] = np.nan


def swapped(table):
    table[:, [1, 3]] = table[:, [3, 1]]


def later(table):
    table[:, 0] += 1e6


IMU_FAULTS = [
    (scaled([2, 3, 5, 6], -1.0), "the z axis points up"),
    (scaled([4, 5, 6], 57.3), "look like deg/s"),
    (scaled([6], -1.0), "turns against the GNSS course"),
    (scaled([1, 2, 3], 1.0 / 9.81), "units of g"),
    (scaled([1, 2, 3], 0.0), "not about 9.81"),
    (scaled([0], 1000.0), "milliseconds"),
    (swapped, "gravity lies along x"),
    (shuffled, "does not increase in data row 5"),
    (gap, "no sample for 2.01 s"),
    (missing, "column 'fy' in data row 8 is nan"),
    (later, "have 0 s in common"),
]
GNSS_FAULTS = [
    (scaled([1, 2], np.pi / 180.0), "times as far as the velocities say"),
    (scaled([4, 5], 3.6), "positions move 0.27"),
    (scaled([6], -1.0), "height rises where 'vd' is positive"),
    (scaled([7], 0.0), "column 'sd_n' holds standard deviations"),
    (scaled([1], 3.0), "column 'lat' reaches"),
    (scaled([0], 1000.0), "milliseconds"),
    (shuffled, "does not increase in data row 5"),
    (missing, "column 'lon' in data row 8 is nan"),
]


@pytest.mark.parametrize(("which", "change", "said"), [
    *(("imu", *fault) for fault in IMU_FAULTS), *(("gnss", *fault) for fault in GNSS_FAULTS),
])  # fmt: skip
def test_a_wrong_unit_axis_or_row_is_named(simulated, tmp_path, which, change, said):
    table = getattr(simulated[0], which).copy()
    change(table)
    paths = simulated[0]._replace(**{which: table}).write(tmp_path)
    assert said in complaint(ValueError, gym.make, INERTIAL, log=paths[:2])


def test_missing_files_columns_and_numbers(paths, tmp_path):
    bare = tmp_path / "bare.csv"
    bare.write_text("time,fx\n1,2\n")
    assert "column 't' is missing; rename 'time'" in complaint(ValueError, read_imu, bare)
    assert "An inertial log has t, fx, fy" in complaint(ValueError, read_imu, bare)
    bare.write_text("t,fx,fy,fz,wx,wy,wz\n1,2,3,4,5,6,x\n")
    assert "column 'wz' in line 2 is no number" in complaint(ValueError, read_imu, bare)
    bare.write_text("t,fx,fy,fz,wx,wy,wz\n1,2,3,4,5,6,7\n")
    assert "at least 10 rows" in complaint(ValueError, read_imu, bare)
    with pytest.raises(FileNotFoundError, match="there is no GNSS log file"):
        read_fixes(tmp_path / "nowhere.csv")
    for wrong in ("imu.csv", ("imu.csv",), (1, 2), 3):
        assert "log must be the paths" in complaint(ValueError, gym.make, INERTIAL, log=wrong)


def test_a_log_that_is_too_short_slow_or_still(simulated, paths, tmp_path):
    said = complaint(ValueError, gym.make, INERTIAL, log=paths[:2], duration=200.0)
    assert "the part for tuning (30% of 300 s) has no room for a window of 200 s" in said
    slow = simulated[0]._replace(imu=simulated[0].imu[::4]).write(tmp_path)
    assert "set rate to 25 or less" in complaint(ValueError, gym.make, INERTIAL, log=slow[:2])
    still = simulated[0].gnss.copy()
    still[:, 1:4], still[:, 4:7] = still[0, 1:4], 0.0
    imu = simulated[0].imu.copy()
    imu[:, 1:] = [0.0, 0.0, -9.8, 0.0, 0.0, 0.0]
    parked = simulated[0]._replace(gnss=still, imu=imu).write(tmp_path)
    said = complaint(ValueError, gym.make, INERTIAL, log=parked[:2])
    assert "never moves faster than 1.41 m/s" in said


def test_good_logs_pass(simulated, tmp_path):
    """No false alarm: other flights, straight ones, slow fixes, noisy fixes."""
    for seed, every in ((2, 10), (3, 100), (4, 20)):
        folder = tmp_path / str(seed)
        folder.mkdir()
        files = drive(duration=120.0, every=every, seed=seed)[0].write(folder)
        check_together(read_imu(files[0]), read_fixes(files[1]))
    imu, fixes = read_imu(files[0]), read_fixes(files[1])
    rng = np.random.default_rng(0)
    noisy = fixes.velocity + 2.0 * rng.standard_normal(fixes.velocity.shape)
    check_together(imu, replace(fixes, velocity=noisy))
