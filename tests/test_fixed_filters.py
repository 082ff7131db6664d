"""Fixed filters of the family in the contest: the same rules as for agents (about 10 s)."""

import json

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest import rollout as rollouts
from kfenv.agents.contest.evaluation import Contest, evaluate
from kfenv.agents.contest.rollout import draw_episodes, rollout, scenario_and_options
from kfenv.agents.contestants.agent import RecordingFilter
from kfenv.agents.contestants.registry import make_agent
from typer.testing import CliRunner

import kfenv  # noqa: F401
from kfenv.filters.designs import DESIGNS
from kfenv.filters.results import History
from kfenv.scenarios.radar.tracking import RadarTracking

TRACKING, VALIDATION = "kfenv/RadarTracking-v0", "kfenv/RadarValidation-v0"
SHORT = {"rate": 2.0, "duration": 20.0}


def play(name, recording, env=TRACKING, **options):
    return rollout(make_agent(name), env, SHORT | options, recording)


@pytest.fixture(scope="module")
def episodes():
    return draw_episodes(TRACKING, SHORT, "test", 3, 8)


@pytest.mark.parametrize("env", [TRACKING, VALIDATION])
def test_the_environments_own_filter_scores_as_fixed(env, monkeypatch):
    monkeypatch.setattr(RadarTracking, "lost_distance", 1000.0)
    recording = draw_episodes(env, SHORT, "test", 3, 20)
    fixed, family = (play(n, recording, env) for n in ("fixed", "srukf-joseph-exact"))
    np.testing.assert_allclose(family.rmse, fixed.rmse, rtol=1e-6)
    np.testing.assert_allclose(family.nees, fixed.nees, rtol=1e-6)
    np.testing.assert_array_equal(family.lost, fixed.lost)
    assert env == VALIDATION or fixed.lost.any(), "this draw is meant to hold lost tracks"


@pytest.mark.parametrize("name", sorted(set(DESIGNS) - {"lkf"}))
def test_every_design_takes_part(name, episodes):
    scores = play(name, episodes)
    limit = scenario_and_options(TRACKING, SHORT)[0].lost_distance
    assert np.all((scores.rmse > 0.0) & (scores.rmse < limit))


def test_the_filter_that_rounding_makes_diverge_loses_where_its_cure_does_not():
    """SPEC 2.3 and claim C1, over trajectory A's 250 s at 10 Hz."""
    recording = draw_episodes(VALIDATION, {}, "test", 0, 4)
    printed, cured = (
        rollout(make_agent(f"ekf-{form}"), VALIDATION, {}, recording)
        for form in ("unsymmetrised", "classical")
    )
    assert printed.lost.all() and printed.rmse.min() > 1e3
    assert not cured.lost.any() and cured.rmse.max() < 200.0


# -- the rules, on numbers small enough to check by hand -------------------------------


class Scripted(RecordingFilter):
    """So far off in x at every instant; fails where told to."""

    off: np.ndarray  # (B, T)
    failed_at: np.ndarray  # (B,)
    deviation = 10.0

    def check(self, scenario, options, recording):
        pass

    def filter(self, scenario, options, recording):
        assert recording.truth is None and recording.true_noise is None
        assert not any(recording.faults)
        chosen = [int(i) for i in recording.measurement[:, 0, 0]]
        mean = np.zeros((len(chosen), len(recording.time), 9))
        mean[:, :, 0] = self.off[chosen]
        for row, at in zip(mean, self.failed_at[chosen], strict=True):
            row[at if at >= 0 else len(row) :] = np.nan
        covariance = np.broadcast_to(self.deviation**2 * np.eye(9), (*mean.shape, 9))
        status = np.where(self.failed_at[chosen] >= 0, 3, 0)
        return History(mean, mean[..., 0], status, self.failed_at[chosen], covariance, None)


def script(off, failed_at, deviation=10.0, trace=False):
    """Scores of a scripted filter; the truth is the origin."""
    off = np.asarray(off, float)
    options = {"rate": 1.0, "duration": off.shape[1] - 1.0}
    drawn = draw_episodes(TRACKING, options, "test", 0, len(off))
    measurement = np.zeros(drawn.measurement.shape)
    measurement[:, :, 0] = np.arange(len(off))[:, None]
    recording = rollouts.replace(drawn, truth=np.zeros(drawn.truth.shape), measurement=measurement)
    contestant = Scripted("scripted")
    contestant.off, contestant.failed_at = off, np.array(failed_at)
    contestant.deviation = deviation
    return rollout(contestant, TRACKING, options, recording, trace=trace)


