"""Reads and writes the arrays of a policy file: an archive as `numpy.savez` writes it.

A file is not trusted: whatever it declares, reading takes no more memory than it has bytes, and
runs nothing that it holds.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..files import written_whole

HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write the arrays, whole or not at all; the same arrays give the same bytes."""
    with written_whole(path) as file:
        np.savez(file, **arrays)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays by name.

    Raises:
        OSError: if the file cannot be read.
        Exception: of any of the readers, if it is foreign or damaged.
    """
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if any(member.compress_type != zipfile.ZIP_STORED for member in members):
            raise ValueError("its arrays are compressed")
        if sum(member.file_size for member in members) > path.stat().st_size:
            raise ValueError("it declares more bytes than it has")
        return {m.filename.removesuffix(".npy"): _array(archive.read(m)) for m in members}


def _array(member: bytes) -> NDArray[Any]:
    """What a member holds: a view of its bytes, so that a declared shape allocates nothing."""
    file = io.BytesIO(member)
    shape, by_columns, kind = HEADERS[npy.read_magic(file)](file)
    flat = np.frombuffer(member, kind, offset=file.tell())
    return flat.reshape(shape, order="F" if by_columns else "C")
