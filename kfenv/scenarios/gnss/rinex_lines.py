"""The lines of a RINEX file and its header, however they end and whatever letters they hold."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from math import nan
from pathlib import Path

from kfenv.checks import LARGEST
from kfenv.names import excerpt

Header = dict[str, list[tuple[int, str]]]  # label: lines with their numbers

GPS_EPOCH = datetime(1980, 1, 6)
VERSIONS = (2, 3)
HEADER_LABEL = 60  # column at which a header line's label begins


class Lines:
    """The lines of a text file, counted, so that a complaint can name its line.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no text file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.number = Path(path), 0
        if not self.path.is_file():
            raise FileNotFoundError(f"There is no RINEX file {path}.")
        content = self.path.read_bytes().removeprefix(codecs.BOM_UTF8)
        if b"\0" in content:
            raise ValueError(
                f"{path} is not a RINEX text file; decompress it first if it is compressed."
            )
        content = re.sub(rb"\x1a[\x1a\s]*\Z", b"", content)  # DOS ends files with ^Z
        # Columns count bytes, and comments may hold any letters of any encoding
        self._lines = [row.decode("latin-1") for row in content.splitlines()]

    def __bool__(self) -> bool:
        return self.number < len(self._lines)

    def next(self, what: str) -> str:
        """Return the next line, which holds this."""
        if not self:
            raise ValueError(
                f"{self.path} ends after line {self.number}, before {what}: it is cut off."
            )
        self.number += 1
        return self._lines[self.number - 1]

    def peek(self) -> str:
        """Return the next line without taking it."""
        return self._lines[self.number]

    def wrong(self, complaint: str) -> ValueError:
        """Return a complaint about the current line."""
        return ValueError(f"{self.path}, line {self.number}: {complaint}.")

    @contextmanager
    def at(self, number: int) -> Iterator[None]:
        """Complain about an earlier line while this lasts."""
        here, self.number = self.number, number
        yield
        self.number = here

    def real(self, text: str, what: str) -> float:
        """Return the number in a field, which may have an exponent D."""
        try:
            value = float(text.replace("D", "E").replace("d", "e"))
        except ValueError:
            value = nan
        if not abs(value) < LARGEST:
            raise self.wrong(f"{what} should be a number, but reads {excerpt(text.strip())!r}")
        return value

    def whole(self, text: str, what: str) -> int:
        """Return the whole number in a field."""
        try:
            return int(text)
        except ValueError:
            raise self.wrong(
                f"{what} should be a whole number, but reads {excerpt(text.strip())!r}"
            ) from None

    def instant(self, fields: Iterable[str], what: str) -> float:
        """Return year, month, day, hour, minute and seconds as seconds since the GPS epoch."""
        *whole, seconds = fields
        year, month, day, hour, minute = (
            self.whole(field, f"the time of {what}") for field in whole
        )
        if len(str(whole[0]).strip()) < 3:
            year += 1900 if year >= 80 else 2000
        try:
            start = datetime(year, month, day, hour, minute) - GPS_EPOCH
        except ValueError:
            raise self.wrong(f"the time of {what} is no date: {excerpt(' '.join(whole))}") from None
        return start / timedelta(seconds=1) + self.real(seconds, f"the time of {what}")


def read_header(lines: Lines, kind: str) -> tuple[int, Header]:
    """Read a header: its major version, and for each label its lines with their numbers.

    Args:
        lines: at the file's beginning; left after the header.
        kind: the letter of the file type wanted, "O" or "N".

    Raises:
        ValueError: if it is no RINEX 2 or 3 file of that kind with GPS in it.
    """
    first = lines.next("its header")
    label = first[HEADER_LABEL:].strip()
    if label.startswith("CRINEX"):
        raise lines.wrong("this is a Hatanaka-compressed file; decompress it with crx2rnx")
    if label != "RINEX VERSION / TYPE":
        raise lines.wrong("a RINEX file begins with 'RINEX VERSION / TYPE', this one does not")
    version = int(lines.real(first[:9], "the RINEX version"))
    names = {"O": "an observation file", "N": "a navigation file"}
    if version not in VERSIONS:
        told = excerpt(first[:9].strip())
        raise lines.wrong(f"RINEX version {told} is not read, only 2 and 3 are")
    if first[20:21] != kind:
        raise lines.wrong(
            f"{names[kind]} (type {kind!r}) is wanted, this has type {excerpt(first[20:21])!r}"
        )
    # RINEX 2 navigation files of GPS leave the system blank
    if first[40:41] not in (" ", "", "G", "M"):
        raise lines.wrong(
            f"only GPS, alone or mixed with others, is read, and this file is for another system "
            f"({excerpt(first[40:41])!r})"
        )
    header: Header = {}
    while True:
        line = lines.next("the end of its header")
        label = line[HEADER_LABEL:].strip()
        if label == "END OF HEADER":
            return version, header
        header.setdefault(label, []).append((lines.number, line[:HEADER_LABEL].ljust(HEADER_LABEL)))
