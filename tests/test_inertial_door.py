"""A log at the door: what two files tell of each other, is told, complained of and corrected."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from inertial_logs import Drive, car, drive, stop_and_go
from kfenv.agents.cli.app import app
from rollouts import INERTIAL
from test_bad_input import complaint
from typer.testing import CliRunner

from kfenv.models.rotations import matrix_from_angles
from kfenv.scenarios.inertial.files import check_together, read_fixes, read_imu
from kfenv.scenarios.inertial.measured import at_rest, clock_offset, mounting
from kfenv.scenarios.inertial.reading import read_log

RATE = 20.0
ANGLES = np.radians([6.0, -9.0, 30.0])
DATA = Path(__file__).parents[2] / "shared/data/ins"


@pytest.fixture(scope="module")
def level():
    return car(rate=RATE, every=4)[0]


def changed(log, change, folder):
    imu, gnss = log.imu.copy(), log.gnss.copy()
    change(imu, gnss)
    return Drive(imu, gnss, log.truth).write(folder)[:2]


def later(seconds):
    def change(imu, gnss):
        imu[:, 0] += seconds

    return change


def turned(imu, gnss):
    C = matrix_from_angles(ANGLES)  # from the unit's axes to the vehicle's
    imu[:, 1:4], imu[:, 4:7] = imu[:, 1:4] @ C, imu[:, 4:7] @ C


# ----- measured -------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", [0.0, -0.3, 1.0, 2.0, 5.0, 18.0])
def test_the_clocks_offset_is_estimated(level, tmp_path, seconds):
    paths = changed(level, later(seconds), tmp_path)
    offset = clock_offset(read_imu(paths[0]), read_fixes(paths[1]))
    assert abs(offset.value - seconds) < max(4.0 * offset.deviation, 0.02)
    assert offset.deviation < 0.1


def test_the_mounting_is_estimated(level, tmp_path):
    paths = changed(level, turned, tmp_path)
    found = mounting(read_imu(paths[0]), read_fixes(paths[1]))
    off = [np.degrees(a.value - true) for a, true in zip(found[:3], ANGLES, strict=True)]
    assert not found.mirrored
    assert abs(off[2]) < 4.0 * np.degrees(found.yaw.deviation) < 3.0
    assert np.abs(off[:2]).max() < 0.6  # as tilt counts what the accelerometers' biases are


def test_rest_is_measured(tmp_path):
    paths = stop_and_go().write(tmp_path)
    rest = at_rest(read_imu(paths[0]), read_fixes(paths[1]))
    assert 60.0 < rest.duration < 90.0
    np.testing.assert_allclose(rest.rate, 0.0005, atol=2e-4)
    assert rest.force == pytest.approx(9.81 - 0.03, abs=0.01)
    assert rest.gravity == pytest.approx(9.8058, abs=0.001)


def test_a_flight_tells_neither_mounting_nor_rest(tmp_path):
    paths = drive(rate=RATE, every=4)[0].write(tmp_path)
    imu, fixes = read_imu(paths[0]), read_fixes(paths[1])
    assert mounting(imu, fixes) is None and at_rest(imu, fixes) is None


# ----- complained of, and corrected -----------------------------------------------------


@pytest.mark.parametrize("seconds", [1.0, 2.0, 5.0, 18.0, -1.0])
def test_clocks_apart_are_refused_with_the_remedy(level, tmp_path, seconds):
    paths = changed(level, later(seconds), tmp_path)
    said = complaint(ValueError, read_log, paths, RATE)
    assert "by the turns its clock is" in said and len(said.splitlines()) == 1
    remedy = float(said.split("time_offset=")[1].split(",")[0])
    assert remedy == pytest.approx(-seconds, abs=0.1)
    read_log(paths, RATE, time_offset=remedy)


def test_a_turned_unit_is_refused_with_the_remedy(level, tmp_path):
    paths = changed(level, turned, tmp_path)
    said = complaint(ValueError, read_log, paths, RATE)
    remedy = [float(angle) for angle in said.split("mounting=[")[1].split("]")[0].split(",")]
    np.testing.assert_allclose(remedy, np.degrees(ANGLES), atol=1.5)
    keywords = {"log": paths, "rate": RATE, "duration": 40.0}
    assert "mounting=[" in complaint(ValueError, gym.make, INERTIAL, **keywords)
    gym.make(INERTIAL, mounting=remedy, **keywords)


def exchanged(imu, gnss):
    imu[:, 1:7] = imu[:, [2, 1, 3, 5, 4, 6]]


def negative(*columns):
    def change(imu, gnss):
        imu[:, columns] *= -1.0

    return change


@pytest.mark.parametrize(("change", "said"), [
    (negative(1), "change the sign of fx"), (negative(2), "change the sign of fy"),
    (exchanged, "exchange fx and fy"),
])  # fmt: skip
def test_mirrored_axes_of_a_car_are_named(level, tmp_path, change, said):
    assert said in complaint(ValueError, read_log, changed(level, change, tmp_path), RATE)


def wrong_scale(imu, gnss):
    imu[:, 1:4] *= 0.9


def wild_rates(imu, gnss):
    imu[:, 4:7] += np.radians(4.0)


@pytest.mark.parametrize(("change", "said"), [
    (wrong_scale, "at rest the specific force is 8.8"), (wild_rates, "at rest the angular rates"),
])  # fmt: skip
def test_wrong_units_at_rest(tmp_path, change, said):
    paths = changed(stop_and_go(), change, tmp_path)
    assert said in complaint(ValueError, read_log, paths, RATE)


def test_vu_given_as_vd_is_told_by_correlation(tmp_path):
    """Of hills too low for the usual check."""
    log, _ = car(rate=RATE, every=4)
    time = log.gnss[:, 0]
    log.gnss[:, 3] = 300.0 + 6.0 * np.sin(time / 20.0)
    log.gnss[:, 6] = 6.0 / 20.0 * np.cos(time / 20.0)
    paths = log.write(tmp_path)
    said = complaint(ValueError, check_together, read_imu(paths[0]), read_fixes(paths[1]))
    assert "height rises where 'vd' is positive" in said


def everything(imu, gnss):
    imu[:, 1:4] /= 9.81
    imu[:, 4:7] *= 400.0
    gnss[:, 1] *= 3.0
    gnss[:, 7] = 0.0


def test_all_complaints_come_at_once(level, tmp_path):
    with pytest.raises(ValueError) as caught:
        read_log(changed(level, everything, tmp_path), RATE)
    said = str(caught.value).splitlines()
    for line, part in zip(said, ("units of g", "deg/s", "'lat' reaches", "'sd_n'"), strict=True):
        assert part in line


# ----- clocks, rates and speeds as they are ---------------------------------------------


def test_the_gps_week_may_roll_over(level, tmp_path):
    def change(imu, gnss):
        for table in (imu, gnss):
            table[:, 0] = (table[:, 0] + 604_800.0 - 1_100.0) % 604_800.0

    log = read_log(changed(level, change, tmp_path), RATE)
    assert log.time[-1] - log.time[0] == pytest.approx(300.0)
    assert (np.diff(log.imu.time) > 0.0).all() and log.time[-1] > 604_800.0


def test_large_times_are_told_in_full(level, tmp_path):
    def change(imu, gnss):
        imu[:, 0] += 1.4e9
        imu[100:, 0] += 2.0

    said = complaint(ValueError, read_log, changed(level, change, tmp_path), RATE)
    assert "no sample for 2.05 s after t = 1400001004.95 s" in said


def test_an_odd_sampling_rate(tmp_path):
    log = car(60.0, 500.0 / 3.0, every=50)[0]  # 166.7 Hz, a fix every 0.3 s
    read = read_log(log.write(tmp_path)[:2], 100.0)
    assert read.steps_per_fix == 30
    np.testing.assert_allclose(read.samples.mean(axis=0), log.imu[:, 1:].mean(axis=0), atol=0.05)


def test_a_walker_is_fast_enough(tmp_path):
    rng = np.random.default_rng(0)
    log, states = car(rate=RATE, every=4)
    log.gnss[:, 4:7] = states[::4, 3:6] / 9.0 + 0.03 * rng.standard_normal((len(log.gnss), 3))
    log.gnss[:, 1:3] = log.gnss[0, 1:3] + (log.gnss[:, 1:3] - log.gnss[0, 1:3]) / 9.0
    log.gnss[:, 10:13] = 0.03
    fixes = read_fixes(log.write(tmp_path)[1])
    assert fixes.moving == 1.0 and np.hypot(*fixes.velocity[:, :2].T).max() < 2.2
    fixes = read_fixes(car(rate=RATE, every=4)[0].write(tmp_path)[1])
    assert fixes.moving == pytest.approx(1.41, abs=0.01)  # by deviations of 0.1 m/s


POS_HEADER = (
    "% program   : RTKPOST\n%  GPST                  latitude(deg) longitude(deg)  height(m)"
    "   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s)"
    "    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu    sdvne    sdveu    sdvun\n"
)


def solution(gnss, header=POS_HEADER):
    """RTKLIB's lines, by week and seconds."""
    lines = [
        f"2100 {t:.4f} {lat:.10f} {lon:.10f} {h:.4f} 1 9 {sn} {se} {sd} 0 0 0 0.0 0.0 "
        f"{vn:.5f} {ve:.5f} {-vd:.5f} {svn} {sve} {svd} 0 0 0"
        for t, lat, lon, h, vn, ve, vd, sn, se, sd, svn, sve, svd in gnss
    ]
    return header + "\n".join(lines)


