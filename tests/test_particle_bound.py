"""The particle filter: priors as the faults draw them, exact weights, the filter as its limit."""

from dataclasses import replace

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.limit import Limit, measure_limit
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contestants.particles import bound, hypotheses
from kfenv.agents.contestants.particles.bound import ParticleBound, systematic
from kfenv.agents.contestants.particles.hypotheses import STRATA, Situation, choose
from kfenv.agents.contestants.particles.priors import NoisePriors, start_chances
from kfenv.agents.contestants.registry import make_agent
from scipy.stats import multivariate_normal
from typer.testing import CliRunner

from kfenv.scenarios.faults import Jamming
from kfenv.scenarios.radar.tracking import RadarTracking

ENV, KEYWORDS = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 20.0}


def test_bursts_start_as_often_as_the_fault_draws_them():
    time, jamming, rng = np.arange(0.0, 60.5, 0.5), Jamming(), np.random.default_rng(0)
    at_risk, started = np.zeros((2, len(time), 4))
    for _ in range(20_000):
        lengths = rng.uniform(*jamming.duration, rng.integers(1, 3, endpoint=True))
        starts = np.sort(rng.uniform(0.0, 60.0 - lengths))
        before = np.searchsorted(starts, time - 0.5)
        after = np.searchsorted(starts, time)
        at_risk[np.arange(len(time)), before] += 1
        started[np.arange(len(time)), before] += after > before
    chances = start_chances(time, jamming)
    assert chances[0].max() == 0.0
    enough = at_risk > 2000
    enough[0] = False
    assert enough.sum() > 150
    error = np.sqrt(chances * (1.0 - chances) / np.maximum(at_risk, 1.0))
    off = np.abs(started / np.maximum(at_risk, 1.0) - chances)
    # two starts in one step count as one here: half of the square of the chance
    assert np.all(off[enough] <= (5.0 * error + chances**2)[enough])


def test_weights_and_draws_are_bayes():
    """Against all hypotheses written out, with the covariance in full."""
    rng, m, rows = np.random.default_rng(1), 3, 40_000
    slope, drive = rng.normal(size=(m, 4)), rng.normal(size=(m, 4))
    told, misreport = np.array([1.0, 2.0, 0.5]), np.array([0.3, -0.2, 0.0])
    innovation = np.array([3.0, np.nan, -4.0])
    process_noise, glint = np.array([0.1, 10.0]), np.array([0.5, 0.2, 8.0])
    start, ending, factor, dt = np.array([0.1, 0.05]), (5.0, 25.0), (2.0, 31.0), 2.0
    situation = Situation(
        np.full(rows, 4.0), np.full(rows, 6.0), np.ones(rows, int), np.zeros(rows, int),
        np.full(rows, 3), np.tile(misreport, (rows, 1)), np.zeros(rows, int),
    )  # fmt: skip
    uniform, offset = rng.random((rows, 2)), 0.5
    uniform[:, 1] = offset
    deviation, log_weight = np.empty((rows, m)), np.zeros(rows)
    choose(
        np.tile(innovation, (rows, 1)), np.tile(slope, (rows, 1, 1)), np.tile(drive, (rows, 1, 1)),
        np.tile(told, (rows, 1)), dt, process_noise, 0.3, start, ending, factor, glint, uniform,
        situation, deviation, log_weight,
    )  # fmt: skip
    ends = (2.0 / 20.0) / (1.0 - 1.0 / 20.0)
    strata = 2.0 * 15.5 ** ((np.arange(STRATA) + offset) / STRATA)
    noises = [(4.0, 0.95 * (1.0 - ends)), (1.0, 0.95 * ends)]
    noises += [(max(f, 4.0), 0.05 / STRATA) for f in strata]
    quiet = 0.5 * 0.8**3
    glinting = 0.2 * quiet / (quiet + 0.5)
    here, weights = [0, 2], {}
    for q, moving in enumerate((0.7, 0.3)):
        for k, (scale, chance) in enumerate(noises):
            for g, outlying in enumerate((1.0 - glinting, glinting)):
                S = slope @ slope.T + process_noise[q] * drive @ drive.T
                S += np.diag((told * np.exp(misreport) * scale * (8.0 if g else 1.0)) ** 2)
                density = multivariate_normal.pdf(innovation[here], cov=S[np.ix_(here, here)])
                weights[q, k, g] = moving * chance * outlying * density
    total = sum(weights.values())
    np.testing.assert_allclose(log_weight, np.log(total * 2.0 * np.pi), rtol=1e-10)
    for name, index in (("motion", 0), ("glints", 2)):
        expected = sum(w for key, w in weights.items() if key[index] == 1) / total
        seen = np.mean(getattr(situation, name) == 1)
        assert abs(seen - expected) < 5.0 * np.sqrt(expected * (1.0 - expected) / rows)
    over = sum(w for key, w in weights.items() if key[1] == 1) / total
    assert abs(np.mean(situation.factor == 1.0) - over) < 5.0 * np.sqrt(over / rows)


