"""A simulated vehicle with a receiver of GPS, Galileo and BeiDou, written as RINEX.

Orbits and clocks are broadcast ones made up from slots of Kepler orbits; what is written is
what the reader must take off again: satellite clocks, group delays, atmosphere, biases
between the systems, and the receiver's own clock.
"""

from dataclasses import dataclass

import numpy as np
import pymap3d
from rinex_files import header_line, instant

from kfenv.models.gnss.atmosphere import klobuchar, troposphere
from kfenv.models.gnss.orbits import SPEED_OF_LIGHT, WEEK, geodetic, look_angles, turned_with_earth
from kfenv.scenarios.gnss.ephemeris import read_navigation, satellite_states
from kfenv.scenarios.gnss.rinex import B1I, L1, number_of

PLACE = (48.0, 11.0, 500.0)
START = 2129 * WEEK + 5 * 86_400.0 + 13 * 3600.0  # GPS seconds
DAY = 304  # of the year, 30 October 2020
ALPHA, BETA = (1.7e-8, -7.5e-9, -1.2e-7, 1.2e-7), (1.2e5, -6.6e4, -3.3e5, 3.3e5)
FREQUENCY = {"G": L1, "E": L1, "C": B1I}
BIAS = {"G": 0.0, "E": 17.0, "C": -31.0}  # m, between the systems
# Semi-major axis, m; planes; satellites in each; inclination, deg; first PRN
ORBITS = {
    "G": (26.56e6, 6, 5, 55.0, 1),
    "E": (29.6e6, 3, 8, 56.0, 1),
    "C": (27.9e6, 3, 8, 55.0, 11),
}
SCALE = {"G": 1.0, "E": 1.0, "C": 1.0}


@dataclass(frozen=True, eq=False)
class Drive:
    """Attributes:
    observed, broadcast: paths of the files.
    time: (T,) true GPS seconds of the epochs.
    position, velocity: (T, 3) earth-fixed, m and m/s.
    clock, drift: (T,) m and m/s.
    satellite: (S,) numbers.
    range, rate: (T, S) what a receiver measures once all that is known is taken off, NaN
        where a satellite is below the mask.
    seen: (T, S, 6) position and velocity of the satellites in the reception's frame.
    strength: (T, S) C/N0, dB-Hz.
    """

    observed: object
    broadcast: object
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    clock: np.ndarray
    drift: np.ndarray
    satellite: np.ndarray
    range: np.ndarray
    rate: np.ndarray
    seen: np.ndarray
    strength: np.ndarray


def way(time):
    """East, north and up (T, 3) of a car that stands for 20 s and then turns and stops."""
    fine = np.arange(-1.0, time[-1] + 1.0, 0.05)
    speed = np.clip(0.75 * (fine - 20.0), 0.0, 15.0) * np.where(
        np.sin(fine / 40.0) > -0.8, 1.0, 0.1
    )
    speed = np.convolve(np.pad(speed, 40, mode="edge"), np.ones(81) / 81.0, mode="valid")
    heading = 0.8 * np.sin(fine / 25.0) + fine / 60.0
    place = np.cumsum(speed * np.stack((np.sin(heading), np.cos(heading), 0.02 + 0.0 * fine)), 1)
    return np.stack([np.interp(time, fine, 0.05 * axis) for axis in place], axis=-1)


def write_broadcast(path, systems):
    """A RINEX 3 navigation file of made-up satellites."""
    text = header_line("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE")
    for name, values in (("GPSA", ALPHA), ("GPSB", BETA)):
        row = "".join(f"{value:12.4e}" for value in values)
        text += header_line(f"{name} {row}", "IONOSPHERIC CORR")
    text += header_line("", "END OF HEADER")
    rng = np.random.default_rng(7)
    for system in systems:
        axis, planes, slots, inclination, first = ORBITS[system]
        behind = 14.0 if system == "C" else 0.0
        own = START - behind
        for k in range(planes * slots):
            plane, slot = divmod(k, slots)
            node = 2.0 * np.pi * plane / planes
            anomaly = 2.0 * np.pi * (slot + plane / planes) / slots
            delay = 1e-9 * rng.normal(scale=5.0, size=2)
            numbers = [
                1e-4 * rng.normal(), 1e-12 * rng.normal(), 0.0,
                0.0, rng.normal(scale=50.0), 4e-9, anomaly,
                1e-6 * rng.normal(), 0.01 * rng.random(), 1e-6 * rng.normal(), np.sqrt(axis),
                own % WEEK, 1e-7 * rng.normal(), node, 1e-7 * rng.normal(),
                np.radians(inclination), rng.normal(scale=200.0), rng.uniform(0, 6), -8e-9,
                1e-10 * rng.normal(), 517.0 if system == "E" else 1.0, own // WEEK, 0.0,
                2.0, 0.0, *delay,
                own % WEEK, 4.0, 0.0, 0.0,
            ]  # fmt: skip
            text += f"{system}{first + k:02d} {calendar(own)}"
            text += "".join(f"{x:19.12e}" for x in numbers[:3]) + "\n"
            for row in range(3, 31, 4):
                text += "    " + "".join(f"{x:19.12e}" for x in numbers[row : row + 4]) + "\n"
    path.write_text(text)
    return path


def calendar(time):
    """Year, month, day, hour, minute and second of a whole GPS second."""
    date = instant(time, " ")
    return f"{date[:16]} {int(float(date[16:])):02d}"


