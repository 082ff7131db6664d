"""What two or three files of a log must have in common: clock, gaps, mounting, truth."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from inertial_logs import CLOCK, car, drive
from rollouts import INERTIAL, play
from test_bad_input import complaint

from kfenv.scenarios.inertial.faults import RateStep
from kfenv.scenarios.inertial.files import check_together, read_fixes, read_imu
from kfenv.scenarios.inertial.reading import read_log

RATE = 20.0


@pytest.fixture(scope="module")
def simulated():
    return drive(rate=RATE, every=4)[0]


def without(table, *gaps):
    """The rows whose time since the log's begin is in none of the gaps."""
    time = table[:, 0] - CLOCK
    inside = [(time > begin) & (time < end) for begin, end in gaps]
    return table[~np.any(inside, axis=0)]


@pytest.mark.parametrize("seed", range(1, 5))
def test_gaps_of_the_fixes_are_no_fault(tmp_path, seed):
    """While the vehicle turns, a gap's chord is much shorter than the way."""
    good = drive(rate=RATE, every=4, seed=seed)[0]
    files = good._replace(gnss=without(good.gnss, (60.0, 100.0), (140.0, 260.0))).write(tmp_path)
    check_together(read_imu(files[0]), read_fixes(files[1]))
    read_log(files[:2], RATE)


def later(table):
    table[:, 0] += 1e6


def in_milliseconds(table):
    table[:, 0] = CLOCK + 0.001 * (table[:, 0] - CLOCK)


def far(table):
    table[:, 1] += 1.0


@pytest.mark.parametrize(("change", "said"), [
    (later, "have 0 s in common"),
    (in_milliseconds, "have 0.3 s in common"),
    (far, "the truth is usually 1.11e+05 m away from the fixes"),
])  # fmt: skip
def test_a_truth_of_another_clock_or_place_is_named(simulated, tmp_path, change, said):
    truth = simulated.truth.copy()
    change(truth)
    paths = simulated._replace(truth=truth).write(tmp_path)
    told = complaint(ValueError, read_log, paths, RATE)
    assert "truth.csv" in told and said in told


def test_a_truth_with_a_gap_is_refused(simulated, tmp_path):
    paths = simulated.write(tmp_path)
    whole = read_log(paths, RATE)
    begin = int(np.searchsorted(whole.row, 50.0 * RATE))
    whole = whole.window(begin, 40.0).truth
    simulated._replace(truth=without(simulated.truth, (60.0, 63.0))).write(tmp_path)
    bridged = read_log(paths, RATE).window(begin, 40.0).truth
    assert 0.0 < np.abs(whole - bridged).max() < 5.0
    simulated._replace(truth=without(simulated.truth, (60.0, 200.0))).write(tmp_path)
    assert "no truth for 140 s after t = 1060 s" in complaint(ValueError, read_log, paths, RATE)


@pytest.mark.parametrize("deviation", [0.008, 0.03])
def test_fixes_whose_times_jitter_are_pending_at_decisions(simulated, tmp_path, deviation):
    """The time tags jitter, and positions with them, as a receiver's do."""
    gnss = simulated.gnss.copy()
    off = deviation * np.random.default_rng(0).standard_normal(len(gnss))
    gnss[:, 0] += off
    gnss[:, 1] += np.degrees(off * gnss[:, 4] / 6.37e6)
    gnss[:, 2] += np.degrees(off * gnss[:, 5] / 6.37e6 / np.cos(np.radians(gnss[:, 1])))
    paths = simulated._replace(gnss=gnss).write(tmp_path)
    env = gym.make(INERTIAL, log=paths, rate=RATE, duration=40.0, faults="none").unwrapped
    heard = play(env, np.zeros((999, 5)), seed=0)
    pending = [np.isfinite(step[-1]["innovation_variance"]).all() for step in heard[:-1]]
    assert len(heard) == 202 and np.mean(pending[1:]) > 0.99
    errors = [step[-1]["position_error"] for step in heard]
    assert np.sqrt(np.mean(np.square(errors))) < 5.0


