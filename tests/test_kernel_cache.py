"""Processes that compile at once do not spoil the kernels on disk."""

import gc
import subprocess
import sys
import time
from multiprocessing import get_context

import pytest
from numba import njit
from numba.core import event
from numba.core.caching import IndexDataCacheFile

import kfenv.kernel_cache

ROUNDS = 3


class SlowDisk(IndexDataCacheFile):
    """Takes its time between the index and what comes of it."""

    def _load_index(self):
        found = super()._load_index()
        time.sleep(0.1)
        return found


def save_many(folder, key, barrier):
    """Save one of two signatures of some functions, each when the other process saves its own."""
    for number in range(ROUNDS):
        barrier.wait(60.0)
        SlowDisk(folder, f"f{number}", "stamp").save(key, key)


def test_two_signatures_of_a_function_saved_at_once_stay_apart(tmp_path):
    """Without turns both are given the same number: one is lost, or taken for the other."""
    context = get_context("spawn")
    barrier = context.Barrier(2)
    both = [context.Process(target=save_many, args=(str(tmp_path), k, barrier)) for k in "ab"]
    for process in both:
        process.start()
    for process in both:
        process.join(60.0)
    for number in range(ROUNDS):
        file = IndexDataCacheFile(str(tmp_path), f"f{number}", "stamp")
        assert [file.load(key) for key in "ab"] == ["a", "b"]


def test_kernels_can_be_kept_on_this_machine(tmp_path):
    say = (
        "from kfenv.kernel_cache import keep_on_this_machine, local_folder; keep_on_this_machine();"
        "from kfenv.envs.scoring import score; print(score.stats.cache_path)"
    )
    run = [sys.executable, "-c", say]
    told = subprocess.run(run, env={"TMPDIR": str(tmp_path)}, capture_output=True, text=True)
    assert told.stdout.startswith(str(tmp_path)), told.stderr
    own = {"TMPDIR": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "mine")}
    told = subprocess.run(run, env=own, capture_output=True, text=True)
    assert told.stdout.startswith(str(tmp_path / "mine")), told.stderr
    folder = next(tmp_path.glob("kfenv-*"))
    assert folder.stat().st_mode & 0o077 == 0


def test_turns_are_taken_once():
    before = IndexDataCacheFile.save
    kfenv.kernel_cache.take_turns()
    assert IndexDataCacheFile.save is before


@pytest.mark.parametrize("collected", [True, False])
def test_garbage_is_not_collected_while_numba_compiles_and_then_as_before(collected):
    met = []

    class Watch(event.Listener):
        def on_start(self, event):
            met.append(gc.isenabled())

        on_end = on_start

    was = gc.isenabled()
    (gc.enable if collected else gc.disable)()
    try:
        with event.install_listener("numba:compile", Watch()):
            assert njit(lambda a: a + 1)(1) == 2
        assert met[0] is False and gc.isenabled() is collected
    finally:
        (gc.enable if was else gc.disable)()
