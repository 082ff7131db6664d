"""Noise of a phased-array radar from the radar equation (SPEC 4.2).

Gain, cross section, wavelength and losses are those of the published Table 4. The pulse
energy over the noise density is set so that the equation gives the published level, a
single-pulse S/N of 50.7 dB at 10 km on broadside; the jammer enters by its level there,
46.8 dB over the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SPEED_OF_LIGHT = 299_792_458.0  # m/s
EFFECTIVE_EARTH_RADIUS = 4.0 / 3.0 * 6_371_000.0  # m
REFERENCE_RANGE = 10_000.0  # m
# ITU-R P.838-3 at 3.3 GHz, horizontal polarisation: gamma = k rate^a dB/km
RAIN_COEFFICIENT, RAIN_EXPONENT = 1.25071e-4, 1.33862
RANGE_SLOPE = 25.0  # the fixed range error is the range resolution over this
ANGLE_SLOPE = 40.0  # the fixed angle error is the beam width over this
MONOPULSE_SLOPE = 1.57  # k_M


@dataclass(frozen=True)
class PhasedArray:
    """A phased-array radar whose broadside looks along `boresight`.

    Attributes:
        boresight_azimuth, boresight_elevation: rad.
        beam_width: rad, the same in both angles.
        bandwidth: Hz; the aperture-fill limit at the largest scan angle.
        max_scan: rad; beyond it nothing is detected.
        gain: of the antenna, one way, linear.
        cross_section: of the target, m^2.
        wavelength: m.
        losses_db: transmit and receive microwave, signal processing and beam shape.
        energy_over_noise_db: pulse energy over the noise's spectral density.
        jnr_db: jammer to noise at 10 km of the published self-screening jammer.
        integration_gain_db: n_p / L_i.
    """

    boresight_azimuth: float = 0.0
    boresight_elevation: float = radians(20.0)
    beam_width: float = radians(2.0)
    bandwidth: float = 150.1e6
    max_scan: float = radians(60.0)
    gain: float = 10.0**3.95
    cross_section: float = 10.0**0.01
    wavelength: float = 0.09085
    losses_db: tuple[float, ...] = (1.5, 1.5, 1.0, 3.2)
    energy_over_noise_db: float = 192.61
    jnr_db: float = 46.8
    integration_gain_db: float = 9.0

    def signal_to_noise(self, distance: Array, azimuth: Array, elevation: Array) -> Array:
        """Single-pulse S/N, linear: R^-4 and scan loss (S0 eq 46, losses summed in dB)."""
        losses = 10.0 ** (sum(self.losses_db) / 10.0)
        energy = 10.0 ** (self.energy_over_noise_db / 10.0)
        echo = energy * self.gain**2 * self.wavelength**2 * self.cross_section
        level = echo / ((4.0 * pi) ** 3 * distance**4 * losses)
        height = distance * np.sin(elevation)
        return level / self.scan_loss(distance, azimuth, height)

    def scan_loss(self, distance: Array, azimuth: Array, height: Array) -> Array:
        """Linear loss [cos(phi_r - Phi) cos(theta_r - theta)]^-2.5 with Phi above a round earth."""
        radius = EFFECTIVE_EARTH_RADIUS
        sine = ((radius + height) ** 2 - radius**2 - distance**2) / (2.0 * radius * distance)
        elevation = np.arcsin(np.clip(sine, -1.0, 1.0))
        cosines = np.cos(self.boresight_elevation - elevation) * np.cos(
            self.boresight_azimuth - azimuth
        )
        return np.maximum(cosines, 1e-3) ** -2.5

    def jammer_to_noise(self, distance: Array) -> Array:
        """J/N, linear, of the self-screening jammer: one way, R^-2."""
        return 10.0 ** (self.jnr_db / 10.0) * (REFERENCE_RANGE / distance) ** 2

    def integrated(self, snr: Array, as_printed: bool = False) -> Array:
        """S/N after coherent integration; `as_printed` gives the square-law form (SPEC 4.2)."""
        gain = 10.0 ** (self.integration_gain_db / 10.0)
        return gain * snr * snr / (1.0 + snr) if as_printed else gain * snr

    def detects(self, azimuth: Array, elevation: Array) -> NDArray[np.bool_]:
        """Whether both off-broadside angles are within the scan limit."""
        return (np.abs(azimuth - self.boresight_azimuth) <= self.max_scan) & (
            np.abs(elevation - self.boresight_elevation) <= self.max_scan
        )

    def noise(self, integrated_snr: Array, azimuth: Array, elevation: Array) -> Array:
        """Standard deviations of range, azimuth and elevation (..., 3), m and rad (S0 eq 45)."""
        thermal = 1.0 / np.sqrt(2.0 * integrated_snr)
        resolution = SPEED_OF_LIGHT / (2.0 * self.bandwidth)
        distance = np.hypot(resolution * thermal, resolution / RANGE_SLOPE)
        angle = self.beam_width * np.hypot(thermal / MONOPULSE_SLOPE, 1.0 / ANGLE_SLOPE)
        return np.stack(
            (
                distance,
                angle / np.cos(azimuth - self.boresight_azimuth),
                angle / np.cos(elevation - self.boresight_elevation),
            ),
            axis=-1,
        )


def rain_transmission(distance: ArrayLike, rate: float) -> Array:
    """Two-way power transmission through rain of `rate` mm/h (ITU-R P.838-3)."""
    two_way_db = 2.0 * RAIN_COEFFICIENT * rate**RAIN_EXPONENT * np.asarray(distance) / 1000.0
    return 10.0 ** (-two_way_db / 10.0)


def aperture_fill_bandwidth(beam_width: float, wavelength: float, scan: float) -> float:
    """Bandwidth limit of an array scanned by `scan` rad, Hz (SPEC 4.2)."""
    return beam_width * SPEED_OF_LIGHT / (0.886 * wavelength * sin(scan))
