"""Jobs in worker processes: nothing is lost with a worker, nothing waits or runs for ever."""

import os
import signal
import subprocess
import sys
import time
from collections import deque
from functools import partial
from pathlib import Path

import pytest
from kfenv.agents.jobs.executor import run_jobs

DEADLINE = 60.0  # seconds, on a busy machine


def square(number):
    return number * number


def die_at_three(often, folder, number):
    """Its square, but a worker that gets the 3 is killed in its first runs."""
    run = len(list(folder.iterdir()))
    if number == 3 and run < often:
        (folder / str(run)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def refuse_three(number):
    if number == 3:
        raise ValueError("not 3")
    time.sleep(DEADLINE if number > 3 else 0.0)


def say_and_sleep(folder, number):
    (folder / str(os.getpid())).touch()
    time.sleep(2.0 * DEADLINE)


@pytest.mark.parametrize("processes", [1, 2])
def test_each_job_comes_with_its_result(processes):
    assert dict(run_jobs(square, range(7), processes)) == {n: n * n for n in range(7)}


@pytest.mark.parametrize("processes", [1, 2])
def test_jobs_may_bring_others(processes):
    waiting, done = deque([1]), []
    for job, result in run_jobs(square, waiting, processes):
        done.append(result)
        if job < 5:
            waiting.append(job + 1)
    assert done == [1, 4, 9, 16, 25]


def test_each_process_is_prepared_before_its_first_job_and_alone(tmp_path):
    prepare = partial(enter_alone, tmp_path)
    done = dict(run_jobs(partial(is_prepared, tmp_path), range(4), 2, prepare))
    assert done == dict.fromkeys(range(4), True)
    assert not (tmp_path / "met").exists() and (tmp_path / "prepared").exists()


def enter_alone(folder):
    """Tell if another process is in here at the same time."""
    if (folder / "inside").exists():
        (folder / "met").touch()
    (folder / "inside").touch()
    time.sleep(0.2)
    (folder / "inside").unlink()
    with (folder / "prepared").open("a") as file:
        file.write(f"{os.getpid()}\n")


def is_prepared(folder, job):
    return str(os.getpid()) in (folder / "prepared").read_text().split()


def test_what_died_with_its_worker_is_run_again(tmp_path):
    done = list(run_jobs(partial(die_at_three, 1, tmp_path), range(7), 2))
    assert sorted(done) == [(n, n * n) for n in range(7)]


def test_what_dies_twice_is_named_and_the_others_are_done(tmp_path):
    done = []
    with pytest.raises(RuntimeError, match="worker process of 3 died twice"):
        for pair in run_jobs(partial(die_at_three, 2, tmp_path), range(7), 2):
            done.append(pair)
    assert sorted(done) == [(n, n * n) for n in range(7) if n != 3]
    assert len(list(tmp_path.iterdir())) == 2


def test_an_error_ends_the_other_jobs():
    began = time.monotonic()
    with pytest.raises(ValueError, match="not 3"):
        list(run_jobs(refuse_three, range(3, 6), 2))
    assert time.monotonic() - began < 0.7 * DEADLINE


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_parent(number, tmp_path):
    work = (
        "from functools import partial; from pathlib import Path; "
        "from kfenv.agents.jobs.executor import run_jobs; from test_executor import say_and_sleep; "
        f"list(run_jobs(partial(say_and_sleep, Path({str(tmp_path)!r})), range(2), 2))"
    )
    tests = {"PYTHONPATH": str(Path(__file__).parent)}
    process = subprocess.Popen([sys.executable, "-c", work], env=os.environ | tests)
    workers = wait_for(lambda: [int(path.name) for path in tmp_path.iterdir()], 2)
    process.send_signal(number)
    process.wait(DEADLINE)
    wait_for(lambda: [worker for worker in workers if runs(worker)], 0)


def wait_for(look, count):
    deadline = time.monotonic() + DEADLINE
    while len(found := look()) != count:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def runs(process):
    """Whether it does; what waits to be reaped no longer does."""
    try:
        return ") Z " not in Path(f"/proc/{process}/stat").read_text()
    except FileNotFoundError:
        return False


def _threads(job):
    return os.environ.get("OPENBLAS_NUM_THREADS")


def test_workers_keep_to_one_core_and_the_parent_is_left_alone(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert dict(run_jobs(_threads, [1, 2], 2)) == {1: "1", 2: "1"}
    assert "OPENBLAS_NUM_THREADS" not in os.environ
