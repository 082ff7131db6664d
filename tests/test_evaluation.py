"""A contest is paired, repeatable, resumable and leaves its folder whole."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from dead_runs import die_writing, somebody_working_in
from kfenv.agents.contest.cost import relative_cost
from kfenv.agents.contest.evaluation import Contest, evaluate
from kfenv.agents.contest.formatting import improvement, ratio
from kfenv.agents.contest.intervals import FEWEST, mean_interval, median_interval
from kfenv.agents.contest.rollout import (
    SPLITS,
    draw_episodes,
    episode_rngs,
    rollout,
    scenario_and_options,
)
from kfenv.agents.contest.scores import Scores, read_scores
from kfenv.agents.contest.summary import summarise
from kfenv.agents.contest.tuning import tune
from kfenv.agents.contestants.fixed import Fixed, FixedTuned
from kfenv.agents.contestants.registry import make_agent
from kfenv.agents.files import write_json

import kfenv  # noqa: F401
from kfenv.filters.engine import Engine

ENV = "kfenv/RadarTracking-v0"
SHORT = {"rate": 2.0, "duration": 20.0}
LINEAR = "kfenv/BistaticTracking-v0"
QUICK = {
    "env_id": LINEAR, "env_kwargs": {"duration": 2.0}, "agents": (), "episodes": 2,
    "tuning_trials": 0,
}  # fmt: skip


def small(**changes):
    options = {
        "env_id": ENV, "env_kwargs": SHORT, "agents": ("huber-gate", "clairvoyant"),
        "episodes": 6, "seed": 3, "tuning_episodes": 3, "tuning_trials": 3,
    }  # fmt: skip
    return Contest(**(options | changes))


def bare(results):
    """Results without what depends on the machine."""
    return [{key: value for key, value in result.items() if key != "cost"} for result in results]


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contest") / "out"
    return folder, evaluate(small(), folder, processes=1)


def test_results_hold_what_is_promised(evaluated):
    folder, results = evaluated
    stored = json.loads((folder / "results.json").read_text())
    assert stored == json.loads(json.dumps(results))
    assert [r["agent"] for r in stored] == ["fixed", "fixed-tuned", "huber-gate", "clairvoyant"]
    for result in stored:
        for key in ("agent", "env", "episodes", "rmse", "rmse_median", "rmse_p95", "track_loss",
                    "rmse_geometric_mean", "anees", "nis", "cost", "improvement_over_fixed",
                    "ci_low", "ci_high"):  # fmt: skip
            assert key in result
        assert result["ci_low"] <= result["improvement_over_fixed"] <= result["ci_high"]
    assert stored[0]["improvement_over_fixed"] == 0.0


def test_improvement_is_the_median_of_paired_ratios(evaluated):
    folder, results = evaluated
    ratio = read_scores(folder, "clairvoyant").rmse / read_scores(folder, "fixed").rmse
    assert results[3]["improvement_over_fixed"] == pytest.approx(np.median(1.0 - ratio))


def test_a_contest_repeats(evaluated, tmp_path):
    again = evaluate(small(), tmp_path / "again", processes=2)
    assert json.dumps(bare(again)) == json.dumps(bare(evaluated[1]))


def test_agents_meet_the_same_episodes():
    recordings = [draw_episodes(ENV, SHORT, "test", 3, 4) for _ in range(2)]
    for name in ("measurement", "noise", "mean", "truth"):
        np.testing.assert_array_equal(*(getattr(r, name) for r in recordings))


def test_splits_and_training_never_share_a_stream():
    states = [
        tuple(rng.bit_generator.state["state"].values())
        for split in SPLITS
        for seed in range(3)
        for rng in episode_rngs(split, seed, 20)
    ]
    states += [
        tuple(np.random.default_rng(seed).bit_generator.state["state"].values())
        for seed in range(200)
    ]
    assert len(set(states)) == len(states)


def test_fixed_agent_scores_as_the_engine_run():
    recording = draw_episodes(ENV, SHORT, "test", 3, 5)
    scenario, _ = scenario_and_options(ENV, SHORT)
    run = Engine(scenario.motion, scenario.sensor).run(recording)
    off = (run.mean - recording.truth)[..., list(scenario.motion.position)]
    rmse = np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=1))
    scores = rollout(make_agent("fixed"), ENV, SHORT, recording)
    kept = ~scores.lost
    assert kept.sum() >= 3
    np.testing.assert_allclose(scores.rmse[kept], rmse[kept], rtol=1e-9)


def test_a_lost_track_counts_to_the_end():
    recording = draw_episodes(ENV, SHORT, "test", 3, 8)
    scores = rollout(make_agent("random"), ENV, SHORT, recording, trace=True)
    assert scores.lost.any(), "random knobs are expected to lose a track here"
    for i in np.flatnonzero(scores.lost):
        assert scores.rmse[i] > 0.1 * scenario_and_options(ENV, SHORT)[0].lost_distance


def test_tuning_never_worsens_the_tuning_episodes():
    recording = draw_episodes(ENV, SHORT, "tuning", 0, 6)
    for name in ("fixed-tuned", "clairvoyant"):
        tried = []
        agent = make_agent(name)
        tuned = tune(agent, ENV, SHORT, recording, 10, 0, lambda tried=tried: tried.append(1))
        before, after = (
            np.mean(np.log(rollout(a, ENV, SHORT, recording).rmse)) for a in (agent, tuned)
        )
        assert after <= before
        parameters = len(tuned.values)
        assert parameters <= len(tried) <= 10 * parameters


@pytest.mark.parametrize("interval", [median_interval, mean_interval])
def test_intervals_cover(interval):
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(100):
        low, high = interval(rng.normal(size=60), trial)
        hits += low <= 0.0 <= high
    assert 88 <= hits <= 100


@pytest.mark.parametrize("count", [2, 4, 6, 9, 15, 29])
def test_intervals_of_few_episodes_cover_or_are_none(count):
    rng = np.random.default_rng(1)
    trials = rng.normal(size=(400, count))
    cases = [(median_interval, np.exp(trials), 1.0), (mean_interval, trials, 0.0)]
    for interval, samples, truth in cases:
        told = [interval(values, 0) for values in samples]
        if count < FEWEST:
            assert set(told) == {(None, None)}
        else:
            assert np.mean([low <= truth <= high for low, high in told]) >= 0.925


def test_intervals_of_many_values_take_little_memory_and_are_those_of_the_bootstrap():
    values = np.random.default_rng(3).exponential(size=20_000)
    for interval in (median_interval, mean_interval):
        resampled, told = interval(values, 0), interval(np.append(values, 1.0), 0)
        np.testing.assert_allclose(told, resampled, atol=0.15 * np.ptp(resampled))


def test_where_an_error_is_exactly_zero_json_stays_valid(tmp_path):
    exact = Scores(np.zeros(7), np.zeros(7, bool), np.full(7, np.inf), np.full((7, 1), np.nan), 1.0)
    other = replace(exact, rmse=np.arange(7.0))
    scores = {"fixed": exact, "fixed-tuned": other}
    results = [summarise(name, scores, "fixed", (), 0) for name in scores]
    assert results[1]["improvement_over_fixed"] is None and results[1]["log_ratio"] is None
    assert results[1]["difference_to_fixed_tuned"] == 0.0
    assert (improvement(results[1]), ratio(results[1])) == ("-", "-")
    write_json(tmp_path / "results.json", [*results, {"made of": (np.inf, [float("nan")])}])
    stored = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)
    assert stored[-1] == {"made of": [None, [None]]}


def test_a_rival_takes_part_and_is_compared_with(evaluated, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(evaluated[0], folder)
    results = evaluate(small(agents=("huber-gate",), against="clairvoyant"), folder, 1, True)
    assert [r["agent"] for r in results] == ["fixed", "fixed-tuned", "clairvoyant", "huber-gate"]
    own, rival = (np.log(read_scores(folder, n).rmse) for n in ("huber-gate", "clairvoyant"))
    result = results[3]
    assert result["against"] == "clairvoyant"
    assert result["log_ratio"] == pytest.approx(np.mean(own) - np.mean(rival))
    assert result["rmse_geometric_mean"] == pytest.approx(np.exp(np.mean(own)))
    assert result["log_ratio_ci_low"] < result["log_ratio"] < result["log_ratio_ci_high"]
    half = 2.5706 * np.std(own - rival, ddof=1) / np.sqrt(6)  # Student's t of five freedoms
    told = [result[f"log_ratio_ci_{end}"] for end in ("low", "high")]
    np.testing.assert_allclose(told, result["log_ratio"] + half * np.array([-1, 1]), rtol=1e-4)
    assert results[2]["log_ratio"] == 0.0 and "against" not in evaluated[1][0]


def test_a_folder_gains_agents_and_repeats_none(evaluated, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(evaluated[0], folder)
    stamps = {path: path.stat().st_mtime_ns for path in (folder / "scores").iterdir()}
    results = evaluate(small(agents=("random",)), folder, 1, True)
    assert [r["agent"] for r in results] == ["fixed", "fixed-tuned", "random"]
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    assert bare(results)[:2] == bare(evaluated[1])[:2]


def test_nis_is_one_where_the_filter_is_right():
    kwargs = {"faults": "none"}
    recording = draw_episodes(LINEAR, kwargs, "test", 0, 60)
    fixed = rollout(make_agent("fixed"), LINEAR, kwargs, recording)
    assert fixed.nis.shape == (60, 4)  # of all channels, and of x, y and z
    np.testing.assert_allclose(fixed.nis.mean(axis=0), 1.0, atol=0.05)  # 7260 squares a group
    told = rollout(make_agent("lkf"), LINEAR, kwargs, recording)
    np.testing.assert_allclose(told.nis[:, 0], fixed.nis[:, 0], rtol=1e-9)
    assert np.isnan(told.nis[:, 1:]).all()  # it does not tell


def test_nis_is_that_of_the_update_not_of_the_look():
    """Twice the noise in one group's update: there nu^2 / S falls, elsewhere it stays near one."""
    kwargs = {"faults": "none"}
    recording = draw_episodes(LINEAR, kwargs, "test", 0, 60)
    agent = FixedTuned("mine", {"y_noise": 2.0})
    nis = rollout(agent, LINEAR, kwargs, recording).nis.mean(axis=0)
    assert 0.2 < nis[2] < 0.5
    np.testing.assert_allclose(nis[[1, 3]], 1.0, atol=0.05)


