"""Named columns of numbers from CSV files; a column ``t`` may hold times of other forms too."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from math import inf
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import LARGEST
from kfenv.names import excerpt
from kfenv.scenarios.clock import seconds

Array = NDArray[np.float64]


CLOCK = "t"  # the column of times, see `kfenv.scenarios.clock`


def read_columns(
    path: str | PathLike[str], what: str, columns: Sequence[str], gaps: bool = False
) -> list[Array]:
    """Read columns by their names in the first line; others are ignored.

    Args:
        path: of the file.
        what: the file is, e.g. ``"track"``, for complaints.
        columns: their names.
        gaps: whether empty cells are NaN, but for times.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no CSV file, a column is missing or holds what is no number;
            the message names the file.
    """
    with _rows(path, what) as rows:
        return _read(rows, what, columns, gaps)


def column_names(path: str | PathLike[str], what: str) -> list[str]:
    """The names in a CSV file's first line.

    Raises:
        FileNotFoundError, ValueError: as `read_columns`.
    """
    with _rows(path, what) as rows:
        return _header(rows)


@contextmanager
def _rows(path: str | PathLike[str], what: str) -> Iterator:
    """The rows of a file; complaints that come up while it is open name it."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no {what.removesuffix(' file')} file {path}.")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            yield csv.reader(file)
    except (csv.Error, UnicodeDecodeError):
        raise ValueError(f"{path} is not a CSV text file.") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _header(rows) -> list[str]:
    return [name.strip() for name in next(rows, [])]


def _read(rows, what: str, columns: Sequence[str], gaps: bool) -> list[Array]:
    header = _header(rows)
    for column in columns:
        if column not in header:
            raise ValueError(_missing(what, columns, column, header))
    places = [header.index(column) for column in columns]
    values = []
    for row in filter(None, rows):
        _check_cells(row, header, rows.line_num, gaps)
        values.append([_number(row, i, header[i], rows.line_num, gaps) for i in places])
    return list(np.array(values, dtype=float).reshape(-1, len(columns)).T)


def _check_cells(row: list[str], header: list[str], line: int, gaps: bool) -> None:
    """Complain of a row that was cut off where cells may be empty, or whose cells are too many.

    Raises:
        ValueError: of decimal commas too, which make cells of their own.
    """
    if (gaps and len(row) < len(header)) or any(cell.strip() for cell in row[len(header) :]):
        raise ValueError(
            f"line {line} has {len(row)} cells and the first line {len(header)} names: give one "
            "cell each, empty where nothing was measured, with points in decimals."
        )


def _missing(what: str, columns: Sequence[str], column: str, header: list[str]) -> str:
    if header and all(map(_is_numeric, header)):
        return f"the first line holds numbers, no names: put {','.join(columns)} above it."
    mark = next((mark for mark in ";\t|" if mark in "".join(header[:1])), None)
    if mark:
        return f"columns are separated by {mark!r}: write commas, and points in decimals."
    close = get_close_matches(column, header, n=1, cutoff=0.4)
    hint = f"; rename {excerpt(close[0])!r} if that is it" if close else ""
    found = excerpt(", ".join(header)) if header else "nothing"
    article = "An" if what[0] in "aeioAEIO" else "A"
    return (
        f"column {column!r} is missing{hint}. {article} {what} has {', '.join(columns)}; "
        f"found {found}."
    )


def _is_numeric(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(row: list[str], place: int, column: str, line: int, gaps: bool) -> float:
    text = row[place] if place < len(row) else ""
    if gaps and column != CLOCK and not text.strip():
        return float("nan")
    try:
        value = seconds(text) if column == CLOCK else float(text)
    except ValueError:
        kind = "time (seconds, hh:mm:ss or ISO 8601)" if column == CLOCK else "number"
        raise ValueError(
            f"column {column!r} in line {line} is no {kind}: {excerpt(text)!r}."
        ) from None
    if LARGEST < abs(value) < inf:
        raise ValueError(
            f"column {column!r} in line {line} holds {value:g}, more than anything measures."
        )
    return value
