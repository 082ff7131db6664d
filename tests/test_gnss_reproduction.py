"""E4 at few runs: the papers' case, local axes, SPEC's numbers for claim C10 (about 15 s)."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.reproduction import gnss_claims, gnss_tracking
from kfenv.agents.reproduction import gnss_errors as e4
from kfenv.agents.reproduction.claims import FAILS, HOLDS
from kfenv.agents.reproduction.experiments import chosen_experiments
from kfenv.agents.reproduction.gnss_pseudoranges import fix_errors, gnss_only, pseudorange_errors
from kfenv.agents.reproduction.monte_carlo import Study, run_study
from typer.testing import CliRunner

from kfenv.models.gnss.pseudorange import BIAS, CHANNELS
from kfenv.models.namespaces import batch, dual
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.trajectories import paper_trajectory

# Up to the end of the clock fault, at a filter rate that is quick: measurements come at 1 Hz.
RUNS, SHORT = 6, {"faults": "paper", "duration": 105.0, "rate": 2.0}
SOUND = tuple(m for m in gnss_tracking.METHODS if m.label in ("EKF-J", "UKF-J", "SRUKF-J"))
UP = slice(6, 7)
ALMANAC = Path(__file__).parents[1] / "../shared/data/almanac/gps-week0862-319488.yuma"


def studied(scenario, methods, folder):
    study = Study("E4", scenario, methods, RUNS)
    found = run_study(study, folder, processes=1)
    return study, {label: e4.local(study, outcome) for label, outcome in found.items()}


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    return studied(GnssTracking(**SHORT), SOUND, tmp_path_factory.mktemp("right"))


def test_it_can_be_named():
    assert chosen_experiments("E4") == ("E4",)


def test_the_papers_case_has_six_satellites_and_both_faults():
    scenario = gnss_tracking.papers_case()
    recording = scenario.episode(np.random.default_rng(0))
    spans = {fault.label: (fault.start, fault.stop) for fault in recording.faults[0]}
    assert spans == {"clock degradation": e4.FAULT, "PLL failure": e4.LOSS}
    count = np.isfinite(recording.measurement[0, :, :CHANNELS]).sum(axis=1)
    whole = np.isclose(recording.time % 1.0, 0.0)
    gone = (recording.time >= e4.LOSS[0]) & (recording.time < e4.LOSS[1])
    assert set(count[whole & ~gone]) == {6} and not count[~whole | gone].any()


def test_local_axes_give_trajectory_b_back():
    scenario = gnss_tracking.papers_case()
    truth = scenario.episode(np.random.default_rng(0)).truth[0]
    origin = np.zeros(11)
    origin[:9:3] = pymap3d.geodetic2ecef(*scenario.place)
    local = e4.turned(truth - origin, e4.rotation(scenario))
    np.testing.assert_allclose(local[:, :9], paper_trajectory("B", scenario.time), atol=1e-6)
    np.testing.assert_array_equal(local[:, 9:], truth[:, 9:])


def test_the_printed_jacobian_meets_the_same_episodes():
    printed = gnss_tracking.PrintedJacobian(faults="paper", jacobian_step=1.0)
    assert pickle.loads(pickle.dumps(printed)) == printed
    one, other = (
        s.episode(np.random.default_rng(3)) for s in (gnss_tracking.papers_case(), printed)
    )
    np.testing.assert_array_equal(one.measurement, other.measurement)
    np.testing.assert_array_equal(one.mean, other.mean)
    seed = zip(one.mean.T, np.eye(11)[:, None], strict=True)
    state = tuple(dual.Dual(value, slope) for value, slope in seed)
    inputs = tuple(one.sensor_inputs[:, 0].T)
    slopes = [
        np.stack([y.gradient for y in s.sensor.build(dual)(state, inputs)])[:, 0]
        for s in (gnss_tracking.papers_case(), printed)
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
    study, outcomes = studied(
        gnss_tracking.PrintedJacobian(**SHORT), gnss_tracking.JACOBIAN, tmp_path
    )
    (printed,) = outcomes.values()
    inside = e4.inside(study)
    up = e4.rms(printed, UP, inside)[0]
    assert up == pytest.approx(15.0, rel=0.35)  # SPEC 4.3
    assert up > 4.0 * e4.rms(right[1]["SRUKF-J"], UP, inside)[0]


# ----- claims -----------------------------------------------------------------------------


def test_figure_16_claims_a_better_acceleration(right):
    """One estimator cannot be better than itself; a rival twice as far off is worse."""
    study, outcomes = right
    claim = gnss_claims.acceleration(study, outcomes)
    assert claim.printed == "S0 Fig. 16" and claim.verdict == FAILS
    worse = {
        label: outcome if label == "SRUKF-J" else outcome._replace(error=2.0 * outcome.error)
        for label, outcome in outcomes.items()
    }
    assert gnss_claims.acceleration(study, worse).verdict == HOLDS


# ----- pseudoranges by themselves ---------------------------------------------------------


def exact_ranges(scenario, recording):
    states = tuple(np.moveaxis(recording.truth, 2, 0))
    inputs = tuple(np.moveaxis(recording.sensor_inputs, 2, 0))
    exact = np.stack(scenario.sensor.build(batch)(states, inputs), axis=2)
    return np.where(np.isfinite(recording.measurement), exact, np.nan)


def test_single_epochs_are_solved_and_a_common_error_is_the_clocks():
    scenario = gnss_tracking.papers_case()
    recording = scenario.episode(np.random.default_rng(0))
    kept = np.arange(0, 2501, 10)
    exact = exact_ranges(scenario, recording)
    error = fix_errors(replace(recording, measurement=exact), kept)
    gone = (recording.time[kept] >= e4.LOSS[0]) & (recording.time[kept] < e4.LOSS[1])
    assert np.isnan(error[:, gone]).all()
    columns = [0, 3, 6, BIAS]
    assert np.abs(error[:, ~gone][..., columns]).max() < 1e-6
    shifted = fix_errors(replace(recording, measurement=exact + 1000.0), kept)[:, ~gone]
    assert np.abs(shifted[..., columns] - [0.0, 0.0, 0.0, 1000.0]).max() < 1e-6


def test_gnss_alone_is_worse_than_a_filter_and_does_not_feel_the_clock(right):
    study, outcomes = right
    alone = e4.local(study, gnss_only(study))
    inside, before = e4.inside(study), (study.time > e4.SETTLED) & (study.time < e4.FAULT[0])
    calm, fault = (e4.rms(alone, e4.POSITION, when) for when in (before, inside))
    np.testing.assert_allclose(fault, calm, rtol=0.25)
    assert (fault > 2.0 * e4.rms(outcomes["SRUKF-J"], e4.POSITION, inside)).all()


def test_pseudoranges_are_taken_apart():
    errors = pseudorange_errors(gnss_tracking.papers_case(), seed=0)
    heard = np.isfinite(errors.troposphere)
    assert len(errors.time) == 251 and (heard.sum(axis=1) == 6).all()
    assert 2.0 < errors.troposphere[heard].min() and errors.troposphere[heard].max() < 14.0
    assert 0.0 < np.abs(errors.left[heard]).max() < 0.05
    fault = (errors.time >= e4.FAULT[0]) & (errors.time < e4.FAULT[1])
    assert np.nanstd(errors.error[~fault]) < 4.0 and np.nanstd(errors.error[fault]) > 75.0
    assert np.nanmax(np.nanstd(errors.error[fault], axis=1)) < 8.0  # common to all


# ----- the command ------------------------------------------------------------------------


@pytest.mark.skipif(not ALMANAC.exists(), reason="no almanac in ../shared/data")
def test_it_flies_an_almanac(tmp_path, monkeypatch):
    """The whole experiment, figures included, with a filter step per measurement."""
    flown = []

    def short(almanac):
        flown.append(almanac)
        return GnssTracking(faults="paper", duration=180.0, rate=1.0, almanac=almanac)

    monkeypatch.setattr(gnss_tracking, "papers_case", short)
    arguments = ["reproduce", "E4", "--runs", "2", "--processes", "1", "--output", tmp_path / "out"]
    result = CliRunner().invoke(app, [str(a) for a in [*arguments, "--almanac", ALMANAC]])
    assert result.exit_code == 0, result.output
    assert set(flown) == {str(ALMANAC.resolve())}
    claims = json.loads((tmp_path / "out" / "claims.json").read_text())
    assert claims[0]["name"] == "C10 (E4)" and len(claims) == 6
    assert "6 satellites" not in claims[0]["measured"]
    drawn = {path.stem for path in (tmp_path / "out" / "E4").glob("*.png")}
    assert {"rmse_gnss_only", "pseudorange_errors", "accelerations"} <= drawn


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["E5", "--almanac", __file__], "E4"), (["E4", "--almanac", __file__], "no YUMA almanac"),
     (["all", "--almanac", "no such file"], "No such file")],
)  # fmt: skip
def test_an_almanac_that_cannot_be_flown_is_refused_at_once(tmp_path, arguments, said):
    result = CliRunner().invoke(app, ["reproduce", *arguments, "--output", str(tmp_path / "out")])
    assert result.exit_code == 2 and said in " ".join(result.output.split())
    assert not (tmp_path / "out").exists()
