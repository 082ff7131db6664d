"""Where orbits come from: the published 24-slot baseline, or a YUMA almanac."""

from __future__ import annotations

import re
from datetime import datetime
from math import isfinite, pi, radians
from os import PathLike
from pathlib import Path

import numpy as np

from kfenv.models.gnss.orbits import EARTH_RATE, WEEK, Constellation, gps_seconds
from kfenv.names import excerpt

WEEKS_PER_ROLLOVER = 1024

# GPS SPS Performance Standard, table A.2-1: right ascension of the six planes' nodes and
# argument of latitude of their slots, degrees, at the epoch; circular orbits.
BASELINE_EPOCH = datetime(1993, 7, 1)
BASELINE_SIDEREAL_ANGLE = radians((18.0 + 36.0 / 60.0 + 14.4 / 3600.0) * 15.0)  # of Greenwich
BASELINE_SEMI_MAJOR_AXIS = 26_559_700.0  # m
BASELINE_INCLINATION = radians(55.0)
BASELINE_PLANES = {
    272.847: (268.126, 161.786, 11.676, 41.806),
    332.847: (80.956, 173.336, 309.976, 204.376),
    32.847: (111.876, 11.796, 339.666, 241.556),
    92.847: (135.226, 265.446, 35.156, 167.356),
    152.847: (197.046, 302.596, 66.066, 333.686),
    212.847: (238.886, 345.226, 105.206, 135.346),
}

# Key of a YUMA line, and its least and greatest sensible value.
YUMA = {
    "id": (1, 255),
    "health": (0, 255),
    "eccentricity": (0.0, 0.1),
    "time of applicability": (0.0, WEEK),
    "orbital inclination": (0.0, pi),
    "rate of right ascen": (-1e-6, 1e-6),
    "sqrt(a)": (4000.0, 7000.0),
    "right ascen at week": (-2.0 * pi, 2.0 * pi),
    "argument of perigee": (-2.0 * pi, 2.0 * pi),
    "mean anom": (-2.0 * pi, 2.0 * pi),
    "week": (0, 10_000),
}


def baseline_constellation() -> Constellation:
    """The 24 slots that the GPS Performance Standard publishes, all healthy (SPEC 4.3).

    The nodes stand still in space, so the constellation keeps its shape at any date.
    """
    places = [(node, slot) for node, slots in BASELINE_PLANES.items() for slot in slots]
    node, slot = np.radians(np.array(places).T)
    same = np.ones(len(places))
    return Constellation(
        number=np.arange(1, len(places) + 1),
        reference=gps_seconds(BASELINE_EPOCH) * same,
        semi_major_axis=BASELINE_SEMI_MAJOR_AXIS * same,
        eccentricity=0.0 * same,
        inclination=BASELINE_INCLINATION * same,
        node_longitude=node - BASELINE_SIDEREAL_ANGLE,
        node_rate=0.0 * same,
        perigee=0.0 * same,
        mean_anomaly=slot,
        healthy=np.ones(len(places), bool),
    )


def read_yuma(path: str | PathLike[str], near: datetime) -> Constellation:
    """The satellites of a YUMA almanac file, the unhealthy ones marked.

    Args:
        path: the text file.
        near: a date close to the almanac's; weeks below 1024 do not tell the rollover.

    Raises:
        ValueError: naming the file and the line that cannot be used.
        OSError: if the file cannot be read.
    """
    blocks = _blocks(Path(path))
    week = {key: np.array([block[key] for block in blocks]) for key in YUMA}
    applies = week["time of applicability"]
    reference = WEEK * _full_week(week["week"], near) + applies
    return Constellation(
        number=week["id"].astype(np.int64),
        reference=reference,
        semi_major_axis=week["sqrt(a)"] ** 2,
        eccentricity=week["eccentricity"],
        inclination=week["orbital inclination"],
        node_longitude=week["right ascen at week"] - EARTH_RATE * applies,
        node_rate=week["rate of right ascen"],
        perigee=week["argument of perigee"],
        mean_anomaly=week["mean anom"],
        healthy=week["health"] == 0,
    )


def _full_week(week: np.ndarray, near: datetime) -> np.ndarray:
    """The week numbers since 1980, of those equal modulo 1024 the closest to the date."""
    rollovers = np.round((gps_seconds(near) / WEEK - week) / WEEKS_PER_ROLLOVER)
    return np.where(week < WEEKS_PER_ROLLOVER, week + WEEKS_PER_ROLLOVER * rollovers, week)


def _blocks(path: Path) -> list[dict[str, float]]:
    """One mapping from keys of `YUMA` to numbers per satellite."""
    blocks: list[dict[str, float]] = []
    text = path.read_text(encoding="ascii", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("****"):
            blocks.append({})
            continue
        name, colon, value = line.partition(":")
        key = re.sub(r"\s*\((?!a\)).*$", "", name.strip().lower())  # the unit goes, sqrt(a) stays
        key = "sqrt(a)" if key.startswith("sqrt(a)") else key
        if colon and key in YUMA and blocks:
            blocks[-1][key] = _number(value, key, f"{path}, line {number}")
    if not blocks:
        raise ValueError(
            f"{path} is no YUMA almanac: it has no line that begins with '****', as every "
            "satellite's block does."
        )
    for count, block in enumerate(blocks, start=1):
        missing = [key for key in YUMA if key not in block]
        if missing:
            raise ValueError(f"{path}: the block of satellite {count} lacks {', '.join(missing)}.")
    return blocks


def _number(text: str, key: str, where: str) -> float:
    low, high = YUMA[key]
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value) or not low <= value <= high:
        raise ValueError(
            f"{where}: {key} must be a number between {low:g} and {high:g}, got "
            f"{excerpt(text.strip())!r}."
        )
    return value
