"""Fifteen states: biases, gravity, the turning Earth, and what a log teaches (about 8 s)."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pymap3d
import pytest
from inertial_logs import drive
from kfenv.agents.cli.app import app
from kfenv.agents.contest.outages import outage_errors
from rollouts import INERTIAL
from test_bad_input import complaint
from typer.testing import CliRunner

from kfenv.filters.reference import ReferenceFilter
from kfenv.models.namespaces import scalar
from kfenv.models.strapdown import GRAVITY, strapdown
from kfenv.models.strapdown_biases import EARTH_RATE, local_gravity, strapdown_with_biases
from kfenv.scenarios.inertial.flights import exact_samples
from kfenv.scenarios.inertial.ins_gnss import InsGnss

NOISE, DRIFT, TIME = (0.01, 0.02, 0.001), (1e-3, 1e-4), (100.0, 400.0)
DATA = Path(__file__).parents[2] / "shared/data/ins"
DRIVE = [str(DATA / name) for name in ("imu_drive.csv", "gnss_drive.csv")]
with_data = pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data/ins is not there")


def step_of(**keywords):
    return strapdown_with_biases(NOISE, DRIFT, TIME, **keywords).build(scalar).step


# ----- the model ------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_samples_less_their_biases_drive_the_plain_mechanisation(seed):
    rng = np.random.default_rng(seed)
    state, sample = rng.normal(size=9), rng.normal(size=6) - [0, 0, 10, 0, 0, 0]
    bias, dt = 0.1 * rng.normal(size=6), 0.02
    told = step_of()((*state, *bias), (*(sample + bias), GRAVITY, 0.8, 100.0), dt)
    plain = strapdown(NOISE).build(scalar).step(tuple(state), tuple(sample), dt)
    np.testing.assert_allclose(told[:9], plain, atol=1e-14)
    kept = np.repeat([1.0 - dt / 100.0, 1.0 - dt / 400.0], 3)
    np.testing.assert_allclose(told[9:], kept * bias, rtol=1e-14)


def test_noise_grows_with_time_in_every_state():
    factor = strapdown_with_biases(NOISE, DRIFT, TIME).build(scalar).noise_factor
    expected = 0.2 * np.repeat([*NOISE, *DRIFT], 3)
    np.testing.assert_allclose(factor((0.0,) * 15, (0.0,) * 9, 0.04), expected)


@pytest.mark.parametrize(("degrees", "height", "expected"), [
    (0.0, 0.0, 9.7803253359), (90.0, 0.0, 9.8321849379), (45.0, 0.0, 9.8061977694),
    (45.0, 1000.0, 9.8031117694),
])  # fmt: skip
def test_gravity_of_wgs_84(degrees, height, expected):
    assert local_gravity(np.radians(degrees), height) == pytest.approx(expected, abs=2e-9)


def test_on_the_turning_earth_a_constant_course_is_kept():
    """Samples of a level flight north-east, from its positions in the Earth's frame."""
    vn, ve, height, dt, count = 150.0, 200.0, 9000.0, 0.5, 1200
    flat = lambda lat: 1.0 - 6.69437999014e-3 * np.sin(lat) ** 2  # noqa: E731
    lat, lon = [0.8], [0.1]
    for _ in range(10 * count):
        across = 6378137.0 / np.sqrt(flat(lat[-1]))
        along = across * (1.0 - 6.69437999014e-3) / flat(lat[-1])
        lon.append(lon[-1] + 0.1 * dt * ve / (across + height) / np.cos(lat[-1]))
        lat.append(lat[-1] + 0.1 * dt * vn / (along + height))
    place = np.degrees(lat), np.degrees(lon), np.full(len(lat), height)
    track = np.stack(pymap3d.geodetic2ecef(*place), axis=1)
    velocity = np.gradient(track, 0.1 * dt, axis=0)
    acceleration = np.gradient(velocity, 0.1 * dt, axis=0)
    turning = np.array([0.0, 0.0, EARTH_RATE])
    pulled = acceleration + 2.0 * np.cross(turning, velocity)
    axes = np.stack([pymap3d.ecef2nedv(*axis, *place[:2]) for axis in np.eye(3)], axis=-1)
    axes = np.moveaxis(axes, 0, 1)  # (k, 3, 3): rows north, east, down
    force = np.einsum("kij,kj->ki", axes, pulled)
    force[:, 2] -= local_gravity(np.array(lat), height)
    spin = np.gradient(axes, 0.1 * dt, axis=0) @ axes.transpose(0, 2, 1)
    rate = np.stack([spin[:, 1, 2], spin[:, 2, 0], spin[:, 0, 1]], axis=1)
    rate += axes @ turning
    origin = local_gravity(lat[0], height), lat[0], height
    step, still = step_of(earth=True), step_of()
    state = deaf = (0.0, 0.0, 0.0, vn, ve, 0.0, *(0.0,) * 9)
    for sample in np.hstack([force, rate])[5 + 10 * np.arange(count)]:
        state, deaf = (f(x, (*sample, *origin), dt) for f, x in ((step, state), (still, deaf)))
    off, without = (np.abs(np.subtract(x[3:9], [vn, ve, 0, 0, 0, 0])) for x in (state, deaf))
    assert off[:3].max() < 0.05 and off[3:].max() < 2e-5
    assert without[:2].max() > 10.0 and without[3:].max() > 0.01


