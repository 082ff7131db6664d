"""What processes leave behind that are killed."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DIE = """
import os, signal, sys
from pathlib import Path
from kfenv.agents.files import written_whole
with written_whole(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


HOLD = """
import sys, time
from pathlib import Path
from kfenv.agents.files import locked
with locked(Path(sys.argv[1])):
    print(flush=True)
    time.sleep(600)
"""


@contextmanager
def somebody_working_in(folder: Path) -> Iterator[int]:
    """The id of a process that has a folder to itself until it is killed."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        yield other.pid
        other.kill()


def die_writing(path: Path) -> None:
    """Be killed in a process of its own between opening and renaming a file."""
    subprocess.run([sys.executable, "-c", DIE, str(path)], check=False)
