"""Readers of RINEX 2 and 3 observation files, for what locating a GPS receiver needs.

Read are, of GPS, one pseudorange and its Doppler on L1, and the station's position in
the header. Everything else (other systems, carrier phases, L2) is passed over. Each
complaint is one sentence that names the file and the line. (The parsers to be had
either bring a C library or pass silently over an epoch that is cut off.)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import isfinite, nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Header = dict[str, list[tuple[int, str]]]  # label: lines with their numbers
Epoch = tuple[int, float, dict[int, tuple[float, float]]]  # flag, time, values of a satellite

GPS_EPOCH = datetime(1980, 1, 6)

# L1 pseudoranges, best first: C/A is what every receiver has
PSEUDORANGES = {2: ("C1", "P1"), 3: tuple("C1" + tracking for tracking in "CSLXPWYM")}
TYPES = {2: "# / TYPES OF OBSERV", 3: "SYS / # / OBS TYPES"}  # header labels
WIDTH, VALUE = 16, 14  # of one observation with its two flags; without them
HEADER_LABEL = 60  # column at which a header line's label begins


@dataclass(frozen=True, eq=False)
class Observations:
    """What a GPS receiver observed on L1.

    Attributes:
        path: of the file.
        time: (T,) by the receiver's clock, increasing, seconds since the GPS epoch
            (1980-01-06); their resolution is 1.2e-7 s, in which a satellite moves 0.5 mm.
        satellite: (S,) PRN numbers, increasing.
        pseudorange: (T, S) m, NaN where there is none.
        doppler: (T, S) Hz, positive when approaching, NaN where there is none.
        code: of the pseudorange, e.g. "C1" or "C1C".
        position: (3,) of the antenna, from the header, ECEF m; None where that has none.
        moved: whether the file says that the receiver moved, or came to another site.
    """

    path: str
    time: Array
    satellite: NDArray[np.int64]
    pseudorange: Array
    doppler: Array
    code: str
    position: Array | None
    moved: bool


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
        try:
            self._lines = self.path.read_text(encoding="ascii", errors="strict").splitlines()
        except UnicodeDecodeError:
            # Names in headers may hold any letters; a compressed file holds NUL bytes too
            content = self.path.read_bytes()
            if b"\0" in content:
                raise ValueError(
                    f"{path} is not a RINEX text file; decompress it first if it is compressed."
                ) from None
            self._lines = content.decode("latin-1").splitlines()

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
        if not isfinite(value):
            raise self.wrong(f"{what} should be a number, but reads {text.strip()!r}")
        return value

    def whole(self, text: str, what: str) -> int:
        """Return the whole number in a field."""
        try:
            return int(text)
        except ValueError:
            raise self.wrong(
                f"{what} should be a whole number, but reads {text.strip()!r}"
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
            raise self.wrong(f"the time of {what} is no date: {' '.join(whole)}") from None
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
    if version not in PSEUDORANGES:
        raise lines.wrong(f"RINEX version {first[:9].strip()} is not read, only 2 and 3 are")
    if first[20:21] != kind:
        raise lines.wrong(
            f"{names[kind]} (type {kind!r}) is wanted, this has type {first[20:21]!r}"
        )
    # RINEX 2 navigation files of GPS leave the system blank
    if first[40:41] not in (" ", "", "G", "M"):
        raise lines.wrong(
            f"only GPS is read, and this file is for another system ({first[40:41]!r})"
        )
    header: Header = {}
    while True:
        line = lines.next("the end of its header")
        label = line[HEADER_LABEL:].strip()
        if label == "END OF HEADER":
            return version, header
        header.setdefault(label, []).append((lines.number, line[:HEADER_LABEL].ljust(HEADER_LABEL)))


def read_observations(path: str | Path) -> Observations:
    """Read a RINEX 2 or 3 observation file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not such a file, is cut off or garbled, or has no GPS
            pseudorange on L1; the message names the file and the line.
    """
    lines = Lines(path)
    version, header = read_header(lines, "O")
    _check_conventions(lines, header)
    kinds = _kinds_v2(lines, header) if version == 2 else _kinds_v3(lines, header)
    code = next((code for code in PSEUDORANGES[version] if code in kinds), None)
    if code is None:
        raise ValueError(
            f"{path}: the header lists no GPS pseudorange on L1, only {', '.join(kinds) or 'none'}."
        )
    doppler = "D" + code[1:]
    columns = (kinds.index(code), kinds.index(doppler) if doppler in kinds else None)
    read_epoch = _epoch_v2 if version == 2 else _epoch_v3
    epochs: list[tuple[float, dict[int, tuple[float, float]]]] = []
    moved = False
    while lines:
        if not lines.peek().strip():  # some writers end with an empty line
            lines.next("")
            continue
        flag, time, satellites = read_epoch(lines, len(kinds), columns)
        moved |= flag in (2, 3)
        if flag > 1:
            continue
        if epochs and not time > epochs[-1][0]:
            raise lines.wrong("this epoch is not later than the one before")
        epochs.append((time, satellites))
    return _table(path, epochs, code, _position(lines, header), moved)


def _table(
    path: str | Path,
    epochs: list[tuple[float, dict[int, tuple[float, float]]]],
    code: str,
    position: Array | None,
    moved: bool,
) -> Observations:
    satellites = sorted({prn for _, values in epochs for prn in values})
    if not satellites:
        raise ValueError(f"{path} holds no GPS observation.")
    values = np.full((len(epochs), len(satellites), 2), np.nan)
    place = {prn: column for column, prn in enumerate(satellites)}
    for row, (_, observed) in enumerate(epochs):
        for prn, pair in observed.items():
            values[row, place[prn]] = pair
    time = np.array([time for time, _ in epochs])
    return Observations(
        str(path), time, np.array(satellites), values[..., 0].copy(), values[..., 1].copy(), code,
        position, moved,
    )  # fmt: skip


def _check_conventions(lines: Lines, header: Header) -> None:
    for number, line in header.get("SYS / SCALE FACTOR", []):
        if line[0] == "G":
            with lines.at(number):
                raise lines.wrong("observations with a scale factor are not read")
    for number, line in header.get("TIME OF FIRST OBS", []):
        if line[48:51].strip() not in ("", "GPS"):
            with lines.at(number):
                raise lines.wrong(f"GPS times are wanted, the file has {line[48:51]} times")


def _position(lines: Lines, header: Header) -> Array | None:
    """The marker's position and the antenna's offset from it, ECEF m; None if unknown."""
    marker = _vector(lines, header, "APPROX POSITION XYZ")
    up, east, north = _vector(lines, header, "ANTENNA: DELTA H/E/N")
    if np.linalg.norm(marker) < 1e6:  # zeros where a receiver did not know
        return None
    import pymap3d

    latitude, longitude, _ = pymap3d.ecef2geodetic(*marker)
    return marker + np.array(pymap3d.enu2uvw(east, north, up, latitude, longitude))


def _vector(lines: Lines, header: Header, label: str) -> Array:
    """The three numbers of a header line, m; zeros where there is none."""
    if label not in header:
        return np.zeros(3)
    number, line = header[label][-1]
    with lines.at(number):
        return np.array([lines.real(line[i : i + 14], label) for i in (0, 14, 28)])


def _kinds_v2(lines: Lines, header: Header) -> list[str]:
    """The types of observation, in their order."""
    rows = header.get(TYPES[2])
    if not rows:
        raise ValueError(f"{lines.path}: its header has no line {TYPES[2]!r}.")
    kinds = [kind for _, line in rows for kind in line[6:60].split()]
    _check_count(lines, rows[0], rows[0][1][:6], kinds)
    return kinds


def _kinds_v3(lines: Lines, header: Header) -> list[str]:
    """The types of observation of GPS, in their order."""
    rows, system, kinds, first = header.get(TYPES[3]), "", [], None
    if not rows:
        raise ValueError(f"{lines.path}: its header has no line {TYPES[3]!r}.")
    for number, line in rows:
        system = line[0].strip() or system
        if system == "G":
            first = first or (number, line)
            kinds += line[6:60].split()
    if first is None:
        raise ValueError(f"{lines.path}: its header lists no observations of GPS (system G).")
    _check_count(lines, first, first[1][3:6], kinds)
    return kinds


def _check_count(lines: Lines, row: tuple[int, str], count: str, kinds: list[str]) -> None:
    with lines.at(row[0]):
        if lines.whole(count, "the number of observation types") != len(kinds):
            raise lines.wrong(f"{count.strip()} types of observation are said, {len(kinds)} listed")


def _epoch_v2(lines: Lines, kinds: int, columns: tuple[int, int | None]) -> Epoch:
    """Read one epoch: its flag, time, and for each satellite pseudorange and Doppler."""
    line = lines.next("an epoch")
    flag = lines.whole(line[26:29] or "", "the epoch's flag")
    count = lines.whole(line[29:32], "the epoch's number of satellites")
    if flag > 1:
        return flag, np.nan, _skip(lines, count if flag < 6 else _rows_v2(count, kinds))
    starts = (1, 4, 7, 10, 13)
    time = lines.instant([line[i : i + 2] for i in starts] + [line[15:26]], "the epoch")
    names = line[32:68].ljust(36)
    while len(names) < 3 * count:
        names += lines.next("the epoch's satellites")[32:68].ljust(36)
    satellites = {}
    for index in range(count):
        name = names[3 * index : 3 * index + 3]
        prn = lines.whole(name[1:], "a satellite's number")
        rows = [lines.next("a satellite's observations") for _ in range(-(-kinds // 5))]
        if name[0] in " G":
            text = "".join(row.ljust(5 * WIDTH) for row in rows)
            satellites[prn] = _pair(lines, text, 0, columns)
    return flag, time, satellites


def _rows_v2(count: int, kinds: int) -> int:
    """How many lines follow an epoch line that reports cycle slips."""
    return count * -(-kinds // 5) + (count - 1) // 12


def _epoch_v3(lines: Lines, kinds: int, columns: tuple[int, int | None]) -> Epoch:
    """Read one epoch: its flag, time, and for each satellite pseudorange and Doppler."""
    line = lines.next("an epoch")
    if not line.startswith(">"):
        raise lines.wrong("an epoch's line that begins with '>' is wanted here")
    flag = lines.whole(line[29:32], "the epoch's flag")
    count = lines.whole(line[32:35], "the epoch's number of satellites")
    if flag > 1:
        return flag, np.nan, _skip(lines, count)
    bounds = ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29))
    time = lines.instant([line[i:j] for i, j in bounds], "the epoch")
    satellites = {}
    for _ in range(count):
        line = lines.next("a satellite's observations")
        if line.startswith(">"):
            raise lines.wrong(f"{count} satellites were announced, and fewer are listed")
        if line.startswith("G"):
            prn = lines.whole(line[1:3], "a satellite's number")
            satellites[prn] = _pair(lines, line.ljust(3 + kinds * WIDTH), 3, columns)
    return flag, time, satellites


def _skip(lines: Lines, count: int) -> dict:
    for _ in range(count):
        line = lines.next("the rest of an event")
        if line[HEADER_LABEL:].strip() in (TYPES[2], TYPES[3]):
            raise lines.wrong("the types of observation change here; split the file")
    return {}


def _pair(
    lines: Lines, text: str, start: int, columns: tuple[int, int | None]
) -> tuple[float, float]:
    """Pseudorange and Doppler from one satellite's fields; zero and blank mean missing."""
    values = []
    for what, column in zip(("pseudorange", "Doppler"), columns, strict=True):
        at = start + WIDTH * (column or 0)
        field = text[at : at + VALUE]
        if column is None or not field.strip():
            values.append(np.nan)
            continue
        # A line that was cut within a number would still read as a number
        if field[10] != "." or not field[11:].isdigit():
            raise lines.wrong(
                f"a {what} should fill 14 columns with three decimals, but reads {field.strip()!r}"
            )
        values.append(lines.real(field, f"a {what}") or np.nan)
    return values[0], values[1]