@pytest.mark.parametrize(("keywords", "said"), [
    ({"bias_drift": (0.1, -1.0)}, "bias_drift must hold 2 positive numbers"),
    ({"biases": True, "bias_time": (1.0, 100.0)}, "bias_time must hold two numbers of 10 s"),
    ({"biases": True, "earth": True}, "earth=True is for a log"),
])  # fmt: skip
def test_complaints(keywords, said):
    assert said in complaint(ValueError, gym.make, INERTIAL, **keywords)


# ----- simulated units ------------------------------------------------------------------


def test_biases_of_a_simulated_unit_are_states_and_found():
    scenario = InsGnss(
        biases=True, faults="none", duration=20.0, rate=20.0, measurement_rate=10.0,
        process_noise=(0.1, 0.05, 0.05), imu_bias=(0.3, 0.3), imu_instability=(0.02, 0.0),
        gnss_noise=(1.0, 0.1, 0.3),
    )  # fmt: skip
    recording = scenario.sample([np.random.default_rng(s) for s in range(6)])
    truth, samples = recording.truth, recording.motion_inputs
    assert truth.shape[2] == 15 and samples.shape[2] == 9
    exact = np.array([exact_samples(flight[:, :9], scenario.time) for flight in truth])
    white = samples[..., :6] - exact - truth[..., 9:]
    np.testing.assert_allclose(white[..., :3].std(), 0.3 * np.sqrt(0.2), rtol=0.1)
    run = ReferenceFilter(scenario.motion, scenario.sensor, "srukf-joseph-exact").run(recording)
    off = np.abs(run.mean[:, -1, 9:] - truth[:, -1, 9:])
    assert np.median(off[:, 3:]) < np.radians(0.05) and np.median(off[:, :3]) < 0.15


# ----- what a log teaches ---------------------------------------------------------------


def test_the_knob_of_the_biases_is_another_drift_and_nothing_else():
    keywords = {"biases": True, "duration": 4.0, "faults": "none", "filter": "srckf-joseph-exact"}
    drift = InsGnss(biases=True).bias_drift
    turned = gym.make(INERTIAL, **keywords, bias_drift=drift).unwrapped
    told = gym.make(INERTIAL, **keywords, bias_drift=tuple(3.0 * d for d in drift)).unwrapped
    names = [knob.name for knob in turned.core.knobs]
    action = np.zeros(len(names))
    action[names.index("bias_process_noise")] = np.log(9.0) / np.log(1e4)  # of the variance
    for env in (turned, told):
        env.reset(seed=3)
    for _ in range(30):
        ours, theirs = (env.step(a)[4] for env, a in ((turned, action), (told, 0.0 * action)))
    np.testing.assert_allclose(ours["estimate"], theirs["estimate"], rtol=1e-9, atol=1e-9)
    assert turned.core.factors[0, 1] == 1.0
    plain = gym.make(INERTIAL).unwrapped.core.knobs
    assert "bias_process_noise" not in [knob.name for knob in plain]