def test_an_episode_that_has_glinted_may_glint_again():
    glint = np.array([0.5, 0.1, 8.0])
    assert hypotheses._glint_chance(0, 0, glint) == pytest.approx(0.05)
    assert hypotheses._glint_chance(1, 50, glint) == 0.1
    assert hypotheses._glint_chance(0, 500, glint) < 1e-20


def test_systematic_resampling_keeps_the_weights():
    weight = np.array([0.5, 0.25, 0.25, 0.0])
    np.testing.assert_array_equal(
        np.bincount(systematic(weight, np.random.default_rng(0)), minlength=4), [2, 1, 1, 0]
    )


def test_without_anything_to_guess_it_is_the_filter(monkeypatch):
    monkeypatch.setattr(bound, "PROCESS_NOISE", np.array([1.0]))
    keywords = KEYWORDS | {"faults": "none"}
    recording = draw_episodes(ENV, keywords, "test", 0, 3)
    scores = rollout(ParticleBound("bound", particles=4), ENV, keywords, recording)
    fixed = rollout(make_agent("fixed"), ENV, keywords, recording)
    np.testing.assert_allclose(scores.rmse, fixed.rmse, rtol=1e-9)
    np.testing.assert_allclose(scores.nees, fixed.nees, rtol=1e-6)


def test_it_passes_the_rules_and_splits_as_one_likes():
    recording = draw_episodes(ENV, KEYWORDS, "test", 0, 24)
    particles, rule = ParticleBound("bound", particles=48), make_agent("hmm-noise")
    whole, other = (rollout(one, ENV, KEYWORDS, recording) for one in (particles, rule))
    assert np.mean(np.log(whole.rmse / other.rmse)) < -0.05
    alone = rollout(particles, ENV, KEYWORDS, recording[[7]])
    assert alone.rmse[0] == whole.rmse[7]


def test_faults_that_it_does_not_know_are_refused():
    scenario, recording = RadarTracking(rate=2.0), draw_episodes(ENV, KEYWORDS, "test", 0, 1)
    for faults, complaint in (
        ((Jamming(), Jamming()), "one Jamming"),
        ((Jamming(start=3.0),), "start is drawn"),
    ):
        with pytest.raises(ValueError, match=complaint):
            NoisePriors.of(replace(scenario, faults=faults), recording)


def test_the_command_resumes_and_tells_its_error(tmp_path):
    limit = Limit(ENV, {"rate": 2.0, "duration": 5.0}, episodes=12, particles=4, repeats=2)
    summary = measure_limit(limit, tmp_path / "out", processes=1)
    assert summary["rmse_median"]["std"] > 0.0
    (tmp_path / "out" / "blocks" / "repeat1-episode10.npz").unlink()
    done = []
    again = measure_limit(limit, tmp_path / "out", 1, True, advance=lambda: done.append(1))
    assert again == summary and len(done) == 4
    with pytest.raises(FileExistsError, match="not empty"):
        measure_limit(limit, tmp_path / "out")
    with pytest.raises(ValueError, match="another run"):
        measure_limit(replace(limit, particles=5), tmp_path / "out", resume=True)
    with pytest.raises(ValueError, match="repeats must be at least 2"):
        replace(limit, repeats=1)
    place = ["--faults", '{"jamming": {"start": 3}}', "--output", str(tmp_path / "x")]
    told = CliRunner().invoke(app, ["limit", ENV, *place])
    assert told.exit_code == 2 and not (tmp_path / "x").exists()
