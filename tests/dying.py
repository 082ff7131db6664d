"""Runs that die at the n-th file operation in their folder: an open to write, a rename, a removal.

In this process death is an exception that nothing may survive: from it on, every further operation
in the folder fails, so that no clean-up is done, as if the process had been killed. What was being
written is then half there, under the name of a process that is dead.
"""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")
LEFT_OUT = ("tensorboard", ".lock")  # nobody reads them again


class Died(BaseException):
    """The process is dead."""


class Watch:
    """Counts the operations in a folder while it has one, and dies at one of them."""

    folder, dies_at, killed_by = None, None, None
    names = ()

    def __call__(self, event, arguments):
        if self.folder is None or not self._concerns(event, arguments):
            return
        self.names += ((event, Path(str(arguments[0])).name),)
        if self.dies_at is not None and len(self.names) > self.dies_at:
            if event == "os.rename":
                self._halve(arguments[0])
            if self.killed_by is not None:
                os.kill(os.getpid(), self.killed_by)
            raise Died

    def _concerns(self, event, arguments):
        if event == "open":
            _, _, flags = arguments
            if not flags & (os.O_WRONLY | os.O_RDWR) or isinstance(arguments[0], int):
                return False
        elif event not in CHANGES:
            return False
        path = os.path.abspath(os.fspath(arguments[0])) if arguments[0] != "" else ""
        path = path.decode() if isinstance(path, bytes) else path
        inside = path.startswith(self.folder)
        return inside and not any(name in path for name in LEFT_OUT)

    def _halve(self, path):
        if os.path.isfile(path):
            folder, self.folder = self.folder, None
            os.truncate(path, os.path.getsize(path) // 2)
            self.folder = folder


WATCH = Watch()
sys.addaudithook(WATCH)


@contextmanager
def watched(folder, dies_at=None, killed_by=None):
    """Count operations in a folder, and die at the one of that number, from zero."""
    WATCH.names, WATCH.dies_at, WATCH.killed_by = (), dies_at, killed_by
    WATCH.folder = os.path.abspath(folder)
    try:
        yield WATCH
    finally:
        WATCH.folder = None


def operations(run, folder):
    """What a run that is left alone does in its folder."""
    with watched(folder) as watch:
        run(folder)
    return watch.names


def die(run, folder, dies_at):
    """Run until the operation of that number, and be dead; tell what had been done."""
    with watched(folder, dies_at) as watch:
        try:
            run(folder)
        except Died:
            pass
    for path in list(Path(folder).rglob(f"*.{os.getpid()}.partial")):
        path.rename(path.with_name(path.name.replace(f".{os.getpid()}.", f".{_dead()}.")))
    return watch.names[:dies_at]


def _dead():
    """The id of a process that is dead."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def be_killed(code, folder, dies_at):
    """Let a process of its own run the code and be killed at the operation of that number."""
    begin = (
        "import signal, sys; from dying import watched; "
        f"folder = sys.argv[1]\nwith watched(folder, {dies_at}, signal.SIGKILL): {code}"
    )
    tests = {"PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, "-c", begin, str(folder)]
    done = subprocess.run(command, env=os.environ | tests, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