def test_a_window_begins_with_what_the_log_before_it_taught(tmp_path):
    """The unit's own biases, within what the taught covariance allows."""
    log = drive(duration=160.0, rate=20.0, every=4)[0].write(tmp_path)
    scenario = InsGnss(log=log[:2], rate=20.0, duration=25.0)
    late, early = scenario.recorded("test", 99), scenario.recorded("tuning", 99)
    bias = np.repeat([0.03, 0.0005], 3)
    factor = late.factor[-1][9:]
    normal = np.linalg.solve(np.linalg.cholesky(factor @ factor.T), late.mean[-1][9:] - bias)
    assert normal @ normal < 22.5  # chi-square, 6 degrees of freedom, 0.1 %
    deviation = [np.linalg.norm(r.factor[0][9:], axis=1) for r in (early, late)]
    assert (deviation[1] < 0.5 * deviation[0])[[0, 1, 3, 4]].all()
    again = InsGnss(log=log[:2], rate=20.0, duration=25.0)
    assert again._lessons is scenario._lessons


def test_outages_on_a_schedule_tile_the_part(tmp_path):
    log = drive(duration=160.0, rate=20.0, every=4)[0].write(tmp_path)
    scenario = InsGnss(log=log[:2], rate=20.0, duration=25.0)
    test = scenario.recorded("test", 99)
    assert len(test) == 4  # 80 s less the lead of 10 s, in steps of 15 s
    for episode in range(4):
        scored = np.flatnonzero(test.scored[episode])
        np.testing.assert_array_equal(scored, np.arange(204, 501, 4))
        assert np.isnan(test.measurement[episode, scored]).all()
        assert np.isfinite(test.measurement[episode, 4:201:4]).all()
    starts = scenario._log.apart(25.0, "test", 15.0)
    assert (np.diff(scenario._log.row[starts]) == 300).all()
    at = scenario.outages_at(scenario._log.time[scenario._log.row[starts]] + 10.0)
    np.testing.assert_array_equal(at.measurement, test.measurement)
    said = complaint(ValueError, scenario.outages_at, [1005.0])
    assert "an outage at t = 1005 s needs a window from 995 to 1020 s" in said


def test_the_command_needs_long_enough_outages_in_the_log(tmp_path):
    log = drive(duration=160.0, rate=20.0, every=4)[0].write(tmp_path)
    arguments = ["outages", *log[:2], "--rate", "20", "--begin", "1100", "--end", "1115"]
    told = CliRunner().invoke(app, [*arguments, "--option", "duration=20"])
    assert told.exit_code == 2 and "set duration to 25 or more" in told.output
    with pytest.raises(ValueError, match="only with a log"):
        outage_errors(INERTIAL, {}, "fixed", [10.0])


@with_data
def test_drift_on_a_real_drive():
    """A public script's loosely coupled filter: 10.6 m and 1.25 m after 15 s."""
    errors = outage_errors(
        INERTIAL, {"log": DRIVE, "duration": 25.0}, "fixed", np.arange(280.0, 521.0, 15.0)
    )
    horizontal, vertical = np.sqrt(np.mean(errors**2, axis=0))[-1]
    assert errors.shape == (17, 3, 2) and horizontal < 11.0 and vertical < 1.3
    assert (np.diff(np.sqrt(np.mean(errors**2, axis=0)), axis=0) > 0.0).all()
