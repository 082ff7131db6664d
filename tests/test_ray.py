"""On Ray as in processes: the same results to the bit, whoever dies on the way.

Slow, and with Ray alone: ``pip install -e '.[ray,test]' && pytest -n 0 -m slow tests/test_ray.py``.
"""

import json
import os
import signal
import time
from functools import partial
from pathlib import Path

import psutil
import pytest
from kfenv.agents.contest import ledger
from kfenv.agents.contest.blocks import Work
from kfenv.agents.contest.contest import Contest
from kfenv.agents.contest.evaluation import evaluate
from kfenv.agents.jobs.executor import run_jobs
from kfenv.agents.jobs.ray_cluster import RayCluster
from test_blocks import bare
from test_executor import die_at_three, refuse_three, square

ray = pytest.importorskip("ray", reason="needs Ray: pip install -e '.[ray]'")
pytestmark = pytest.mark.slow

ENV, SHORT = "kfenv/RadarTracking-v0", {"rate": 2.0, "duration": 30.0}


def contest():
    return Contest(ENV, SHORT, ("random", "hmm-noise", "learned-small"), 60, 3, 4, 3)


@pytest.fixture(scope="module", autouse=True)
def small_blocks(tmp_path_factory):
    """Many jobs; and workers that can import what stands here, and tell where they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ledger, "BLOCK", 12)
        patch.setenv("PYTHONPATH", str(Path(__file__).parent))
        patch.setenv("KFENV_TEST_SEEN", str(tmp_path_factory.mktemp("seen")))
        yield


@pytest.fixture(scope="module")
def alone(tmp_path_factory, small_blocks):
    return bare(evaluate(contest(), tmp_path_factory.mktemp("alone") / "out", processes=1))


@pytest.fixture(scope="module")
def one_node():
    """A Ray of two processors."""
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield RayCluster(processors=2)
    ray.shutdown()


@pytest.fixture
def two_nodes():
    """Two Ray nodes of one processor each on this machine; the driver's and another."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    cluster.other = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def test_jobs_run_and_what_died_is_run_again(one_node, tmp_path):
    assert dict(run_jobs(square, range(7), one_node)) == {n: n * n for n in range(7)}
    done = list(run_jobs(partial(die_at_three, 1, tmp_path), range(7), one_node))
    assert sorted(done) == [(n, n * n) for n in range(7)]
    with pytest.raises(ValueError, match=r"^not 3$"):
        list(run_jobs(refuse_three, [1, 3], one_node))


def test_what_dies_twice_is_named(one_node, tmp_path):
    done = []
    with pytest.raises(RuntimeError, match="worker process of 3 died twice"):
        for pair in run_jobs(partial(die_at_three, 2, tmp_path), range(7), one_node):
            done.append(pair)
    assert sorted(done) == [(n, n * n) for n in range(7) if n != 3]


def test_a_contest_is_the_same_on_one_node(one_node, alone, tmp_path):
    assert bare(evaluate(contest(), tmp_path / "out", one_node)) == alone


class Slowly(Work):
    """Work that tells where it is and takes its time."""

    def __call__(self, job):
        Path(os.environ["KFENV_TEST_SEEN"], str(os.getpid())).touch()
        time.sleep(0.3)
        return super().__call__(job)


def test_a_contest_survives_a_worker_and_a_node(two_nodes, alone, tmp_path, monkeypatch):
    """Both are killed at work; the contest is then stopped, and resumed in processes."""
    seen, killed, done = Path(os.environ["KFENV_TEST_SEEN"]), [], []
    monkeypatch.setattr("kfenv.agents.contest.blocks.Work", Slowly)
    keep = ledger.Ledger.keep

    def kill(*arguments):
        done.append(arguments)
        if len(done) == 2:
            worker = next(int(p.name) for p in seen.iterdir() if psutil.pid_exists(int(p.name)))
            os.kill(worker, signal.SIGKILL)
            killed.append(worker)
        if len(done) == 5:
            two_nodes.remove_node(two_nodes.other, allow_graceful=False)
            killed.append("node")
        if len(done) == 12:
            raise KeyboardInterrupt
        return keep(*arguments)

    monkeypatch.setattr(ledger.Ledger, "keep", kill)
    with pytest.raises(KeyboardInterrupt):
        evaluate(contest(), tmp_path / "out", RayCluster(two_nodes.address))
    assert len(killed) == 2
    monkeypatch.setattr(ledger.Ledger, "keep", keep)
    again = evaluate(contest(), tmp_path / "out", 2, resume=True)
    assert bare(again) == alone


def test_a_contest_is_the_same_on_two_nodes(two_nodes, alone, tmp_path):
    assert bare(evaluate(contest(), tmp_path / "out", RayCluster(two_nodes.address))) == alone
    assert json.loads((tmp_path / "out" / "results.json").read_text())
