"""Files that travel with a job to a process that may run on another machine."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Any

from kfenv.kernel_cache import local_folder

from ..files import written_whole


class CarriedFile(str):
    """The path of a file, which pickled takes the file along: unpickled it is a copy's path."""

    def __reduce__(self):
        return _unpack, (Path(self).name, Path(self).read_bytes())


def carried(value: Any) -> Any:
    """Plain JSON values in which each path of a file is one that takes the file along."""
    if isinstance(value, dict):
        return {key: carried(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [carried(item) for item in value]
    return CarriedFile(value) if isinstance(value, str) and _is_file(value) else value


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):  # too long for a path, or none
        return False


def _unpack(name: str, content: bytes) -> str:
    """Store the file under its own name, once for each content, and return its path there."""
    folder = local_folder("files") / sha256(content).hexdigest()
    folder.mkdir(exist_ok=True)
    path = folder / name
    if not path.exists():
        with written_whole(path) as file:
            file.write(content)
    return str(path)