def test_cost_is_relative_to_the_bare_engine():
    """The nominal filter is the engine, and who looks and thinks costs more (shared machines)."""
    recording = draw_episodes(ENV, SHORT, "test", 3, 60)
    seconds = {
        name: rollout(make_agent(name), ENV, SHORT, recording).seconds
        for name in ("fixed", "hmm-noise")
    }
    fixed, hmm = (
        relative_cost(make_agent(name), ENV, SHORT, recording, 0, first)
        for name, first in seconds.items()
    )
    assert 0.4 < fixed < 2.5
    assert hmm > 1.3 * fixed


def test_a_filled_folder_is_refused_and_untouched(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(FileExistsError, match="--resume"):
        evaluate(small(), tmp_path, processes=1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_an_interrupted_contest_resumes(tmp_path, evaluated):
    done = []

    def stop_after_two(name):
        done.append(name)
        if len(done) == 2:
            raise KeyboardInterrupt

    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        evaluate(small(), folder, processes=1, advance=stop_after_two)
    assert not (folder / "results.json").exists()
    kept = {path: path.stat().st_mtime_ns for path in (folder / "scores").iterdir()}
    assert len(kept) == 2
    results = evaluate(small(), folder, processes=1, resume=True)
    assert json.dumps(bare(results)) == json.dumps(bare(evaluated[1]))
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in kept.items())


def test_resuming_another_contest_is_refused(evaluated):
    with pytest.raises(ValueError, match="another contest"):
        evaluate(small(seed=4), evaluated[0], processes=1, resume=True)


@pytest.mark.parametrize("stored", [b"", b"PK\x03\x04", 1, 7])
def test_damaged_scores_are_named_before_anything_is_done(evaluated, tmp_path, stored):
    """An archive cut short, or arrays of another number of episodes."""
    folder = tmp_path / "out"
    shutil.copytree(evaluated[0], folder)
    path = folder / "scores" / "fixed.npz"
    if isinstance(stored, bytes):
        path.write_bytes(stored)
    else:
        with np.load(path) as file:
            fields = dict(file)
        kept = {name: np.resize(fields[name], stored) for name in ("rmse", "lost", "nees")}
        np.savez(path, **fields | kept | {"nis": np.ones((stored, 4))})
    started = []
    with pytest.raises(ValueError, match=r"scores/fixed.npz .*: delete it, and --resume scores"):
        evaluate(small(), folder, 1, True, started=started.append)
    assert not started


@pytest.mark.parametrize("content", ["{", "[1]", ""])
def test_a_damaged_description_is_named(evaluated, tmp_path, content):
    folder = tmp_path / "out"
    shutil.copytree(evaluated[0], folder)
    (folder / "contest.json").write_text(content)
    with pytest.raises(ValueError, match=r"contest.json is damaged: name another folder"):
        evaluate(small(), folder, 1, True)


@pytest.mark.parametrize("resume", [False, True])
def test_a_contest_that_was_killed_at_its_first_file_begins_anew(tmp_path, resume):
    folder = tmp_path / "out"
    folder.mkdir()
    die_writing(folder / "contest.json")
    assert [path.name for path in folder.iterdir()] != []
    contest = small(agents=(), tuning_trials=0, episodes=2)
    evaluate(contest, folder, processes=1, resume=resume)
    assert {path.name for path in folder.iterdir()} == {
        "contest.json", "scores", "results.json", ".lock"
    }  # fmt: skip


def test_a_folder_takes_one_contest_at_a_time_until_it_is_dead(tmp_path):
    folder, contest = tmp_path / "out", small(**QUICK)
    folder.mkdir()
    with somebody_working_in(folder) as other:
        for resume in (False, True):
            with pytest.raises(RuntimeError, match=rf"process {other} works in .*out: wait"):
                evaluate(contest, folder, 1, resume)
        assert [path.name for path in folder.iterdir()] == [".lock"]
    assert evaluate(contest, folder, processes=1)


def test_bad_environment_keywords_leave_no_folder(tmp_path):
    with pytest.raises(TypeError, match="faults"):
        evaluate(small(env_kwargs={"fualts": 1}), tmp_path / "out", processes=1)
    assert not (tmp_path / "out").exists()


def write_policy(path, bias=0.0):
    """A policy that always answers with one action."""
    np.savez(
        path, format="kfenv-policy-1", algorithm="ppo", activation="tanh", layers=1,
        weight_0=np.zeros((29, 5), np.float32), bias_0=np.full(5, bias, np.float32),
        low=-np.ones(5, np.float32), high=np.ones(5, np.float32),
        env_id=ENV, env_kwargs="{}", metadata="{}",
    )  # fmt: skip
    return str(path)


def test_a_policy_cannot_take_a_fixed_agents_name(tmp_path):
    policy = write_policy(tmp_path / "fixed.npz")
    with pytest.raises(ValueError, match="OTHER=PATH"):
        small(agents=(policy,))
    assert small(agents=(f"mine={policy}",)).all_agents[-1] == f"mine={policy}"


def test_a_changed_policy_is_another_contest(tmp_path):
    policy = write_policy(tmp_path / "mine.npz")
    contest = small(agents=(policy,), tuning_trials=0)
    evaluate(contest, tmp_path / "out", processes=1)
    write_policy(tmp_path / "mine.npz", bias=0.1)
    with pytest.raises(ValueError, match="another contest"):
        evaluate(contest, tmp_path / "out", processes=1, resume=True)


def test_without_tuning_nothing_is_called_tuned(tmp_path):
    results = evaluate(small(tuning_trials=0), tmp_path / "out", processes=1)
    assert [r["agent"] for r in results] == ["fixed", "huber-gate", "clairvoyant"]
    assert "difference_to_fixed_tuned" not in results[0]


def test_only_the_clairvoyant_is_shown_what_a_simulation_knows():
    recording = draw_episodes(ENV, SHORT, "test", 3, 2)

    class Probe(Fixed):
        def act(self, observation, info):
            assert self.briefing.recording is None
            assert not {"truth", "position_error", "nees"} & set(info)
            return super().act(observation, info)

    rollout(Probe("probe"), ENV, SHORT, recording)
