"""E4 at few runs: the published case, local axes, SPEC's numbers for claim C10 (about 5 s)."""

import pickle

import numpy as np
import pymap3d
import pytest
from kfenv.agents.reproduction import gnss_tracking as e4
from kfenv.agents.reproduction.experiments import chosen_experiments
from kfenv.agents.reproduction.monte_carlo import Study, run_study

from kfenv.models.gnss.pseudorange import CHANNELS
from kfenv.models.namespaces import dual
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.trajectories import paper_trajectory

# Up to the end of the clock fault, at a filter rate that is quick: measurements come at 1 Hz.
RUNS, SHORT = 6, {"faults": "paper", "duration": 105.0, "rate": 2.0}
SOUND = tuple(m for m in e4.METHODS if m.label in ("EKF-J", "UKF-J", "SRUKF-J"))
UP = slice(6, 7)


def studied(scenario, methods, folder):
    study = Study("E4", scenario, methods, RUNS)
    found = run_study(study, folder, processes=1)
    return study, {label: e4.local(study, outcome) for label, outcome in found.items()}


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    return studied(GnssTracking(**SHORT), SOUND, tmp_path_factory.mktemp("right"))


def test_it_can_be_named():
    assert chosen_experiments("E4") == ("E4",)


def test_the_published_case_has_six_satellites_and_both_faults():
    scenario = e4.published()
    recording = scenario.episode(np.random.default_rng(0))
    spans = {fault.label: (fault.start, fault.stop) for fault in recording.faults[0]}
    assert spans == {"clock degradation": e4.FAULT, "PLL failure": e4.LOSS}
    count = np.isfinite(recording.measurement[0, :, :CHANNELS]).sum(axis=1)
    whole = np.isclose(recording.time % 1.0, 0.0)
    gone = (recording.time >= e4.LOSS[0]) & (recording.time < e4.LOSS[1])
    assert set(count[whole & ~gone]) == {6} and not count[~whole | gone].any()


def test_local_axes_give_the_published_trajectory_back():
    scenario = e4.published()
    truth = scenario.episode(np.random.default_rng(0)).truth[0]
    origin = np.zeros(11)
    origin[:9:3] = pymap3d.geodetic2ecef(*scenario.place)
    local = e4.turned(truth - origin, e4.rotation(scenario))
    np.testing.assert_allclose(local[:, :9], paper_trajectory("B", scenario.time), atol=1e-6)
    np.testing.assert_array_equal(local[:, 9:], truth[:, 9:])


def test_the_printed_jacobian_meets_the_same_episodes():
    printed = e4.PrintedJacobian(faults="paper", jacobian_step=1.0)
    assert pickle.loads(pickle.dumps(printed)) == printed
    one, other = (s.episode(np.random.default_rng(3)) for s in (e4.published(), printed))
    np.testing.assert_array_equal(one.measurement, other.measurement)
    np.testing.assert_array_equal(one.mean, other.mean)
    seed = zip(one.mean.T, np.eye(11)[:, None], strict=True)
    state = tuple(dual.Dual(value, slope) for value, slope in seed)
    inputs = tuple(one.sensor_inputs[:, 0].T)
    slopes = [
        np.stack([y.gradient for y in s.sensor.build(dual)(state, inputs)])[:, 0]
        for s in (e4.published(), printed)
    ]
    heard = np.isfinite(one.measurement[0, 0])
    np.testing.assert_allclose(slopes[0][heard][:, :9:3], slopes[1][heard][:, :9:3], atol=1e-9)
    assert np.abs(slopes[0][heard, 1] - slopes[1][heard, 1]).max() > 0.1


def test_the_clock_fault_is_survived_by_all_alike(right):
    study, outcomes = right
    assert not any(outcome.lost.any() for outcome in outcomes.values())
    for one, other, apart in (("UKF-J", "SRUKF-J", 1e-6), ("EKF-J", "UKF-J", 0.05)):
        settled = np.s_[:, study.time > e4.SETTLED, :9:3]
        difference = outcomes[one].error[settled] - outcomes[other].error[settled]
        assert np.abs(difference).max() < apart


def test_height_and_acceleration_suffer(right):
    study, outcomes = right
    inside, before = e4.inside(study), (study.time > e4.SETTLED) & (study.time < e4.FAULT[0])
    for outcome in outcomes.values():
        east, north, up = e4.rms(outcome, e4.POSITION, inside)
        assert east < 1.0 and north < 1.0 and 1.3 < up < 3.5  # SPEC C10: 0.4, 0.6, 2.1
        assert up > 1.3 * e4.rms(outcome, UP, before)[0]
        bent = [np.linalg.norm(e4.rms(outcome, e4.ACCELERATION, w)) for w in (before, inside)]
        assert bent[0] < 0.6 and 1.5 < bent[1] < 4.0  # SPEC C10: 0.3, 2


def test_the_printed_jacobian_is_paid_for_in_height(right, tmp_path):
    study, outcomes = studied(e4.PrintedJacobian(**SHORT), e4.JACOBIAN, tmp_path)
    (printed,) = outcomes.values()
    inside = e4.inside(study)
    up = e4.rms(printed, UP, inside)[0]
    assert up == pytest.approx(15.0, rel=0.35)  # SPEC 4.3
    assert up > 4.0 * e4.rms(right[1]["SRUKF-J"], UP, inside)[0]