def test_scores_by_hand():
    far = 20e3
    scores = script([[3, 4, 0, 5], [6, far, 1, 1], [6, 8, 1, 1], [2, 2, 2, far]], [-1, -1, 2, -1])
    limit = 1e4**2
    squared = [9 + 16 + 25, 36 + 3 * limit, 36 + 64 + 2 * limit, 12 + limit]
    np.testing.assert_allclose(scores.rmse, np.sqrt(np.array(squared) / 4.0), rtol=1e-12)
    assert scores.lost.tolist() == [False, True, True, True]
    np.testing.assert_allclose(scores.nees[0], 50.0 / 100.0 / 4.0 / 3.0, rtol=1e-12)
    np.testing.assert_allclose(scores.nees[1], (36.0 + far**2) / 100.0 / 2.0 / 3.0, rtol=1e-12)


def test_traces_hold_every_instant():
    scores = script([[3, 4, 0, 5], [6, 7, 1, 1]], [-1, 2], trace=True)
    np.testing.assert_array_equal(scores.time, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(scores.error[:, 0], [3, 4, 0, 5])
    np.testing.assert_allclose(scores.error[:, 1], [6, 7, 1e4, 1e4])
    assert scores.factors.shape == (4, 2, 5) and np.all(scores.factors == 1.0)


def test_a_covariance_that_is_none_has_no_nees_but_a_score():
    scores = script([[3, 4, 0, 5]], [-1], deviation=0.0)
    assert np.isnan(scores.nees[0]) and np.isfinite(scores.rmse[0]) and not scores.lost[0]


def test_how_many_episodes_fit_into_memory_changes_no_bit(episodes, monkeypatch):
    whole = rollout(make_agent("ukf-joseph"), TRACKING, SHORT, episodes, trace=True)
    monkeypatch.setattr(rollouts, "HISTORY_SIZE", 3 * 41 * 81)
    parts = rollout(make_agent("ukf-joseph"), TRACKING, SHORT, episodes, trace=True)
    for name in ("rmse", "lost", "nees", "nis", "time", "error", "factors"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


# -- options and names -------------------------------------------------------------------


def test_unscented_filters_take_the_environments_kappa(episodes):
    cubature = play("srckf-joseph-exact", episodes, kappa=2.0)
    zero, two = (play("srukf-joseph-exact", episodes, kappa=k) for k in (0.0, 2.0))
    np.testing.assert_array_equal(zero.rmse, cubature.rmse)
    assert not np.array_equal(two.rmse, zero.rmse)


def test_the_linear_filter_is_for_linear_models(tmp_path):
    contest = Contest(TRACKING, SHORT, ("lkf",), 2, 0, 1, 0)
    with pytest.raises(ValueError, match=r"lkf is for linear models.*ekf-classical"):
        evaluate(contest, tmp_path / "out", processes=1)
    assert not (tmp_path / "out").exists()
    linear = "kfenv/BistaticTracking-v0"
    recording = draw_episodes(linear, {}, "test", 0, 5)
    make_agent("lkf").check(*scenario_and_options(linear, {}), recording)
    lkf, ckf = (rollout(make_agent(n), linear, {}, recording) for n in ("lkf", "srckf-classical"))
    np.testing.assert_allclose(lkf.rmse, ckf.rmse, rtol=1e-9)


def test_weights_that_do_not_exist_are_refused_before_anything_is_written(tmp_path):
    contest = Contest(TRACKING, SHORT | {"kappa": -1.0}, ("srukf-joseph",), 2, 0, 1, 0)
    with pytest.raises(ValueError, match="negative"):
        evaluate(contest, tmp_path / "out", processes=1)
    assert not (tmp_path / "out").exists()


def test_close_names_are_told():
    for wrong, right in (("ekf-josef", "ekf-joseph"), ("srukf_joseph_exact", "srukf-joseph-exact")):
        with pytest.raises(ValueError, match=f"Did you mean '{right}'"):
            make_agent(wrong)


def test_help_lists_every_name():
    text = " ".join(CliRunner().invoke(app, ["evaluate", "--help"]).output.split())
    assert all(name in text for name in DESIGNS)


def test_a_contest_of_fixed_filters(tmp_path):
    folder = tmp_path / "out"
    arguments = ["evaluate", TRACKING, "--output", str(folder), "--rate", "2", "--episodes", "3",
                 "--agent", "ekf-unsymmetrised", "--agent", "ekf-joseph", "--tuning-trials", "0",
                 "--processes", "1", "--option", "duration=100"]  # fmt: skip
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    results = json.loads((folder / "results.json").read_text())
    assert [r["agent"] for r in results] == ["fixed", "ekf-unsymmetrised", "ekf-joseph"]
    assert results[1]["anees"] is None and results[2]["anees"] > 0.0
    assert (folder / "episode.png").read_bytes().startswith(b"\x89PNG")
