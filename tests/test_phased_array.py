"""The phased array reproduces SPEC 4.2's figures, and acceptance number 8, from its formulas."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from kfenv.models import phased_array
from kfenv.models.phased_array import PhasedArray, aperture_fill_bandwidth, rain_transmission
from kfenv.scenarios.radar.scenario import SelfScreeningJammer
from kfenv.scenarios.radar.tracking import RadarTracking

RADAR = PhasedArray()
BROADSIDE = RADAR.boresight_azimuth, RADAR.boresight_elevation
WAVELENGTH = 0.09085  # m
JAMMER = SelfScreeningJammer()
CONSTANTS = Path(__file__).parents[2] / "shared" / "data" / "constants.json"


def db(value):
    return 10.0 * np.log10(value)


def jammer_to_noise(distance, radar=RADAR, power=JAMMER.power, bandwidth=JAMMER.bandwidth):
    return radar.jammer_to_noise(distance, power, bandwidth)


def level(distance, as_printed=None, jammed=False):
    """On broadside: S/N or S/(J+N) in dB of one pulse, or integrated."""
    snr = RADAR.signal_to_noise(distance, *BROADSIDE)
    if jammed:
        snr = snr / (1.0 + jammer_to_noise(distance))
    return db(snr if as_printed is None else RADAR.integrated(snr, as_printed=as_printed))


def test_levels_at_ten_kilometres():
    assert level(10e3) == pytest.approx(50.7, abs=0.05)
    assert level(10e3, as_printed=False) == pytest.approx(59.7, abs=0.05)
    assert level(10e3, jammed=True) == pytest.approx(3.9, abs=0.05)
    assert db(jammer_to_noise(10e3)) == pytest.approx(46.8, abs=0.05)


def test_the_level_is_that_of_table_4_multiplied_out():
    """In decibels, by hand: P tau / k T + 2 G + sigma + 2 lambda - 3 (4 pi) - 4 R - L."""
    energy_over_noise = 33.979 - 43.010 + 228.599 - 26.990
    assert energy_over_noise == pytest.approx(192.58, abs=0.01)
    expected = energy_over_noise + 79.0 + 0.1 - 20.833 - 32.976 - 160.0 - 7.2
    assert level(10e3) == pytest.approx(expected, abs=0.01)
    # ERP / B + G + 2 lambda - 2 (4 pi) - 2 R - L - k T
    jammer = 11.761 - 81.761 + 39.5 - 20.833 - 21.984 - 80.0 - 1.5 + 228.599 - 26.990
    assert db(jammer_to_noise(10e3)) == pytest.approx(jammer, abs=0.01)


def test_losses_add_in_decibels():
    names = ("transmit_loss_db", "receive_loss_db", "processing_loss_db", "beam_shape_loss_db")
    lossless = PhasedArray(**dict.fromkeys(names, 0.0))
    loss = db(lossless.signal_to_noise(10e3, *BROADSIDE)) - level(10e3)
    assert loss == pytest.approx(7.2, abs=1e-9)
    # the printed equation divides by the sum in dB: 1.4 dB too much (SPEC 4.2)
    assert db(7.2) - loss == pytest.approx(1.4, abs=0.05)


ECHO = {  # what the level gains by a change
    "peak_power": (2.0, 3.01), "pulse_length": (2.0, 3.01), "system_temperature": (2.0, -3.01),
    "frequency": (0.5, 6.02),
}  # fmt: skip
IN_DB = {
    "transmit_gain_db": 1.0, "receive_gain_db": 1.0, "cross_section_db": 1.0,
    "transmit_loss_db": -1.0, "receive_loss_db": -1.0, "processing_loss_db": -1.0,
    "beam_shape_loss_db": -1.0, "atmospheric_loss_db": -1.0, "lens_loss_db": -1.0,
}  # fmt: skip


def changed_by(name, value):
    """What one parameter does to the echo and to the jammer, dB."""
    radar = PhasedArray(**{name: value})
    echo = db(radar.signal_to_noise(10e3, *BROADSIDE)) - level(10e3)
    return echo, db(jammer_to_noise(10e3, radar) / jammer_to_noise(10e3))


def test_the_echo_follows_the_radar_equation():
    for name, (times, gained) in ECHO.items():
        echo, _ = changed_by(name, times * getattr(RADAR, name))
        assert echo == pytest.approx(gained, abs=0.01), name
    for name, gained in IN_DB.items():
        echo, _ = changed_by(name, getattr(RADAR, name) + 1.0)
        assert echo == pytest.approx(gained, abs=1e-9), name


def test_the_jammer_meets_the_receiver_alone_and_one_way():
    for name, expected in {
        "peak_power": 0.0, "pulse_length": 0.0, "transmit_gain_db": 0.0, "transmit_loss_db": 0.0,
        "cross_section_db": 0.0, "processing_loss_db": 0.0, "beam_shape_loss_db": 0.0,
        "receive_gain_db": 1.0, "receive_loss_db": -1.0, "atmospheric_loss_db": -0.5,
        "lens_loss_db": -0.5,
    }.items():  # fmt: skip
        _, jammer = changed_by(name, getattr(RADAR, name) + 1.0)
        assert jammer == pytest.approx(expected, abs=1e-9), name
    for power, bandwidth, gained in ((2.0, 1.0, 3.01), (1.0, 2.0, -3.01)):
        other = jammer_to_noise(
            10e3, power=power * JAMMER.power, bandwidth=bandwidth * JAMMER.bandwidth
        )
        assert db(other / jammer_to_noise(10e3)) == pytest.approx(gained, abs=0.01)


def test_integration_of_pulses():
    for more, gained in (({"pulses": 20}, 3.01), ({"integration_loss_db": 3.0}, -2.0)):
        gain = db(PhasedArray(**more).integrated(1.0) / RADAR.integrated(1.0))
        assert gain == pytest.approx(gained, abs=0.01)
    assert db(RADAR.integrated(1.0)) == pytest.approx(9.0, abs=1e-9)


@dataclass(frozen=True)
class Duller(RadarTracking):
    """The scenario with another array."""

    radar: ClassVar[PhasedArray] = PhasedArray(receive_gain_db=29.5, system_temperature=5_000.0)


def levels(scenario, *faults):
    """S/N (T,) of an episode, true and told."""
    rng = np.random.default_rng(0)
    draft = scenario.draft(scenario.trajectory(rng), rng)
    for fault in faults:
        fault.apply(draft, rng)
    return draft, draft.snr, draft.told_snr


@pytest.mark.parametrize("kind", [RadarTracking, Duller])
def test_the_jammer_meets_the_array_of_the_scenario(kind):
    jammer = SelfScreeningJammer(start=0.0, duration=20.0)
    scenario = kind(duration=10.0)
    (_, clear, _), (draft, jammed, told) = levels(scenario), levels(scenario, jammer)
    rise = 1.0 + jammer_to_noise(draft.exact[:, 0], scenario.radar)
    np.testing.assert_allclose(jammed, clear / rise, rtol=1e-12)
    np.testing.assert_array_equal(told, jammed)


def test_without_power_the_jammer_restores_the_echo():
    scenario = RadarTracking(duration=10.0)
    silent = SelfScreeningJammer(start=0.0, duration=20.0, power=0.0)
    for one, other in zip(levels(scenario)[1:], levels(scenario, silent)[1:], strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("times", [0.5, 1.4, 2.0])
def test_the_echo_falls_with_the_fourth_power_the_jammer_with_the_second(times):
    broadside = {"azimuth": 0.0, "elevation": 0.0}
    flat = PhasedArray(boresight_elevation=0.0)
    loss = db(
        flat.signal_to_noise(10e3, **broadside) / flat.signal_to_noise(times * 10e3, **broadside)
    )
    assert loss == pytest.approx(40.0 * np.log10(times), abs=1e-3)
    loss = db(jammer_to_noise(10e3) / jammer_to_noise(times * 10e3))
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
    expected = np.array([resolution, *np.radians([2.0, 2.0]) / 1.6]) / np.sqrt(14.0)
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


def test_each_angle_has_its_own_beam_and_limit():
    radar = PhasedArray(beam_width=tuple(np.radians((2.0, 6.0))), max_scan=(0.5, 0.1))
    _, azimuth, elevation = radar.noise(7.0, *BROADSIDE)
    assert elevation == pytest.approx(3.0 * azimuth)
    azimuth, elevation = BROADSIDE
    assert radar.detects(azimuth + 0.4, elevation) and not radar.detects(azimuth, elevation + 0.4)
    assert radar.within_scan(azimuth + 0.7, elevation - 0.7) == (azimuth + 0.5, elevation - 0.1)


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
