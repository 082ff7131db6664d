"""The phased array reproduces SPEC 4.2's figures, and acceptance number 8, from its formulas."""

import json
from pathlib import Path

import numpy as np
import pytest

from kfenv.models import phased_array
from kfenv.models.phased_array import PhasedArray, aperture_fill_bandwidth, rain_transmission

RADAR = PhasedArray()
BROADSIDE = RADAR.boresight_azimuth, RADAR.boresight_elevation
WAVELENGTH = 0.09085  # m
CONSTANTS = Path(__file__).parents[2] / "shared" / "data" / "constants.json"


def db(value):
    return 10.0 * np.log10(value)


def level(distance, as_printed=None, jammed=False):
    """On broadside: S/N or S/(J+N) in dB of one pulse, or integrated."""
    snr = RADAR.signal_to_noise(distance, *BROADSIDE)
    if jammed:
        snr = snr / (1.0 + RADAR.jammer_to_noise(distance))
    return db(snr if as_printed is None else RADAR.integrated(snr, as_printed=as_printed))


def test_levels_at_ten_kilometres():
    assert level(10e3) == pytest.approx(50.7, abs=0.01)
    assert level(10e3, as_printed=False) == pytest.approx(59.7, abs=0.01)
    assert level(10e3, jammed=True) == pytest.approx(3.9, abs=0.05)


def test_losses_add_in_decibels():
    lossless = PhasedArray(losses_db=())
    loss = db(lossless.signal_to_noise(10e3, *BROADSIDE)) - level(10e3)
    assert loss == pytest.approx(7.2, abs=1e-9)
    # the printed equation divides by the sum in dB: 1.4 dB too much (SPEC 4.2)
    assert db(7.2) - loss == pytest.approx(1.4, abs=0.05)


def test_the_echo_follows_the_radar_equation():
    for change, gained in (
        ({"gain": 2.0 * RADAR.gain}, 6.02),
        ({"wavelength": 2.0 * RADAR.wavelength}, 6.02),
        ({"cross_section": 2.0 * RADAR.cross_section}, 3.01),
    ):
        changed = PhasedArray(**change)
        assert db(changed.signal_to_noise(10e3, *BROADSIDE)) - level(10e3) == pytest.approx(
            gained, abs=0.01
        )


@pytest.mark.parametrize("times", [0.5, 1.4, 2.0])
def test_the_echo_falls_with_the_fourth_power_the_jammer_with_the_second(times):
    broadside = {"azimuth": 0.0, "elevation": 0.0}
    flat = PhasedArray(boresight_elevation=0.0)
    loss = db(
        flat.signal_to_noise(10e3, **broadside) / flat.signal_to_noise(times * 10e3, **broadside)
    )
    assert loss == pytest.approx(40.0 * np.log10(times), abs=1e-3)
    loss = db(RADAR.jammer_to_noise(10e3) / RADAR.jammer_to_noise(times * 10e3))
    assert loss == pytest.approx(20.0 * np.log10(times), abs=1e-9)


def test_integration_jammed_at_fourteen_kilometres():
    assert level(14e3, as_printed=False, jammed=True) == pytest.approx(10.0, abs=0.05)
    assert level(14e3, as_printed=True, jammed=True) == pytest.approx(7.4, abs=0.05)


def test_both_integrations_agree_above_twenty_decibels():
    strong, weak = 100.0, 1.0
    for snr, agree in ((strong, True), (weak, False)):
        gap = db(RADAR.integrated(snr)) - db(RADAR.integrated(snr, as_printed=True))
        assert (gap < 0.05) == agree


def test_bandwidth_is_the_aperture_fill_limit_at_the_largest_scan():
    limit = aperture_fill_bandwidth(np.radians(2.0), WAVELENGTH, np.radians(60.0))
    assert limit == pytest.approx(150.1e6, rel=5e-4) and RADAR.bandwidth == 150.1e6
    assert aperture_fill_bandwidth(np.radians(2.0), WAVELENGTH, np.radians(1.0)) == pytest.approx(
        7.4e9, rel=0.01
    )


def noise_of(integrated_db):
    distance, *angles = RADAR.noise(10.0 ** (integrated_db / 10.0), *BROADSIDE)
    return distance, *np.degrees(angles)


def test_noise_clear_and_jammed():
    clear = noise_of(level(10e3, as_printed=False))
    assert clear == (pytest.approx(0.04, abs=5e-4), *[pytest.approx(0.050, abs=5e-4)] * 2)
    jammed = noise_of(level(10e3, as_printed=False, jammed=True))
    assert jammed == (pytest.approx(0.17, abs=6e-3), *[pytest.approx(0.21, abs=5e-3)] * 2)


