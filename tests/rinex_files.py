"""Small RINEX files for tests: RINEX 3 written anew from what RINEX 2 files said."""

from pathlib import Path

import numpy as np
import pytest

from kfenv.models.gnss.orbits import GPS_EPOCH

FOLDER = Path(__file__).parents[1].parent / "shared" / "data" / "rinex"
OBSERVED, BROADCAST = FOLDER / "30400920.05o", FOLDER / "30400920.05n"

needs_rinex = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no RINEX files in ../shared/data/rinex ({FOLDER})"
)


def header_line(content, label):
    return f"{content:60s}{label}\n"


def write_observations(path, observations, doppler=None, position=None):
    """Observations as RINEX 3, among a GLONASS satellite and other codes; Doppler in Hz."""
    position = observations.position if position is None else position
    text = header_line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    text += header_line("".join(f"{x:14.4f}" for x in position), "APPROX POSITION XYZ")
    text += header_line("".join(f"{0.0:14.4f}" for _ in range(3)), "ANTENNA: DELTA H/E/N")
    text += header_line("G    4 L1C C1C D1C C2W", "SYS / # / OBS TYPES")
    text += header_line("R    1 C1C", "SYS / # / OBS TYPES")
    text += header_line("", "END OF HEADER")
    doppler = np.full(observations.pseudorange.shape, np.nan) if doppler is None else doppler
    for time, ranges, shifts in zip(
        observations.time, observations.pseudorange, doppler, strict=True
    ):
        seen = np.flatnonzero(np.isfinite(ranges))
        text += f"> {instant(time, ' ')}  0{len(seen) + 1:3d}\n"
        text += f"R05{23_000_000.0:14.3f}  \n"
        for i in seen:
            shift = "" if np.isnan(shifts[i]) else f"{shifts[i]:14.3f}"
            text += (
                f"G{observations.satellite[i]:02d}{-1234567.0:14.3f} 7"
                f"{ranges[i]:14.3f}  {shift}".rstrip()
                + "\n"
            )
    path.write_text(text)
    return path


def instant(time, separator):
    """Calendar date of a GPS time, its seconds with seven decimals."""
    from datetime import timedelta

    whole = int(time // 60.0) * 60
    date = GPS_EPOCH + timedelta(seconds=whole)
    return date.strftime(separator.join(("%Y", "%m", "%d", "%H", "%M"))) + f"{time - whole:11.7f}"


def write_navigation(path, rinex_2):
    """A RINEX 2 navigation file as RINEX 3, with GLONASS records between."""
    lines = rinex_2.read_text().splitlines()
    end = next(i for i, line in enumerate(lines) if "END OF HEADER" in line)
    text = header_line("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE")
    for system, label in (("GPSA", "ION ALPHA"), ("GPSB", "ION BETA")):
        line = next(line for line in lines[:end] if label in line)
        text += header_line(f"{system} {line[2:50]}", "IONOSPHERIC CORR")
    text += header_line("GAL  " + " 1.0000D+01" * 4, "IONOSPHERIC CORR")
    text += header_line("", "END OF HEADER")
    number = f"{1.0:19.12e}"
    for start in range(end + 1, len(lines), 8):
        first, *others = lines[start : start + 8]
        date = " ".join(f"{int(first[i : i + 2]):02d}" for i in (6, 9, 12, 15))
        text += (
            f"G{int(first[:2]):02d} 20{int(first[3:5]):02d} {date} {int(float(first[17:22])):02d}"
        )
        text += first[22:] + "\n" + "".join(f" {line}\n" for line in others)
        text += f"R05 2005 04 02 00 15 00{number * 3}\n" + f"    {number * 4}\n" * 3
    path.write_text(text.replace("2005  4", "2005 04"))
    return path
