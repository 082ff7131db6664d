"""Constraints of a vehicle on wheels: what they measure, when, and what they are worth (5 s)."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from inertial_logs import car, stop_and_go
from kfenv.agents.contest.outages import outage_errors
from rollouts import INERTIAL
from scipy.spatial.transform import Rotation
from test_bad_input import complaint

from kfenv.models.namespaces import batch, scalar
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.vehicle_constraints import CHANNELS, with_constraints
from kfenv.scenarios.inertial.constraints import stands
from kfenv.scenarios.inertial.ins_gnss import InsGnss
from kfenv.scenarios.inertial.reading import read_log

DATA = Path(__file__).parents[2] / "shared/data/ins"
ALL = list(CHANNELS)


def test_what_they_measure():
    rng = np.random.default_rng(0)
    state = rng.normal(size=15)
    sensor = with_constraints(navigation_fix(attitude=False), ALL)
    told = sensor.build(scalar)(tuple(state), ())
    body = Rotation.from_euler("ZYX", state[8:5:-1]).inv().apply(state[3:6])
    np.testing.assert_allclose(told, [*state[:6], *body[1:], *state[3:6], *state[12:]], atol=1e-14)
    assert len(told) == len(sensor.channels)
    assert sensor.groups == ("position", "velocity", *ALL)
    several = sensor.build(batch)(tuple(np.tile(state[:, None], 3)), ())
    np.testing.assert_allclose(several, np.tile(np.array(told)[:, None], 3), atol=1e-15)


def test_without_a_name_the_sensor_is_the_same():
    sensor = navigation_fix()
    assert with_constraints(sensor, []) is sensor


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return stop_and_go().write(tmp_path_factory.mktemp("stops"))[:2]


def test_they_hold_in_outages_and_at_rest_by_the_samples_alone(log):
    scenario = InsGnss(log=log, rate=20.0, duration=30.0, constraints=ALL[::-1])
    recording = scenario.outages_at([1144.0])  # 20 s before: it stands until 1170 s, from 1150 on
    arrived = ~np.isnan(recording.measurement[0])
    assert recording.measurement.shape[2] == 6 + 2 + 3 + 3
    due = np.arange(5, 601, 5)
    np.testing.assert_array_equal(np.flatnonzero(arrived[:, 6]), due)
    clock = 1144.0 - 15.0 + scenario.time
    still = np.flatnonzero(arrived[:, 8])
    assert np.isin(still, due).all() and (clock[still] > 1150.0).all()
    assert len(still) > 15 and np.isnan(recording.measurement[0, still, :6]).all()
    np.testing.assert_array_equal(arrived[:, 11:], arrived[:, 8:11])
    rates = recording.measurement[0, still, 11:]
    np.testing.assert_allclose(rates.mean(axis=0), 0.0005, atol=2e-4)  # the unit's own bias
    assert (recording.noise[0, :, 6:8] == 0.5).all()


def test_where_rest_and_motion_shake_alike_it_never_stands(tmp_path):
    assert stands(read_log(stop_and_go().write(tmp_path)[:2], 20.0)).any()
    assert not stands(read_log(car(rate=20.0, every=5)[0].write(tmp_path)[:2], 20.0)).any()


def test_each_has_its_noise_knob(log):
    env = gym.make(INERTIAL, log=log, rate=20.0, duration=30.0, constraints=["zero_velocity"])
    names = [knob.name for knob in env.unwrapped.core.knobs]
    assert names[-2:] == ["zero_velocity_noise", "bias_process_noise"] and len(names) == 6


@pytest.mark.parametrize(("keywords", "said"), [
    ({"constraints": ["zero_velocty"]}, "Did you mean 'zero_velocity'?"),
    ({"constraints": "zero_velocity"}, "constraints must be a list of"),
    ({"constraints": ["zero_rate"], "biases": False}, "needs biases=True"),
    ({"constraint_noise": (1.0, 0.0, 1.0)}, "constraint_noise must hold 3 positive numbers"),
])  # fmt: skip
def test_complaints(log, keywords, said):
    assert said in complaint(ValueError, gym.make, INERTIAL, log=log, rate=20.0, **keywords)


def test_simulated_units_fly():
    said = complaint(ValueError, gym.make, INERTIAL, constraints=["non_holonomic"])
    assert "simulated units fly" in said


@pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data/ins is not there")
def test_drift_on_a_real_drive_is_less():
    """A public script with non-holonomic constraints: 8.8 m and 1.6 m after 15 s."""
    files = [str(DATA / name) for name in ("imu_drive.csv", "gnss_drive.csv")]
    keywords = {"log": files, "duration": 25.0, "rate": 20.0, "filter": "srukf-joseph-prior",
                "constraints": ALL}  # fmt: skip
    errors = outage_errors(INERTIAL, keywords, "fixed", np.arange(280.0, 521.0, 15.0))
    horizontal, vertical = np.sqrt(np.mean(errors**2, axis=0))[-1]
    assert horizontal < 7.0 and vertical < 1.6
