"""What is tried: a subject draws cases and tries them; a case is all that a trial needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator

from ..files import written_whole

Case = dict[str, Any]  # by name: arrays, the bytes of files, or plain JSON

BYTES, PLAIN = "bytes/", "plain/"  # what their names begin with in a file


class Wrong(Exception):
    """What was promised does not hold."""


class Subject(Protocol):
    """A part of the product that can be tried."""

    name: str

    def draw(self, rng: Generator) -> Case:
        """All that is random in a trial."""

    def attempt(self, case: Case) -> int:
        """Try a case, and tell how many filter steps that took.

        Raises:
            Wrong: if what came out breaks a promise.
            Exception: any other is a finding too.
        """


def save_case(path: Path, subject: str, case: Case) -> None:
    """Write a case so that it can be tried again."""
    arrays: dict[str, Any] = {f"{PLAIN}subject": subject}
    for name, value in case.items():
        if isinstance(value, np.ndarray):
            arrays[name] = value
        elif isinstance(value, bytes):
            arrays[f"{BYTES}{name}"] = np.frombuffer(value, np.uint8)
        else:
            arrays[f"{PLAIN}{name}"] = json.dumps(value)
    with written_whole(path) as file:
        np.savez_compressed(file, **arrays)


def load_case(path: Path) -> tuple[str, Case]:
    """The subject's name and the case in a file that `save_case` wrote.

    Raises:
        ValueError: if it is another file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        subject = str(arrays.pop(f"{PLAIN}subject"))
        case = {name: value for name, value in arrays.items() if "/" not in name}
        for name, value in arrays.items():
            if name.startswith(BYTES):
                case[name.removeprefix(BYTES)] = value.tobytes()
            elif name.startswith(PLAIN):
                case[name.removeprefix(PLAIN)] = json.loads(str(value))
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive can fail in any of its readers
        raise ValueError(f"{path} is no case that `kfenv fuzz` saved: give one.") from error
    return subject, case
