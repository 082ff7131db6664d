"""Broadcast ephemerides: RINEX 2 and 3 navigation files, and orbits and clocks from them.

The orbit is that of IS-GPS-200, table 20-IV: Kepler's with secular and harmonic
corrections, in ECEF at the instant asked for. The clock is that of section 20.3.3.3.3.
QZSS, Galileo (OS-SIS-ICD 5.1.1) and BeiDou's higher and inclined orbits (BDS-SIS-ICD B1I
5.2.4) have the same with their own constants and group delays; BeiDou's geostationary
satellites, whose orbit is told in another frame, are passed over.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.orbits import EARTH_RATE, GRAVITY, WEEK, eccentric_anomaly
from kfenv.names import excerpt
from kfenv.scenarios.gnss.rinex import PER_SYSTEM, SYSTEMS, number_of
from kfenv.scenarios.gnss.rinex_lines import Header, Lines, read_header

Array = NDArray[np.float64]

RELATIVITY = -4.442807633e-10  # s/m^0.5, the clock's -2 sqrt(mu)/c^2
FIT_INTERVAL = 4.0  # h, where a file does not tell

# The numbers of a record in their order; None are not used
RECORD = (
    "af0", "af1", "af2",
    None, "crs", "delta_n", "m0",
    "cuc", "e", "cus", "root_a",
    "toe", "cic", "omega0", "cis",
    "i0", "crc", "omega", "omega_dot",
    "i_dot", None, None, None,
    None, "health", "tgd", None,
    None, "fit_interval",
)  # fmt: skip
FIT_SYSTEMS = "GJ"  # whose records tell the fit interval
SOURCE, OTHER_DELAY = 20, 26  # in Galileo's: where a record comes from, and the delay of I/NAV
F_NAV = 0b10  # the bit of the source that belongs to the first delay
BEIDOU_GRAVITY, BEIDOU_RATE = 3.986004418e14, 7.2921150e-5
CONSTANTS = {
    "G": (GRAVITY, EARTH_RATE),
    "J": (GRAVITY, EARTH_RATE),
    "E": (BEIDOU_GRAVITY, EARTH_RATE),
    "C": (BEIDOU_GRAVITY, BEIDOU_RATE),
}
BEIDOU_BEHIND = 14.0  # s behind GPS time
GEOSTATIONARY = (*range(1, 6), *range(59, 64))  # of BeiDou
FIRST_LINE, OTHER_LINES, WIDTH = 3, 4, 19  # numbers in a line, and a number's columns


@dataclass(frozen=True, eq=False)
class Ephemerides:
    """What a navigation file holds, unhealthy satellites left out.

    Attributes:
        path: of the file.
        satellite: (N,) numbers as `kfenv.scenarios.gnss.rinex.Observations` has them.
        time: (N,) of ephemeris, seconds since the GPS epoch.
        clock_time: (N,) of clock, seconds since the GPS epoch.
        value: for each quantity of IS-GPS-200 its (N,) values in SI units and radians; toe
            is the second of its own system's week, gravity and earth_rate are its constants.
        klobuchar: (8,) alpha0 to alpha3 and beta0 to beta3 of the ionosphere, in s and
            powers of semicircles; None where the header has none.
    """

    path: str
    satellite: NDArray[np.int64]
    time: Array
    clock_time: Array
    value: dict[str, Array]
    klobuchar: Array | None

    def choose(self, satellite: NDArray[np.int64], time: Array) -> NDArray[np.int64]:
        """Return which ephemeris is nearest in time, -1 where none is valid then.

        Args:
            satellite, time: numbers and seconds since the GPS epoch, of any one shape.
        """
        satellite, time = np.broadcast_arrays(satellite, time)
        chosen = np.full(satellite.shape, -1)
        for prn in np.unique(satellite):
            rows = np.flatnonzero(self.satellite == prn)
            if not rows.size:
                continue
            here = satellite == prn
            away = np.abs(time[here][:, None] - self.time[rows])
            # one second of grace: a fit may end exactly where the next begins
            valid = away <= 1800.0 * self.value["fit_interval"][rows] + 1.0
            nearest = np.where(valid, away, np.inf).argmin(axis=1)
            chosen[here] = np.where(valid.any(axis=1), rows[nearest], -1)
        return chosen


@dataclass(frozen=True, eq=False)
class SatelliteStates:
    """Where satellites are and what their clocks show.

    Attributes:
        position, velocity: (..., 3) of the antenna's phase centre, ECEF of that instant,
            m and m/s.
        clock, clock_rate: (...) ahead of GPS time for a user of L1 alone, s and s/s.
    """

    position: Array
    velocity: Array
    clock: Array
    clock_rate: Array


def satellite_states(
    ephemerides: Ephemerides, row: NDArray[np.int64], time: Array
) -> SatelliteStates:
    """Return the states of satellites at the given times.

    Args:
        ephemerides: of a navigation file.
        row: (...) which of them to use, from `Ephemerides.choose`; NaN results where -1.
        time: (...) GPS time at the satellite, seconds since the GPS epoch.
    """
    row, time = np.broadcast_arrays(row, np.where(row < 0, np.nan, time))
    v = {name: value[row] for name, value in ephemerides.value.items()}
    dt = time - ephemerides.time[row]
    a = v["root_a"] ** 2
    motion = np.sqrt(v["gravity"] / a**3) + v["delta_n"]
    anomaly = eccentric_anomaly(v["m0"] + motion * dt, v["e"])
    sine, cosine = np.sin(anomaly), np.cos(anomaly)
    rate = motion / (1.0 - v["e"] * cosine)  # of the eccentric anomaly

    minor = np.sqrt(1.0 - v["e"] ** 2)
    latitude = np.arctan2(minor * sine, cosine - v["e"]) + v["omega"]
    latitude_rate = rate * minor / (1.0 - v["e"] * cosine)
    s2, c2 = np.sin(2.0 * latitude), np.cos(2.0 * latitude)

    def corrected(plain: Array, plain_rate: Array, sine_term: str, cosine_term: str):
        value = plain + v[sine_term] * s2 + v[cosine_term] * c2
        change = 2.0 * latitude_rate * (v[sine_term] * c2 - v[cosine_term] * s2)
        return value, plain_rate + change

    u, u_rate = corrected(latitude, latitude_rate, "cus", "cuc")
    r, r_rate = corrected(a * (1.0 - v["e"] * cosine), a * v["e"] * sine * rate, "crs", "crc")
    i, i_rate = corrected(v["i0"] + v["i_dot"] * dt, v["i_dot"], "cis", "cic")
    node_rate = v["omega_dot"] - v["earth_rate"]
    node = v["omega0"] + node_rate * dt - v["earth_rate"] * v["toe"]

    in_plane = (r * np.cos(u), r * np.sin(u))
    in_plane_rate = (
        r_rate * np.cos(u) - in_plane[1] * u_rate,
        r_rate * np.sin(u) + in_plane[0] * u_rate,
    )
    position, velocity = _from_plane(in_plane, in_plane_rate, i, i_rate, node, node_rate)
    clock, clock_rate = _clock(ephemerides, row, time, v, sine, cosine, rate)
    return SatelliteStates(position, velocity, clock, clock_rate)


def _from_plane(plane, plane_rate, i, i_rate, node, node_rate) -> tuple[Array, Array]:
    """Turn a motion in the orbital plane into ECEF position and velocity."""
    (x, y), (vx, vy) = plane, plane_rate
    ci, si, cn, sn = np.cos(i), np.sin(i), np.cos(node), np.sin(node)
    position = np.stack((x * cn - y * ci * sn, x * sn + y * ci * cn, y * si), axis=-1)
    across = vy * ci - y * si * i_rate  # of y cos i, the part of y in the equator's plane
    velocity = np.stack(
        (
            vx * cn - across * sn - position[..., 1] * node_rate,
            vx * sn + across * cn + position[..., 0] * node_rate,
            vy * si + y * ci * i_rate,
        ),
        axis=-1,
    )
    return position, velocity


def _clock(ephemerides, row, time, v, sine, cosine, rate) -> tuple[Array, Array]:
    """The polynomial, the relativistic effect of the eccentric orbit, and the group delay."""
    since = time - ephemerides.clock_time[row]
    eccentric = RELATIVITY * np.sqrt(v["gravity"] / GRAVITY) * v["e"] * v["root_a"]
    clock = v["af0"] + since * (v["af1"] + since * v["af2"]) + eccentric * sine - v["tgd"]
    return clock, v["af1"] + 2.0 * since * v["af2"] + eccentric * cosine * rate


# ----- navigation files -------------------------------------------------------------------


def read_navigation(path: str | Path) -> Ephemerides:
    """Read a RINEX 2 or 3 navigation file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not such a file, is cut off or garbled, or has no ephemeris
            of a healthy GPS satellite; the message names the file and the line.
    """
    lines = Lines(path)
    version, header = read_header(lines, "N")
    klobuchar = _klobuchar(lines, header)
    satellites, clock_times, records = [], [], []
    while lines:
        line = lines.next("")
        if not line.strip():
            continue
        system = line[:1] if version == 3 else "G"
        if system not in SYSTEMS:
            _skip_record(lines)
            continue
        prn, clock_time = _record_time(lines, line, version)
        record = _record(lines, line, version, system)
        if record["health"] == 0.0 and not (system == "C" and prn in GEOSTATIONARY):
            satellites.append(number_of(system, prn))
            clock_times.append(clock_time)
            records.append(record)
    if not any(number < PER_SYSTEM for number in satellites):
        raise ValueError(f"{path} holds no ephemeris of a healthy GPS satellite.")
    value = {name: np.array([record[name] for record in records]) for name in records[0]}
    satellite, clock_time = np.array(satellites), np.array(clock_times)
    behind = np.where(satellite // PER_SYSTEM == SYSTEMS.index("C"), BEIDOU_BEHIND, 0.0)
    # The time of ephemeris is a second of the week: of that which puts it nearest to the clock's
    second = value["toe"] - np.mod(clock_time, WEEK)
    time = clock_time + second - WEEK * np.round(second / WEEK)
    return Ephemerides(str(path), satellite, time + behind, clock_time + behind, value, klobuchar)


def _klobuchar(lines: Lines, header: Header) -> Array | None:
    """The coefficients from a header of either version."""
    rows = {label: header[label][-1] for label in ("ION ALPHA", "ION BETA") if label in header}
    start = 2
    for number, line in header.get("IONOSPHERIC CORR", []):
        start = 5
        rows[{"GPSA": "ION ALPHA", "GPSB": "ION BETA"}.get(line[:4], line[:4])] = (number, line)
    if not {"ION ALPHA", "ION BETA"} <= set(rows):
        return None
    values = []
    for label in ("ION ALPHA", "ION BETA"):
        number, line = rows[label]
        with lines.at(number):
            values += [lines.real(line[i : i + 12], label) for i in range(start, start + 48, 12)]
    return np.array(values)


def _skip_record(lines: Lines) -> None:
    """Leave out another system's record, whose further lines are indented."""
    while lines and lines.peek()[:1] == " ":
        lines.next("")


