"""What processes leave behind that are killed."""

import subprocess
import sys
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


def die_writing(path: Path) -> None:
    """Be killed in a process of its own between opening and renaming a file."""
    subprocess.run([sys.executable, "-c", DIE, str(path)], check=False)
