"""Compiled kernels on disk, which processes that start at once must not spoil.

Numba keeps a function's kernels in numbered files beside an index of them. A process that saves
one reads the index, takes the next number, and writes both; another that does so meanwhile takes
the same number, and the index then leads to the wrong kernel. So does a number that is told
before its file is written. Here they take turns.
"""

from __future__ import annotations

import gc
import getpass
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba import config
from numba.core import event
from numba.core.caching import IndexDataCacheFile

LOCK = ".kfenv-kernels.lock"
# Options of kernels whose arithmetic stays as it is written, in threads if need be, and of what
# they alone call: doors that nobody uses take a third of the time to compile
INNER_KERNEL = {"error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
KERNEL = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def take_turns() -> None:
    """From now on this process saves and loads kernels under a lock of their folder."""
    for name, shared in (("save", False), ("load", True)):
        former = getattr(IndexDataCacheFile, name)
        if not hasattr(former, "takes_turns"):
            setattr(IndexDataCacheFile, name, _in_turn(former, shared))


class _WithoutCollection(event.Listener):
    """While Numba compiles nobody looks for garbage: what it makes stays in use for long."""

    def __init__(self) -> None:
        self._collected: list[bool] = []

    def on_start(self, event: event.Event) -> None:
        """See `numba.core.event.Listener`."""
        self._collected.append(gc.isenabled())
        gc.disable()

    def on_end(self, event: event.Event) -> None:
        """See `numba.core.event.Listener`."""
        if self._collected.pop():
            gc.enable()


def keep_on_this_machine() -> None:
    """Keep kernels in a folder of this user and machine, unless NUMBA_CACHE_DIR names another.

    A home that many machines share is slow, and their processors may differ. To be called
    before modules with kernels are imported.
    """
    if not config.CACHE_DIR:
        config.CACHE_DIR = str(local_folder("kernels"))


def local_folder(name: str) -> Path:
    """A folder of that name that belongs to this user on this machine alone; made if need be.

    Raises:
        PermissionError: if somebody else has put one in its place.
    """
    own = Path(tempfile.gettempdir()) / f"kfenv-{getpass.getuser()}"
    own.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid") and (own.is_symlink() or own.stat().st_uid != os.getuid()):
        raise PermissionError(f"{own} belongs to somebody else: set TMPDIR to another folder.")
    (own / name).mkdir(exist_ok=True)
    return own / name


@contextmanager
def alone_on_this_machine() -> Iterator[None]:
    """Wait until no other process of this user is in here, then keep them out."""
    with _locked(local_folder("locks") / "compiling", shared=False):
        yield


def _in_turn(former: Any, shared: bool) -> Any:
    def method(self: IndexDataCacheFile, *arguments: Any) -> Any:
        with _locked(Path(self._cache_path) / LOCK, shared):
            return former(self, *arguments)

    method.takes_turns = True
    return method


@contextmanager
def _locked(path: Path, shared: bool) -> Iterator[None]:
    """Hold a file's lock, where there are locks and the file can be written."""
    try:
        import fcntl

        file = path.open("a")
    except (ImportError, OSError):
        yield
        return
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        except OSError:  # a file system without locks
            pass
        yield


take_turns()
event.register("numba:compile", _WithoutCollection())