def _record_time(lines: Lines, line: str, version: int) -> tuple[int, float]:
    if version == 2:
        prn, bounds = line[:2], ((3, 5), (6, 8), (9, 11), (12, 14), (15, 17), (17, 22))
    else:
        prn, bounds = line[1:3], ((4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23))
    fields = [line[begin:end] for begin, end in bounds]
    return lines.whole(prn, "a satellite's number"), lines.instant(fields, "the clock")


def _record(lines: Lines, line: str, version: int, system: str) -> dict[str, float]:
    """Read the numbers of one ephemeris; its first line has been taken."""
    indent = 3 if version == 2 else 4
    fields = [line[indent + WIDTH * column :][:WIDTH] for column in range(1, FIRST_LINE + 1)]
    record: dict[str, float] = {}
    for place, name in enumerate(RECORD):
        column = (place - FIRST_LINE) % OTHER_LINES
        if place >= FIRST_LINE and column == 0:
            line = lines.next("the end of an ephemeris")
            fields += [line[indent + WIDTH * column :][:WIDTH] for column in range(OTHER_LINES)]
        told = name != "fit_interval" or (system in FIT_SYSTEMS and fields[place].strip())
        if name is not None and told:
            record[name] = _number(lines, fields[place], name)
    if system == "E" and not int(_number(lines, fields[SOURCE], "the source")) & F_NAV:
        record["tgd"] = _number(lines, fields[OTHER_DELAY], "tgd")
    record["gravity"], record["earth_rate"] = CONSTANTS[system]
    if record.setdefault("fit_interval", FIT_INTERVAL) < FIT_INTERVAL:
        record["fit_interval"] = FIT_INTERVAL  # 0 in older files is a flag: "four hours"
    if not (record["root_a"] > 2500.0 and 0.0 <= record["e"] < 0.1):
        raise lines.wrong(
            f"this ephemeris is no satellite's orbit: sqrt(a) = {record['root_a']:g} m^0.5, "
            f"e = {record['e']:g}"
        )
    if not 0.0 <= record["toe"] <= WEEK:
        raise lines.wrong(f"toe = {record['toe']:g} s of this ephemeris is no second of a week")
    return record


def _number(lines: Lines, field: str, name: str) -> float:
    # A number that was cut short could still read as one
    if len(field.rstrip()) < WIDTH:
        raise lines.wrong(
            f"{name} should fill {WIDTH} columns, but reads {excerpt(field.strip())!r}"
        )
    return lines.real(field, name)
