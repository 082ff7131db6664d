"""Readers of RINEX 2 and 3 observation files, for what locating a receiver needs.

Read are one pseudorange with its Doppler and C/N0, of GPS, QZSS and Galileo on L1 and of
BeiDou on B1I (of RINEX 2 files GPS alone), and the station's position in the header.
Everything else (GLONASS, carrier phases, L2) is passed over. Each complaint is one sentence
that names the file and the line. (The parsers to be had either bring a C library or pass
silently over an epoch that is cut off.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.names import excerpt
from kfenv.scenarios.gnss.rinex_lines import HEADER_LABEL, Header, Lines, read_header

Array = NDArray[np.float64]
Columns = dict[str, tuple[int | None, ...]]  # of a system: pseudorange, Doppler, C/N0
Epoch = tuple[int, float, dict[int, list[float]]]  # flag, time, values of a satellite

SYSTEMS = "GJEC"  # GPS, QZSS, Galileo, BeiDou
PER_SYSTEM = 100  # a satellite's number is its PRN and this for each system before its own
# Pseudoranges, best first: C/A is what every receiver has; BeiDou's first band is 1 in RINEX 3.02
PSEUDORANGES: dict[int, dict[str, tuple[str, ...]]] = {
    2: {"G": ("C1", "P1")},
    3: {
        "G": tuple("C1" + tracking for tracking in "CSLXPWYM"),
        "J": tuple("C1" + tracking for tracking in "CSLXZ"),
        "E": tuple("C1" + tracking for tracking in "CXBAZ"),
        "C": ("C2I", "C2Q", "C2X", "C1I", "C1Q"),
    },
}
L1, B1I = 1575.42e6, 1561.098e6  # Hz
FREQUENCY = {"G": L1, "J": L1, "E": L1, "C": B1I}
TYPES = {2: "# / TYPES OF OBSERV", 3: "SYS / # / OBS TYPES"}  # header labels
WIDTH, VALUE = 16, 14  # of one observation with its two flags; without them


@dataclass(frozen=True, eq=False)
class Observations:
    """What a receiver observed.

    Attributes:
        path: of the file.
        time: (T,) by the receiver's clock, increasing, seconds since the GPS epoch
            (1980-01-06); their resolution is 1.2e-7 s, in which a satellite moves 0.5 mm.
        satellite: (S,) numbers, increasing: the PRN of GPS, 100 more of QZSS, 200 more of
            Galileo, 300 more of BeiDou.
        pseudorange: (T, S) m, NaN where there is none.
        doppler: (T, S) Hz, positive when approaching, NaN where there is none.
        strength: (T, S) C/N0, dB-Hz, NaN where there is none.
        codes: of each system's pseudorange, e.g. {"G": "C1C"}.
        position: (3,) of the antenna, from the header, ECEF m; None where that has none.
        moved: whether the file says that the receiver moved, or came to another site.
    """

    path: str
    time: Array
    satellite: NDArray[np.int64]
    pseudorange: Array
    doppler: Array
    strength: Array
    codes: dict[str, str]
    position: Array | None
    moved: bool

    def of(self, chosen: NDArray) -> Observations:
        """Of the chosen satellites alone."""
        tables = ("pseudorange", "doppler", "strength")
        values = {name: getattr(self, name)[:, chosen] for name in tables}
        return replace(self, satellite=self.satellite[chosen], **values)

    @property
    def system(self) -> NDArray[np.str_]:
        """The letter (S,) of each satellite's system."""
        return np.array(list(SYSTEMS))[self.satellite // PER_SYSTEM]

    @property
    def frequency(self) -> Array:
        """Of each satellite's carrier (S,), Hz."""
        return np.array([FREQUENCY[system] for system in self.system])

    @property
    def names(self) -> NDArray[np.str_]:
        """Of the satellites (S,), such as G05."""
        numbers = zip(self.system, self.satellite % PER_SYSTEM, strict=True)
        return np.array([f"{system}{prn:02d}" for system, prn in numbers])


def number_of(system: str, prn: int) -> int:
    """A satellite's number, see `Observations`."""
    return PER_SYSTEM * SYSTEMS.index(system) + prn


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
    codes, columns = _columns(str(path), version, kinds)
    epochs: list[tuple[float, dict[int, list[float]]]] = []
    moved = False
    while lines:
        if not lines.peek().strip():  # some writers end with an empty line
            lines.next("")
            continue
        if version == 2:
            flag, time, satellites = _epoch_v2(lines, len(kinds["G"]), columns)
        else:
            flag, time, satellites = _epoch_v3(lines, kinds, columns)
        moved |= flag in (2, 3)
        if flag > 1:
            continue
        if epochs and not time > epochs[-1][0]:
            raise lines.wrong("this epoch is not later than the one before")
        epochs.append((time, satellites))
    return _table(path, epochs, codes, _position(lines, header), moved)


def _columns(path: str, version: int, kinds: dict[str, list[str]]) -> tuple[dict, Columns]:
    """The pseudorange that is read of each system, and where it, its Doppler and C/N0 stand."""
    codes, columns = {}, {}
    for system, best in PSEUDORANGES[version].items():
        listed = kinds.get(system, [])
        code = next((code for code in best if code in listed), None)
        if code is not None:
            wanted = (code, "D" + code[1:], "S" + code[1:])
            codes[system] = code
            columns[system] = tuple(
                listed.index(kind) if kind in listed else None for kind in wanted
            )
    if "G" not in codes:
        found = excerpt(", ".join(kinds["G"])) if kinds["G"] else "none"
        raise ValueError(f"{path}: the header lists no GPS pseudorange on L1, only {found}.")
    return codes, columns


def _table(
    path: str | Path,
    epochs: list[tuple[float, dict[int, list[float]]]],
    codes: dict[str, str],
    position: Array | None,
    moved: bool,
) -> Observations:
    satellites = sorted({number for _, values in epochs for number in values})
    if not satellites or satellites[0] >= PER_SYSTEM:
        raise ValueError(f"{path} holds no GPS observation.")
    values = np.full((3, len(epochs), len(satellites)), np.nan)
    place = {number: column for column, number in enumerate(satellites)}
    for row, (_, observed) in enumerate(epochs):
        for number, seen in observed.items():
            values[:, row, place[number]] = seen
    time = np.array([time for time, _ in epochs])
    return Observations(
        str(path), time, np.array(satellites), *values, codes=codes, position=position, moved=moved
    )


def _check_conventions(lines: Lines, header: Header) -> None:
    for number, line in header.get("SYS / SCALE FACTOR", []):
        if line[0] in SYSTEMS:
            with lines.at(number):
                raise lines.wrong("observations with a scale factor are not read")
    for number, line in header.get("TIME OF FIRST OBS", []):
        if line[48:51].strip() not in ("", "GPS"):
            with lines.at(number):
                raise lines.wrong(
                    f"GPS times are wanted, the file has {excerpt(line[48:51])} times"
                )


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


def _kinds_v2(lines: Lines, header: Header) -> dict[str, list[str]]:
    """The types of observation, in their order, which are those of GPS."""
    rows = header.get(TYPES[2])
    if not rows:
        raise ValueError(f"{lines.path}: its header has no line {TYPES[2]!r}.")
    kinds = [kind for _, line in rows for kind in line[6:60].split()]
    _check_count(lines, rows[0], rows[0][1][:6], kinds)
    return {"G": kinds}


def _kinds_v3(lines: Lines, header: Header) -> dict[str, list[str]]:
    """The types of observation of each system, in their order."""
    rows, system = header.get(TYPES[3]), ""
    kinds: dict[str, list[str]] = {}
    first: dict[str, tuple[int, str]] = {}
    if not rows:
        raise ValueError(f"{lines.path}: its header has no line {TYPES[3]!r}.")
    for number, line in rows:
        system = line[0].strip() or system
        first.setdefault(system, (number, line))
        kinds.setdefault(system, []).extend(line[6:60].split())
    if "G" not in kinds:
        raise ValueError(f"{lines.path}: its header lists no observations of GPS (system G).")
    for system in SYSTEMS:
        if system in kinds:
            _check_count(lines, first[system], first[system][1][3:6], kinds[system])
    return kinds


def _check_count(lines: Lines, row: tuple[int, str], count: str, kinds: list[str]) -> None:
    with lines.at(row[0]):
        if lines.whole(count, "the number of observation types") != len(kinds):
            said = excerpt(count.strip())
            raise lines.wrong(f"{said} types of observation are said, {len(kinds)} listed")


def _epoch_v2(lines: Lines, kinds: int, columns: Columns) -> Epoch:
    """Read one epoch: its flag, time, and each satellite's pseudorange, Doppler and C/N0."""
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
            satellites[prn] = _values(lines, text, 0, columns["G"])
    return flag, time, satellites


def _rows_v2(count: int, kinds: int) -> int:
    """How many lines follow an epoch line that reports cycle slips."""
    return count * -(-kinds // 5) + (count - 1) // 12


def _epoch_v3(lines: Lines, kinds: dict[str, list[str]], columns: Columns) -> Epoch:
    """Read one epoch: its flag, time, and each satellite's pseudorange, Doppler and C/N0."""
    line = lines.next("an epoch")
    if not line.startswith(">"):
        raise lines.wrong("an epoch's line that begins with '>' is wanted here")
    if line[1:2] != " ":  # some writers leave the blank out
        line = f"> {line[1:]}"
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
        system = line[:1]
        if system in columns:
            number = number_of(system, lines.whole(line[1:3], "a satellite's number"))
            text = line.ljust(3 + len(kinds[system]) * WIDTH)
            satellites[number] = _values(lines, text, 3, columns[system])
    return flag, time, satellites


def _skip(lines: Lines, count: int) -> dict:
    for _ in range(count):
        line = lines.next("the rest of an event")
        if line[HEADER_LABEL:].strip() in (TYPES[2], TYPES[3]):
            raise lines.wrong("the types of observation change here; split the file")
    return {}


def _values(
    lines: Lines, text: str, start: int, columns: tuple[int | None, ...]
) -> list[float]:  # fmt: skip
    """Pseudorange, Doppler and C/N0 in a satellite's fields; zero and blank mean missing."""
    values = []
    for what, column in zip(("pseudorange", "Doppler", "C/N0"), columns, strict=True):
        at = start + WIDTH * (column or 0)
        field = text[at : at + VALUE]
        if column is None or not field.strip():
            values.append(np.nan)
            continue
        # A line that was cut within a number would still read as a number
        if field[10] != "." or not field[11:].isdigit():
            raise lines.wrong(
                f"a {what} should fill 14 columns with three decimals, but reads "
                f"{excerpt(field.strip())!r}"
            )
        values.append(lines.real(field, f"a {what}") or np.nan)
    return values