@pytest.mark.parametrize(("rate", "fits"), [(50.0, "48"), (20.0, "18"), (2.0, "3")])
def test_a_rate_that_the_fixes_drift_against_is_refused(tmp_path, rate, fits):
    paths = drive(60.0, 60.0, every=20)[0].write(tmp_path)  # a fix every third of a second
    said = complaint(ValueError, read_log, paths, rate)
    assert "has a fix every 0.333333 s" in said and said.endswith(f"set rate to {fits}.")
    assert read_log(paths, float(fits)).steps_per_fix == round(float(fits) / 3.0)


def mounted(axes, signs):
    """A change of an inertial file to another order and other signs of x, y, z."""

    def change(table):
        table[:, 1:4] = table[:, 1 + np.array(axes)] * signs
        table[:, 4:7] = table[:, 4 + np.array(axes)] * signs

    return change


def turned_gyroscopes(table):
    table[:, 4:6] *= -1.0


ACROSS, BACK = mounted([1, 0, 2], [1, -1, 1]), mounted([0, 1, 2], [-1, -1, 1])


@pytest.mark.parametrize(("change", "yaw"), [(ACROSS, "90"), (BACK, "180")])
def test_a_cars_unit_that_is_mounted_otherwise_is_measured(tmp_path, change, yaw):
    log = car(rate=RATE, every=4)[0]
    change(log.imu)
    said = complaint(ValueError, read_log, log.write(tmp_path)[:2], RATE)
    told = float(said.split("mounting=[")[1].split("]")[0].split(",")[2])
    assert abs(np.angle(np.exp(1j * np.radians(told - float(yaw))), deg=True)) < 2.0


@pytest.mark.parametrize("change", [ACROSS, BACK, turned_gyroscopes])
def test_an_aircrafts_unit_that_is_mounted_otherwise_is_named(tmp_path, change):
    log = drive(rate=RATE, every=4)[0]
    change(log.imu)
    paths = log.write(tmp_path)
    said = complaint(ValueError, read_log, paths[:2], RATE)
    assert "the samples miss the GNSS velocity by" in said and "x forward, y to the right" in said


@pytest.mark.parametrize("vehicle", [drive, car])
def test_a_poor_unit_rightly_mounted_passes(tmp_path, vehicle):
    """Biases of 0.3 m/s^2 and 1 deg/s."""
    log = vehicle(rate=RATE, every=4)[0]
    log.imu[:, 1:] += [0.3, -0.3, 0.3, 0.0175, -0.0175, 0.0175]
    read_log(log.write(tmp_path)[:2], RATE)


def in_feet(table):
    table[:, 3] /= 0.3048


def huge(table):
    table[5, 8] = 1e9


def tiny(table):
    table[5, 12] = 1e-9


@pytest.mark.parametrize(("change", "said"), [
    (in_feet, "height changes 3.21 times as much as 'vd' says"),
    (huge, "column 'sd_e' holds standard deviations"),
    (tiny, "column 'sd_vd' holds standard deviations"),
])  # fmt: skip
def test_heights_in_feet_and_impossible_deviations(simulated, tmp_path, change, said):
    gnss = simulated.gnss.copy()
    change(gnss)
    paths = simulated._replace(gnss=gnss).write(tmp_path)
    assert said in complaint(ValueError, read_log, paths[:2], RATE)


def test_a_unit_that_takes_gravity_out_is_named(simulated, tmp_path):
    imu = simulated.imu.copy()
    imu[:, 3] += 10.6
    paths = simulated._replace(imu=imu).write(tmp_path)
    assert "or gravity was taken out" in complaint(ValueError, read_log, paths[:2], RATE)


def test_axes_of_an_inertial_step_that_are_lists():
    said = complaint(ValueError, RateStep, axes=[[0]])
    assert "RateStep.axes must list body axes" in said


def test_the_checker_accepts_a_log_without_truth(simulated, tmp_path):
    paths = simulated.write(tmp_path)
    env = gym.make(INERTIAL, log=paths[:2], rate=RATE, duration=40.0).unwrapped
    check_env(env, skip_render_check=True)
