"""Result files appear whole or not at all, and one that is damaged is named with the remedy."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, BinaryIO, TextIO, TypeVar

import numpy as np
from numpy.typing import NDArray

Content = TypeVar("Content", dict, list)

PARTIAL = "partial"
LOCK = ".lock"  # names the process that has a folder to itself


@contextmanager
def written_whole(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; on success it takes the name `path`.

    A reader never meets half a file, and an interruption leaves the former one untouched.
    """
    temporary = path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}.{PARTIAL}")
    try:
        with temporary.open("wb") as file:
            yield file
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, content: Any) -> None:
    """Write `content` as readable JSON, whole or not at all; what is no number becomes null."""
    with written_whole(path) as file:
        file.write((json.dumps(_valid(content), indent=2, allow_nan=False) + "\n").encode())


def _valid(content: Any) -> Any:
    """The same with None in place of NaN and infinities, which JSON does not have."""
    if isinstance(content, dict):
        return {key: _valid(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_valid(value) for value in content]
    return None if isinstance(content, float) and not isfinite(content) else content


@contextmanager
def blamed_on(path: Path, remedy: str) -> Iterator[None]:
    """Say of a file whatever goes wrong with what it holds.

    Raises:
        ValueError: naming the file and the remedy.
    """
    try:
        yield
    except Exception as error:  # what is damaged can fail anywhere
        raise ValueError(f"{path} is damaged ({type(error).__name__}): {remedy}.") from error


def read_json(path: Path, kind: type[Content], remedy: str) -> Content:
    """The object or list (`kind`) in a JSON file.

    Raises:
        ValueError: if it is damaged, naming the remedy.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        content = None
    if not isinstance(content, kind):
        raise ValueError(f"{path} is damaged: {remedy}.")
    return content


def read_arrays(
    path: Path, names: Sequence[str], remedy: str, rows: int | None = None
) -> dict[str, NDArray]:
    """Arrays of those names from a file of NumPy's.

    Args:
        rows: if given, each must hold numbers in so many rows.

    Raises:
        ValueError: if it is damaged, naming the remedy.
    """
    with path.open("rb") as content, blamed_on(path, remedy), np.load(content) as file:
        arrays = {name: file[name] for name in names}
    for name, array in arrays.items():
        numbers = array.dtype.kind in "biuf" and array.ndim > 0
        if rows is not None and not (numbers and len(array) == rows):
            raise ValueError(
                f"{path} holds {name} of shape {array.shape} and type {array.dtype} where {rows} "
                f"rows of numbers were expected: {remedy}."
            )
    return arrays


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Have a folder to this process alone, until it is done or dead, and clear what others left.

    Without effect on Windows.

    Raises:
        RuntimeError: if another one has it.
    """
    with (folder / LOCK).open("a+") as file:
        _lock(file, folder)
        clear_partial(folder)
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            file.truncate(0)  # the file stays: who deletes it might delete the next one's lock


def _lock(file: TextIO, folder: Path) -> None:
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise RuntimeError(
            f"process {file.read()} works in {folder}: wait until it is done, stop it, or choose "
            "another output"
        ) from None


def is_free(folder: Path) -> bool:
    """Whether there is nothing, or a folder with no more than what a dead run had not written."""
    if not folder.is_dir():
        return not folder.exists()
    return all(path.name == LOCK or _is_partial(path) for path in folder.iterdir())


def goes_on(folder: Path, resume: bool) -> bool:
    """Whether a folder for results holds an earlier run, to be gone on with.

    Raises:
        FileExistsError: if it is a file, or holds anything and `resume` is not set.
    """
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder} is a file: name a folder for the results.")
    if is_free(folder):
        return False
    if not resume:
        raise FileExistsError(
            f"The folder {folder} is not empty: name another, or go on with --resume."
        )
    return True


def clear_partial(folder: Path) -> None:
    """Delete what dead runs of this machine had begun to write in a folder and those below it."""
    for path in folder.rglob(f".*.{PARTIAL}"):
        by = re.search(rf"\.{re.escape(platform.node())}\.(\d+)$", path.stem)
        if by is not None and not _runs(int(by[1])):
            path.unlink(missing_ok=True)


def _is_partial(path: Path) -> bool:
    return path.name.startswith(".") and path.suffix == f".{PARTIAL}"


def _runs(process: int) -> bool:
    """Whether it does, as far as that can be asked."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)  # sends nothing
    except ProcessLookupError:
        return False
    except OSError:  # it is somebody else's
        return True
    return True
