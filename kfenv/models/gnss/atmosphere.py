"""Delays of satellite signals in the troposphere and the ionosphere (SPEC 4.3), in metres.

Angles in radians. All functions broadcast over arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.models.gnss.orbits import SPEED_OF_LIGHT

Array = NDArray[np.float64]

# Zenith delays: S0's dry delay with height as altitude (its printed sign grows upwards).
DRY_AT_SEA_LEVEL, DRY_DECAY = 2.3, 0.116e-3  # m, 1/m
WET_DELAY = 0.1  # m; the papers give none
WET_DENSITY = 1e-4 / 3600.0  # m^2/s: the wet delay walks by 1 cm in an hour

# Niell 1996: columns for latitudes of 15, 30, 45, 60 and 75 deg, rows a, b, c.
NIELL_LATITUDES = np.radians((15.0, 30.0, 45.0, 60.0, 75.0))
NIELL_DRY = np.array(
    [
        [1.2769934e-3, 1.2683230e-3, 1.2465397e-3, 1.2196049e-3, 1.2045996e-3],
        [2.9153695e-3, 2.9152299e-3, 2.9288445e-3, 2.9022565e-3, 2.9024912e-3],
        [62.610505e-3, 62.837393e-3, 63.721774e-3, 63.824265e-3, 64.258455e-3],
    ]
)
NIELL_DRY_AMPLITUDE = np.array(
    [
        [0.0, 1.2709626e-5, 2.6523662e-5, 3.4000452e-5, 4.1202191e-5],
        [0.0, 2.1414979e-5, 3.0160779e-5, 7.2562722e-5, 11.723375e-5],
        [0.0, 9.0128400e-5, 4.3497037e-5, 84.795348e-5, 170.37206e-5],
    ]
)
NIELL_WET = np.array(
    [
        [5.8021897e-4, 5.6794847e-4, 5.8118019e-4, 5.9727542e-4, 6.1641693e-4],
        [1.4275268e-3, 1.5138625e-3, 1.4572752e-3, 1.5007428e-3, 1.7599082e-3],
        [4.3472961e-2, 4.6729510e-2, 4.3908931e-2, 4.4626982e-2, 5.4736038e-2],
    ]
)
NIELL_HEIGHT = 2.53e-5, 5.49e-3, 1.14e-3
NIELL_DAY, YEAR = 28.0, 365.25

FLATTEST_KLOBUCHAR = 1.57  # rad: beyond this phase it is night


def dry_zenith_delay(height: ArrayLike) -> Array:
    """2.3 m exp(-h / 8.6 km) (S0, with h the altitude; SPEC 4.3)."""
    return DRY_AT_SEA_LEVEL * np.exp(-DRY_DECAY * np.asarray(height))


def niell(
    elevation: ArrayLike, latitude: ArrayLike, height: ArrayLike, day: float
) -> tuple[Array, Array]:
    """Mapping functions: dry and wet slant delay over the zenith delay (Niell 1996).

    Args:
        elevation: rad, above about 3 deg.
        latitude: rad; south of the equator the seasons are half a year later.
        height: above sea level, m.
        day: of the year, 1 on the first of January.
    """
    sine, latitude = np.sin(elevation), np.asarray(latitude)
    day = day + np.where(latitude < 0.0, 0.5 * YEAR, 0.0)
    season = np.cos(2.0 * np.pi * (day - NIELL_DAY) / YEAR)

    def at_latitude(rows: Array) -> list[Array]:
        return [np.interp(np.abs(latitude), NIELL_LATITUDES, row) for row in rows]

    average, amplitude = at_latitude(NIELL_DRY), at_latitude(NIELL_DRY_AMPLITUDE)
    dry = _fraction(sine, *(a - b * season for a, b in zip(average, amplitude, strict=True)))
    rise = 1.0 / sine - _fraction(sine, *NIELL_HEIGHT)
    return dry + rise * np.asarray(height) / 1000.0, _fraction(sine, *at_latitude(NIELL_WET))


def _fraction(sine: Array, a: Array, b: Array, c: Array) -> Array:
    """Marini's continued fraction, 1 at the zenith."""
    zenith = 1.0 + a / (1.0 + b / (1.0 + c))
    return zenith / (sine + a / (sine + b / (sine + c)))


def troposphere(
    elevation: ArrayLike,
    latitude: ArrayLike,
    height: ArrayLike,
    day: float,
    wet_delay: ArrayLike = WET_DELAY,
) -> Array:
    """The whole slant delay, dry and wet, m (S0 eq 53 mapped by Niell).

    With the standard atmosphere's wet delay it is what a receiver subtracts.

    Args:
        elevation, latitude, height, day: as of `niell`.
        wet_delay: of the wet part in the zenith, m.
    """
    dry, wet = niell(elevation, latitude, height, day)
    return dry * dry_zenith_delay(height) + wet * np.asarray(wet_delay)


def klobuchar(
    alpha: ArrayLike,
    beta: ArrayLike,
    latitude: ArrayLike,
    longitude: ArrayLike,
    elevation: ArrayLike,
    azimuth: ArrayLike,
    time: ArrayLike,
) -> Array:
    """Delay of an L1 pseudorange by the broadcast ionosphere model, m (IS-GPS-200, 20.3.3.5.2.5).

    Args:
        alpha, beta: the four broadcast coefficients each, in seconds per semicircle^n.
        latitude, longitude: of the receiver, rad.
        elevation, azimuth: of the satellite, rad.
        time: GPS time, s.
    """
    # The model works in semicircles.
    elevation, azimuth = np.asarray(elevation) / np.pi, np.asarray(azimuth)
    central = 0.0137 / (elevation + 0.11) - 0.022
    pierced = np.clip(np.asarray(latitude) / np.pi + central * np.cos(azimuth), -0.416, 0.416)
    meridian = np.asarray(longitude) / np.pi + central * np.sin(azimuth) / np.cos(np.pi * pierced)
    magnetic = pierced + 0.064 * np.cos(np.pi * (meridian - 1.617))
    local = (43_200.0 * meridian + time) % 86_400.0
    amplitude = np.maximum(np.polynomial.polynomial.polyval(magnetic, alpha), 0.0)
    period = np.maximum(np.polynomial.polynomial.polyval(magnetic, beta), 72_000.0)
    phase = 2.0 * np.pi * (local - 50_400.0) / period  # the peak is at 14 h local time
    day = amplitude * (1.0 - phase**2 / 2.0 + phase**4 / 24.0)
    slant = 1.0 + 16.0 * (0.53 - elevation) ** 3
    return SPEED_OF_LIGHT * slant * (5e-9 + np.where(np.abs(phase) < FLATTEST_KLOBUCHAR, day, 0.0))