def test_noise_formula_term_by_term():
    """S0 eq 45: thermal and fixed parts, which the cosine of the angle off broadside divides."""
    resolution = 299_792_458.0 / (2.0 * RADAR.bandwidth)
    assert resolution == pytest.approx(0.9985, abs=5e-4)
    fixed = RADAR.noise(1e30, *BROADSIDE)
    np.testing.assert_allclose(fixed, [resolution / 25.0, *np.radians([2.0, 2.0]) / 40.0])
    thermal = np.sqrt(RADAR.noise(7.0, *BROADSIDE) ** 2 - fixed**2)
    expected = np.array([resolution, *np.radians([2.0, 2.0]) / 1.57]) / np.sqrt(14.0)
    np.testing.assert_allclose(thermal, expected)
    off = RADAR.noise(7.0, np.radians(60.0), RADAR.boresight_elevation - np.radians(45.0))
    grown = off / RADAR.noise(7.0, *BROADSIDE)
    np.testing.assert_allclose(grown, [1.0, 2.0, np.sqrt(2.0)])


@pytest.mark.parametrize(("scan", "loss"), [(0.0, 0.0), (20.0, 0.68), (60.0, 7.5)])
def test_scan_loss(scan, loss):
    near = 100.0  # m, where the earth is flat
    height = near * np.sin(RADAR.boresight_elevation)
    assert db(RADAR.scan_loss(near, np.radians(scan), height)) == pytest.approx(loss, abs=0.03)
    elevation = RADAR.boresight_elevation - np.radians(scan)
    assert db(RADAR.scan_loss(near, 0.0, near * np.sin(elevation))) == pytest.approx(loss, abs=0.03)
    drop = db(RADAR.signal_to_noise(near, *BROADSIDE)) - db(
        RADAR.signal_to_noise(near, np.radians(scan), RADAR.boresight_elevation)
    )
    assert drop == pytest.approx(loss, abs=0.03)


def test_the_earth_is_round():
    """Phi = arcsin(((Re+z)^2 - Re^2 - R^2) / (2 R Re)): a far target sits lower than it looks."""
    radius, distance, height = 4.0 / 3.0 * 6_371_000.0, 100e3, 3e3
    sine = ((radius + height) ** 2 - radius**2 - distance**2) / (2.0 * radius * distance)
    cosine = np.cos(RADAR.boresight_elevation - np.arcsin(sine))
    assert RADAR.scan_loss(distance, 0.0, height) == pytest.approx(cosine**-2.5, rel=1e-12)
    assert np.arcsin(sine) < np.arcsin(height / distance) - 0.005


def test_rain_hardly_matters():
    assert -db(rain_transmission(10e3, 50.0)) == pytest.approx(0.5, abs=0.05)
    assert rain_transmission(10e3, 0.0) == 1.0
    one, two = (-db(rain_transmission(d, 30.0)) for d in (7e3, 14e3))
    assert two == pytest.approx(2.0 * one)
    assert -db(rain_transmission(7e3, 60.0)) == pytest.approx(2.0**1.33862 * one)


def test_nothing_is_detected_beyond_sixty_degrees():
    for angle, seen in ((59.9, True), (60.1, False), (-59.9, True), (-60.1, False)):
        off = np.radians(angle)
        assert RADAR.detects(off, RADAR.boresight_elevation) == seen
        assert RADAR.detects(0.0, RADAR.boresight_elevation + off) == seen


@pytest.mark.skipif(not CONSTANTS.exists(), reason="the shared constants are not here")
def test_rain_coefficients_are_those_of_p_838_3():
    frequency = 3.3  # GHz
    assert frequency == pytest.approx(299_792_458.0 / WAVELENGTH / 1e9, abs=0.01)
    curves = json.loads(CONSTANTS.read_text())["p838"]
    log_k = curve(curves["kH"], frequency)
    alpha = curve(curves["aH"], frequency)
    assert 10.0**log_k == pytest.approx(phased_array.RAIN_COEFFICIENT, rel=1e-4)
    assert alpha == pytest.approx(phased_array.RAIN_EXPONENT, rel=1e-4)


def curve(coefficients, frequency):
    """P.838-3 eq 2, 3: sum of a exp(-((log f - b) / c)^2), plus m log f + k."""
    x = np.log10(frequency)
    total = coefficients["m"] * x + coefficients["k"]
    for a, b, c in zip(*(coefficients[name] for name in "abc"), strict=True):
        total += a * np.exp(-(((x - b) / c) ** 2))
    return total