def test_fixes_of_rtklib(level, tmp_path):
    imu, gnss, _ = level.write(tmp_path)
    pos = tmp_path / "fixes.pos"
    pos.write_text(solution(level.gnss))
    told, fixes = read_fixes(pos), read_fixes(gnss)
    for name in ("time", "place", "velocity", "deviation"):
        np.testing.assert_allclose(getattr(told, name), getattr(fixes, name), atol=1e-4)
    assert read_log((imu, str(pos)), RATE).steps_per_fix == 4
    pos.write_text(solution(level.gnss, POS_HEADER.replace("vu(m/s)", "vx(m/s)")))
    assert "out-outvel=on" in complaint(ValueError, read_fixes, pos)


def test_a_file_without_a_header(level, tmp_path):
    path = tmp_path / "bare.csv"
    np.savetxt(path, level.imu, "%.9g", ",")
    said = complaint(ValueError, read_imu, path)
    assert said.endswith("holds numbers, no names: put t,fx,fy,fz,wx,wy,wz above it.")


def test_the_command_tells_what_is_measured(level, tmp_path):
    paths = changed(level, later(1.0), tmp_path)
    told = CliRunner().invoke(app, ["inspect", *paths])
    assert told.exit_code == 0 and "inertial clock ahead by, s" in told.output
    assert "yaw of the unit in the vehicle, deg" in told.output


@pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data/ins is not there")
def test_a_real_drive_passes_and_tells():
    imu, fixes = read_imu(DATA / "imu_drive.csv"), read_fixes(DATA / "gnss_drive.csv")
    found, offset, rest = mounting(imu, fixes), clock_offset(imu, fixes), at_rest(imu, fixes)
    assert abs(offset.value) < 0.1 and abs(np.degrees(found.yaw.value)) < 2.0
    assert np.degrees(rest.rate[2]) == pytest.approx(-0.174, abs=0.02)
    assert rest.force == pytest.approx(9.934, abs=0.02)
