"""Noise of a phased-array radar from the radar equation (SPEC 4.2; S0 eq 45 to 48, Table 4)."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SPEED_OF_LIGHT = 299_792_458.0  # m/s
BOLTZMANN = 1.380649e-23  # J/K
EFFECTIVE_EARTH_RADIUS = 4.0 / 3.0 * 6_371_000.0  # m
# ITU-R P.838-3 at 3.3 GHz, horizontal polarisation: gamma = k rate^a dB/km
RAIN_COEFFICIENT, RAIN_EXPONENT = 1.25071e-4, 1.33862
RANGE_SLOPE = 25.0  # the fixed range error is the range resolution over this
ANGLE_SLOPE = 40.0  # the fixed angle error is the beam width over this


@dataclass(frozen=True)
class PhasedArray:
    """A phased-array radar whose broadside looks along the boresight; defaults of Table 4.

    Table 4 gives neither the bandwidth, which is the aperture-fill limit at the largest
    scan angle, nor the losses of the atmosphere and of its lens effect.

    Attributes:
        boresight_azimuth, boresight_elevation: rad.
        beam_width: of azimuth and elevation, rad.
        max_scan: in azimuth and elevation, rad; beyond it nothing is detected.
        bandwidth: Hz.
        monopulse_slope: k_M.
        peak_power: W.
        pulse_length: s.
        frequency: Hz.
        system_temperature: K.
        transmit_gain_db, receive_gain_db: of the antenna.
        cross_section_db: of the target, dB over 1 m^2.
        transmit_loss_db, receive_loss_db: of the microwave paths.
        processing_loss_db, beam_shape_loss_db: of the echo.
        atmospheric_loss_db, lens_loss_db: of the way there and back.
        pulses: that are integrated.
        integration_loss_db: of that.
    """

    boresight_azimuth: float = 0.0
    boresight_elevation: float = radians(20.0)
    beam_width: tuple[float, float] = (radians(2.0), radians(2.0))
    max_scan: tuple[float, float] = (radians(60.0), radians(60.0))
    bandwidth: float = 150.1e6
    monopulse_slope: float = 1.6
    peak_power: float = 2_500.0
    pulse_length: float = 50e-6
    frequency: float = 3.3e9
    system_temperature: float = 500.0
    transmit_gain_db: float = 39.5
    receive_gain_db: float = 39.5
    cross_section_db: float = 0.1
    transmit_loss_db: float = 1.5
    receive_loss_db: float = 1.5
    processing_loss_db: float = 1.0
    beam_shape_loss_db: float = 3.2
    atmospheric_loss_db: float = 0.0
    lens_loss_db: float = 0.0
    pulses: int = 10
    integration_loss_db: float = 1.0

    @property
    def wavelength(self) -> float:
        """m."""
        return SPEED_OF_LIGHT / self.frequency

    @property
    def noise_density(self) -> float:
        """W/Hz."""
        return BOLTZMANN * self.system_temperature

    @property
    def propagation_loss_db(self) -> float:
        """There and back, but for rain."""
        return self.atmospheric_loss_db + self.lens_loss_db

    def signal_to_noise(self, distance: Array, azimuth: Array, elevation: Array) -> Array:
        """Single-pulse S/N, linear: R^-4 and scan loss (S0 eq 46, losses summed in dB)."""
        losses_db = (
            self.transmit_loss_db + self.receive_loss_db + self.processing_loss_db
            + self.beam_shape_loss_db + self.propagation_loss_db
        )  # fmt: skip
        gains_db = self.transmit_gain_db + self.receive_gain_db + self.cross_section_db
        energy = self.peak_power * self.pulse_length
        echo = energy * _linear(gains_db - losses_db) * self.wavelength**2
        level = echo / ((4.0 * pi) ** 3 * distance**4 * self.noise_density)
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

    def jammer_to_noise(self, distance: Array, power: float, bandwidth: float) -> Array:
        """J/N, linear, of a self-screening jammer in the main lobe: one way, R^-2.

        Args:
            distance: m.
            power: radiated effectively (ERP), W.
            bandwidth: over which it is spread, Hz.
        """
        gain = _linear(self.receive_gain_db - self.receive_loss_db - self.propagation_loss_db / 2.0)
        density = power / bandwidth * gain * (self.wavelength / (4.0 * pi * distance)) ** 2
        return density / self.noise_density

    def integrated(self, snr: Array, as_printed: bool = False) -> Array:
        """S/N after coherent integration; `as_printed` gives the square-law form (SPEC 4.2)."""
        gain = self.pulses / _linear(self.integration_loss_db)
        return gain * snr * snr / (1.0 + snr) if as_printed else gain * snr

    def detects(self, azimuth: Array, elevation: Array) -> NDArray[np.bool_]:
        """Whether both off-broadside angles are within the scan limits."""
        return (np.abs(azimuth - self.boresight_azimuth) <= self.max_scan[0]) & (
            np.abs(elevation - self.boresight_elevation) <= self.max_scan[1]
        )

    def within_scan(self, azimuth: Array, elevation: Array) -> tuple[Array, Array]:
        """The nearest angles at which something is detected."""
        boresight = self.boresight_azimuth, self.boresight_elevation
        return tuple(
            np.clip(angle, centre - limit, centre + limit)
            for angle, centre, limit in zip(
                (azimuth, elevation), boresight, self.max_scan, strict=True
            )
        )

    def noise(self, integrated_snr: Array, azimuth: Array, elevation: Array) -> Array:
        """Standard deviations of range, azimuth and elevation (..., 3), m and rad (S0 eq 45)."""
        thermal = 1.0 / np.sqrt(2.0 * integrated_snr)
        resolution = SPEED_OF_LIGHT / (2.0 * self.bandwidth)
        distance = np.hypot(resolution * thermal, resolution / RANGE_SLOPE)
        share = np.hypot(thermal / self.monopulse_slope, 1.0 / ANGLE_SLOPE)  # of the beam width
        return np.stack(
            (
                distance,
                self.beam_width[0] * share / np.cos(azimuth - self.boresight_azimuth),
                self.beam_width[1] * share / np.cos(elevation - self.boresight_elevation),
            ),
            axis=-1,
        )


def _linear(decibels: float) -> float:
    return 10.0 ** (decibels / 10.0)


def rain_transmission(distance: ArrayLike, rate: ArrayLike) -> Array:
    """Two-way power transmission through rain of `rate` mm/h (ITU-R P.838-3); both broadcast."""
    rates, shape = np.ravel(rate).tolist(), np.shape(rate)
    powers = np.reshape([rate**RAIN_EXPONENT for rate in rates], shape)  # the same bits as alone
    two_way_db = 2.0 * RAIN_COEFFICIENT * powers * np.asarray(distance) / 1000.0
    return 10.0 ** (-two_way_db / 10.0)


def aperture_fill_bandwidth(beam_width: float, wavelength: float, scan: float) -> float:
    """Bandwidth limit of an array scanned by `scan` rad, Hz (SPEC 4.2)."""
    return beam_width * SPEED_OF_LIGHT / (0.886 * wavelength * sin(scan))
