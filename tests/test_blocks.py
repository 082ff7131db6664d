"""A contest in blocks of episodes gives the same scores to the bit, however it is cut and run."""

import json
import pickle

import numpy as np
import pytest
from kfenv.agents.contest import ledger
from kfenv.agents.contest.blocks import Block, Work
from kfenv.agents.contest.contest import Contest
from kfenv.agents.contest.evaluation import evaluate
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contest.scores import STORED
from kfenv.agents.contestants.pretrained import FOLDER as PRETRAINED
from kfenv.agents.contestants.registry import AGENTS, FILTERS, make_agent
from kfenv.agents.jobs.carried import carried

RADAR, GNSS = ("kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 12.0}), (
    "kfenv/GnssTracking-v0", {"duration": 2.0})  # fmt: skip
OWN = {name: GNSS for name in ("raim", "satellite-gate", "satellite-hmm", "clairvoyant-channels")}
EPISODES = 11


@pytest.mark.parametrize("name", [*AGENTS, *FILTERS, "ekf-joseph", "ackf"])
def test_an_episode_is_scored_alike_in_every_block(name):
    place = OWN.get(name, RADAR)
    whole = rollout(make_agent(name), *place, draw_episodes(*place, "test", 3, EPISODES), 3)
    for begin, end in ((0, 4), (4, 8), (8, EPISODES)):
        block = draw_episodes(*place, "test", 3, EPISODES, (begin, end))
        part = rollout(make_agent(name), *place, block, 3, block=(begin, EPISODES))
        for field in STORED[:-1]:
            np.testing.assert_array_equal(
                getattr(part, field), getattr(whole, field)[begin:end], err_msg=field
            )


def small(**changes):
    return Contest(*RADAR, ("random", "imm"), EPISODES, 3, 2, 2, **changes)


def bare(results):
    """Results without what depends on the machine."""
    return json.dumps([{k: v for k, v in r.items() if k != "cost"} for r in results])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return bare(evaluate(small(), tmp_path_factory.mktemp("contest") / "out", processes=1))


def test_results_do_not_depend_on_blocks_and_processes(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(ledger, "BLOCK", 4)
    assert bare(evaluate(small(), tmp_path / "out", processes=2)) == whole
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "contest.json", "scores", "results.json", ".lock"
    }  # fmt: skip


def test_finished_tunings_and_blocks_are_kept(whole, tmp_path, monkeypatch):
    """A contest that is stopped again and again comes to its end, and repeats no finished block.

    Of a tuning it repeats what was asked for at once, and not all told.
    """
    monkeypatch.setattr(ledger, "BLOCK", 4)
    done, call = [], Work.__call__

    def stop_at_the_tenth(self, job):
        if len(done) % 10 == 9:
            done.append(None)
            raise KeyboardInterrupt
        done.append(str(job))
        return call(self, job)

    monkeypatch.setattr(Work, "__call__", stop_at_the_tenth)
    results = None
    while results is None:
        try:
            results = evaluate(small(), tmp_path / "out", processes=1, resume=True)
        except KeyboardInterrupt:
            continue
    assert bare(results) == whole
    blocks = [job for job in done if job is not None and "tuning" not in job]
    assert len(blocks) == len(set(blocks)) == 4 * 3
    trials = 2 * (len(make_agent("imm").parameters) + 5)
    assert trials <= len(done) - done.count(None) - len(blocks) < 2 * trials


def test_files_and_policies_travel_with_the_work(tmp_path):
    """A worker on another machine finds no path of this one."""
    track = tmp_path / "flight.csv"
    rows = (f"{t},{48.0 + 0.002 * t},11.0,9000\n" for t in range(0, 300, 5))
    track.write_text("t,lat,lon,alt_m\n" + "".join(rows))
    (tmp_path / "policy.npz").write_bytes((PRETRAINED / "RadarTracking-small.npz").read_bytes())
    place = RADAR[0], RADAR[1] | {"track": str(track)}
    agents = {name: make_agent(name) for name in ("fixed", f"mine={tmp_path / 'policy.npz'}")}
    contest = Contest(place[0], carried(place[1]), tuple(agents), 4, 0, tuning_trials=0)
    jobs = [Block(0, name, 0, 4, {}) for name in agents]
    work = Work((contest,), (4,), agents)
    here, packed = [work(job)[0].rmse for job in jobs], pickle.dumps(work)
    for path in tmp_path.iterdir():
        path.unlink()
    there = [pickle.loads(packed)(job)[0].rmse for job in jobs]
    np.testing.assert_array_equal(here, there)


def test_only_files_are_carried(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t\n")
    given = {"log": [str(path), "gone.csv"], "faults": {"jamming": {}}, "rate": 2.0}
    there = pickle.loads(pickle.dumps(carried(given)))
    assert json.dumps(carried(given)) == json.dumps(given)
    assert there["log"][0] != str(path) and there["log"][0].endswith("log.csv")
    assert open(there["log"][0]).read() == "t\n"
    assert there | {"log": None} == given | {"log": None} and there["log"][1] == "gone.csv"