def drive(folder, systems="GEC", duration=240.0, interval=1.0, noise=True, seed=0, doppler=True):
    """Simulate a drive and write it."""
    rng = np.random.default_rng(seed)
    broadcast = write_broadcast(folder / "drive.nav", systems)
    orbits = read_navigation(broadcast)
    time = START + np.arange(0.0, duration + 0.5 * interval, interval)
    local = [way(np.maximum(time - START + h, -0.9)) for h in (-0.05, 0.0, 0.05)]
    before, position, after = (np.stack(pymap3d.enu2ecef(*enu.T, *PLACE), axis=-1) for enu in local)
    velocity = (after - before) / 0.1
    drift = 20.0 + 0.3 * np.cumsum(np.sqrt(interval) * rng.standard_normal(time.size))
    clock = 40_000.0 + interval * np.cumsum(drift)
    numbers = [
        number_of(system, ORBITS[system][4] + k)
        for system in systems
        for k in range(ORBITS[system][1] * ORBITS[system][2])
    ]
    satellite = np.array(sorted(numbers))
    letters = np.array(list("GJEC"))[satellite // 100]
    frequency = np.array([FREQUENCY[letter] for letter in letters])
    row = orbits.choose(satellite, time[:, None] + 0.0 * satellite)
    flight = np.full(row.shape, 0.075)
    for _ in range(4):
        states = satellite_states(orbits, row, time[:, None] - flight)
        there = turned_with_earth(states.position, flight)
        distance = np.linalg.norm(there - position[:, None], axis=-1)
        flight = distance / SPEED_OF_LIGHT
    moves = turned_with_earth(states.velocity, flight)
    elevation, azimuth = look_angles(position, there)
    up = elevation > np.radians(10.5)
    latitude, longitude, height = (value[:, None] for value in geodetic(position))
    above = np.maximum(elevation, 0.1)
    delay = troposphere(above, latitude, height, DAY + 0.0 * time[:, None])
    delay = delay + (L1 / frequency) ** 2 * klobuchar(
        ALPHA, BETA, latitude, longitude, above, azimuth, time[:, None]
    )
    strength = 30.0 + 18.0 * np.sin(elevation) + rng.normal(scale=2.0, size=row.shape)
    fade = 10.0 ** ((45.0 - strength) / 20.0)
    shakes = noise * fade * rng.standard_normal((2, *row.shape))
    slope = np.sum((there - position[:, None]) * (moves - velocity[:, None]), axis=-1) / distance
    ranges = np.where(up, distance + clock[:, None] + 1.5 * shakes[0], np.nan)
    rates = np.where(up, slope + drift[:, None] + 0.05 * shakes[1], np.nan)
    bias = np.array([BIAS[letter] for letter in letters])
    observed = write_observed(
        folder / "drive.obs", systems, time + clock / SPEED_OF_LIGHT, letters, satellite % 100,
        ranges + delay + bias - SPEED_OF_LIGHT * states.clock,
        -(rates - SPEED_OF_LIGHT * states.clock_rate) * frequency / SPEED_OF_LIGHT * (
            1.0 if doppler else np.nan
        ),
        strength,
    )  # fmt: skip
    return Drive(
        observed, broadcast, time, position, velocity, clock, drift, satellite, ranges, rates,
        np.concatenate((there, moves), axis=-1), strength,
    )  # fmt: skip


def write_observed(path, systems, time, letters, prn, ranges, doppler, strength):
    """A RINEX 3 observation file."""
    text = header_line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    text += header_line("".join(f"{0.0:14.4f}" for _ in range(3)), "APPROX POSITION XYZ")
    code = {"G": "1C", "E": "1X", "C": "2I"}
    for system in systems:
        kinds = " ".join(kind + code[system] for kind in "CLDS")
        text += header_line(f"{system}    4 {kinds}", "SYS / # / OBS TYPES")
    text += header_line("", "END OF HEADER")
    for t in range(time.size):
        seen = np.flatnonzero(np.isfinite(ranges[t]))
        text += f"> {instant(time[t], ' ')}  0{len(seen):3d}\n"
        for s in seen:
            shift = " " * 14 if np.isnan(doppler[t, s]) else f"{doppler[t, s]:14.3f}"
            text += (
                f"{letters[s]}{prn[s]:02d}{ranges[t, s]:14.3f}  {'':14s}  {shift}  "
                f"{strength[t, s]:14.3f}\n"
            )
    path.write_text(text)
    return path


def write_truth(path, drive, style):
    """Where the car was: CSV with t or with week and seconds, or RTKLIB's .pos."""
    latitude, longitude, height = pymap3d.ecef2geodetic(*drive.position.T)
    rows = list(zip(drive.time, latitude, longitude, height, strict=True))
    if style == "pos":
        text = "% program   : RTKLIB\n"
        text += "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns\n"
        for t, *place in rows:
            date = calendar(t)
            day, clock = date[:10].replace(" ", "/"), date[11:].replace(" ", ":")
            text += f"{day} {clock}.000 " + " ".join(f"{x:.10f}" for x in place) + " 1 9\n"
    elif style == "week":
        text = "week,seconds,lat,lon,height\n" + "".join(
            f"{int(t // WEEK)},{t % WEEK},{a:.10f},{o:.10f},{h:.4f}\n" for t, a, o, h in rows
        )
    else:
        text = "t,lat,lon,height\n" + "".join(
            f"{t - START},{a:.10f},{o:.10f},{h:.4f}\n" for t, a, o, h in rows
        )
    path.write_text(text)
    return path
