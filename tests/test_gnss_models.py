"""Orbits, delays, clock and pseudoranges against independent computations and published values."""

import json
from datetime import datetime
from math import atan2, cos, degrees, pi, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.gnss.almanac import baseline_constellation, read_yuma
from kfenv.models.gnss.atmosphere import dry_zenith_delay, klobuchar, niell, troposphere
from kfenv.models.gnss.clock import with_clock
from kfenv.models.gnss.orbits import (
    EARTH_RATE,
    GRAVITY,
    SPEED_OF_LIGHT,
    eccentric_anomaly,
    geodetic,
    gps_seconds,
    look_angles,
)
from kfenv.models.gnss.pseudorange import as_printed, printed_jacobian, pseudoranges
from kfenv.models.gnss.receiver import multipath_deviation, range_deviation
from kfenv.models.namespaces import batch, dual
from kfenv.models.process_noise import van_loan, white_jerk
from kfenv.models.variable_turn import variable_turn

DATA = Path(__file__).parents[1] / "../shared/data"
ALMANAC = DATA / "almanac/gps-week0862-319488.yuma"
DAY = datetime(2016, 2, 29)
TURIN = np.array(pymap3d.geodetic2ecef(45.2, 7.6, 0.0))

has_almanac = pytest.mark.skipif(not ALMANAC.exists(), reason="no almanac in ../shared/data")

SATELLITE = """\
******** Week 862 almanac for PRN-05 ********
ID:                         05
Health:                     000
Eccentricity:               0.1552200317E-001
Time of Applicability(s):  319488.0000
Orbital Inclination(rad):   0.9426935121
Rate of Right Ascen(r/s):  -0.7988904198E-008
SQRT(A)  (m 1/2):           5153.678711
Right Ascen at Week(rad):  -0.6995461722E+000
Argument of Perigee(rad):  -2.155849708
Mean Anom(rad):             0.1881700077E+001
Af0(s):                     0.5998611450E-003
Af1(s/s):                   0.0000000000E+000
week:                        862

"""


@pytest.fixture
def write(tmp_path):
    def to_file(text):
        path = tmp_path / "almanac.yuma"
        path.write_text(text)
        return path

    return to_file


# ----- orbits ---------------------------------------------------------------------------


def kepler(a, e, i, node, perigee, mean_anomaly):
    """Inertial position by the textbook: true anomaly, then three rotations, in plain floats."""
    E = brentq(lambda E: E - e * sin(E) - mean_anomaly, mean_anomaly - 1.0, mean_anomaly + 1.0,
               xtol=1e-13)  # fmt: skip
    true = 2.0 * atan2(sqrt(1.0 + e) * sin(E / 2.0), sqrt(1.0 - e) * cos(E / 2.0))
    radius = a * (1.0 - e * e) / (1.0 + e * cos(true))
    u = true + perigee
    return radius * np.array(
        [
            cos(u) * cos(node) - sin(u) * cos(i) * sin(node),
            cos(u) * sin(node) + sin(u) * cos(i) * cos(node),
            sin(u) * sin(i),
        ]
    )


@pytest.mark.parametrize("hours", [-60.0, 0.0, 100.0])
def test_an_almanac_satellite_flies_its_ellipse(write, hours):
    satellites = read_yuma(write(SATELLITE), near=DAY)
    a, since = 5153.678711**2, 3600.0 * hours
    mean = 0.1881700077e1 + sqrt(3.986005e14 / a**3) * since
    inertial = kepler(a, 0.1552200317e-1, 0.9426935121, 0.0, -2.155849708, mean)
    # the node's longitude: at week's begin, drifting, less the earth's turn since then
    longitude = -0.6995461722 - 0.7988904198e-8 * since - 7.2921151467e-5 * (319488.0 + since)
    c, s = cos(longitude), sin(longitude)
    expected = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ inertial
    week = 862 + 1024
    position, _ = satellites.states(np.array([604800.0 * week + 319488.0 + since]))
    assert np.linalg.norm(position[0] - expected) < 1e-3


def test_the_baseline_is_the_published_table():
    path = DATA / "constants.json"
    if not path.exists():
        pytest.skip("no constants.json in ../shared/data")
    table = json.loads(path.read_text())["sps24"]
    satellites = baseline_constellation()
    a = 1000.0 * table["a_km"]
    hours, minutes, seconds = 18, 36, 14.4  # of "gha"
    assert table["gha"] == "18h36m14.4s"
    sidereal = radians(15.0 * (hours + minutes / 60.0 + seconds / 3600.0))
    since = 5 * 3600.0
    position, _ = satellites.states(np.array([gps_seconds(datetime(1993, 7, 1, 5))]))
    expected = []
    for node, slots in table["raan_arglat"].values():
        for slot in slots:
            mean = radians(slot) + sqrt(GRAVITY / a**3) * since
            inertial = kepler(a, 0.0, radians(55.0), radians(node), 0.0, mean)
            turn = sidereal + EARTH_RATE * since
            c, s = cos(turn), sin(turn)
            expected.append(np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ inertial)
    assert len(satellites) == 24 and satellites.healthy.all()
    assert np.abs(position - expected).max() < 1e-3


@given(e=st.floats(0.0, 0.1), mean=st.floats(-10.0, 10.0))
@settings(max_examples=200, deadline=None)
def test_keplers_equation_is_solved(e, mean):
    E = eccentric_anomaly(np.array([mean]), np.array([e]))
    np.testing.assert_allclose(E - e * np.sin(E), mean, atol=1e-13)


def test_velocity_is_the_slope_of_position(write):
    satellites, h = read_yuma(write(SATELLITE), near=DAY), 0.5
    time = gps_seconds(DAY) + np.arange(0.0, 43_200.0, 600.0)[:, None]
    slope = (satellites.states(time + h)[0] - satellites.states(time - h)[0]) / (2.0 * h)
    assert np.abs(satellites.states(time)[1] - slope).max() < 1e-4


def test_the_earth_turns_under_a_signal_in_flight():
    """The light-time equation, solved in the inertial frame by bisection."""
    satellites = baseline_constellation()
    time = np.array([gps_seconds(DAY)])
    used, _ = satellites.seen_from(TURIN[None], time)
    ranges = np.linalg.norm(used[0] - TURIN, axis=-1)
    for k in range(0, 24, 5):

        def misfit(flight, k=k):
            then = satellites.states(time - flight)[0][k]
            turn = EARTH_RATE * flight  # by which the earth-fixed frame turned meanwhile
            c, s = cos(turn), sin(turn)
            receiver = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ TURIN
            return np.linalg.norm(then - receiver) - SPEED_OF_LIGHT * flight

        assert ranges[k] == pytest.approx(SPEED_OF_LIGHT * brentq(misfit, 0.05, 0.12, xtol=1e-15),
                                          abs=2e-3)  # fmt: skip
    still = np.linalg.norm(satellites.states(time)[0] - TURIN, axis=-1)
    assert np.abs(ranges - still).max() > 50.0  # leaving it out matters


@has_almanac
def test_satellites_over_turin_on_29_february_2016():
    satellites = read_yuma(ALMANAC, near=DAY)
    assert len(satellites) == 31 and len(satellites.usable()) == 29
    time = gps_seconds(DAY) + np.arange(0.0, 86_400.0, 60.0)
    receiver = np.broadcast_to(TURIN, (len(time), 3))
    elevation, _ = look_angles(receiver, satellites.usable().seen_from(receiver, time)[0])
    visible = (elevation > radians(5.0)).sum(axis=1)
    assert (visible.min(), np.median(visible), visible.max()) == (7, 9, 13)


def test_look_angles_of_known_directions():
    east, north, up = np.array(pymap3d.enu2uvw(*np.eye(3), 45.2, 7.6)).T
    targets = TURIN + 2e7 * np.array([up, north, east, east + up, -north])
    elevation, azimuth = look_angles(TURIN[None], targets[None])
    np.testing.assert_allclose(np.degrees(elevation), [[90.0, 0.0, 0.0, 45.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(np.degrees(azimuth[0, 1:]), [0.0, 90.0, 90.0, 180.0], atol=1e-6)


# ----- almanac files --------------------------------------------------------------------


def test_unhealthy_satellites_are_marked(write):
    sick = SATELLITE.replace("000\n", "063\n", 1).replace("ID:                         05", "ID: 7")
    satellites = read_yuma(write(SATELLITE + sick), near=DAY)
    np.testing.assert_array_equal(satellites.healthy, [True, False])
    np.testing.assert_array_equal(satellites.usable().number, [5])


@pytest.mark.parametrize(("near", "week"), [((2016, 2, 29), 1886), ((1996, 8, 1), 862),
                                            ((2035, 1, 1), 2910)])  # fmt: skip
def test_the_rollover_nearest_to_the_date_is_meant(write, near, week):
    satellites = read_yuma(write(SATELLITE), near=datetime(*near))
    assert satellites.reference[0] == 604_800.0 * week + 319_488.0


@pytest.mark.parametrize(("text", "complaint"), [
    ("not an almanac", "no YUMA almanac"),
    (SATELLITE.replace("Mean Anom(rad):             0.1881700077E+001\n", ""), "lacks mean anom"),
    (SATELLITE.replace("5153.678711", "soon"), "line 8: sqrt\\(a\\) .*'soon'"),
    (SATELLITE.replace("0.1552200317E-001", "nan"), "line 4: eccentricity"),
    (SATELLITE.replace("5153.678711", "51.5"), "between 4000 and 7000"),
])  # fmt: skip
def test_a_bad_file_is_refused(write, text, complaint):
    with pytest.raises(ValueError, match=complaint):
        read_yuma(write(text), near=DAY)


# ----- atmosphere -----------------------------------------------------------------------


@pytest.mark.parametrize(("elevation", "sea", "high", "wet"), [
    (5.0, 10.14870492, 10.25856516, 10.75065936), (10.0, 5.55522292, 5.57494291, 5.65709185),
    (30.0, 1.99278711, 1.99352572, 1.99654281), (90.0, 1.0, 1.0, 1.0),
])  # fmt: skip
def test_niell_check_values(elevation, sea, high, wet):
    """SPEC 4.3: latitude 45.2 deg, day 60, heights of 0 and 5000 m."""
    dry, moist = niell(radians(elevation), radians(45.2), np.array([0.0, 5000.0]), 60)
    np.testing.assert_allclose(dry, [sea, high], atol=1e-7)
    np.testing.assert_allclose(moist, wet, atol=1e-7)


def test_niells_seasons_are_half_a_year_apart_in_the_south():
    north, _ = niell(radians(10.0), radians(45.0), 0.0, 28.0)
    south, _ = niell(radians(10.0), radians(-45.0), 0.0, 28.0 + 365.25 / 2.0)
    assert north == pytest.approx(south, abs=1e-12)
    assert abs(north - niell(radians(10.0), radians(-45.0), 0.0, 28.0)[0]) > 1e-4


def test_the_dry_delay_falls_with_height():
    """The printed sign of z (down) grows instead: 2.90 m at 2 km (SPEC 4.3)."""
    assert dry_zenith_delay(2000.0) == pytest.approx(1.82, abs=0.005)
    assert dry_zenith_delay(-2000.0) == pytest.approx(2.90, abs=0.005)
    assert troposphere(pi / 2.0, radians(45.0), 0.0, 60) == pytest.approx(2.4, abs=0.01)


ALPHA, BETA = (3.82e-8, 1.49e-8, -1.79e-7, 0.0), (1.43e5, 0.0, -3.28e5, 1.13e5)


def klobuchar_by_hand(alpha, beta, latitude, longitude, elevation, azimuth, time):
    """IS-GPS-200, figure 20-4, line by line in plain floats; semicircles, result in s."""
    E, A = elevation / pi, azimuth
    psi = 0.0137 / (E + 0.11) - 0.022
    phi = latitude / pi + psi * cos(A)
    phi = 0.416 if phi > 0.416 else -0.416 if phi < -0.416 else phi
    lam = longitude / pi + psi * sin(A) / cos(phi * pi)
    phi_m = phi + 0.064 * cos((lam - 1.617) * pi)
    t = 4.32e4 * lam + time
    while t >= 86400.0:
        t -= 86400.0
    while t < 0.0:
        t += 86400.0
    F = 1.0 + 16.0 * (0.53 - E) ** 3
    PER = beta[0] + beta[1] * phi_m + beta[2] * phi_m**2 + beta[3] * phi_m**3
    PER = 72000.0 if PER < 72000.0 else PER
    AMP = alpha[0] + alpha[1] * phi_m + alpha[2] * phi_m**2 + alpha[3] * phi_m**3
    AMP = 0.0 if AMP < 0.0 else AMP
    x = 2.0 * pi * (t - 50400.0) / PER
    if abs(x) < 1.57:
        return F * (5e-9 + AMP * (1.0 - x**2 / 2.0 + x**4 / 24.0))
    return F * 5e-9


def test_klobuchar_of_the_published_example():
    """40 N, 100 W, elevation 20, azimuth 210 deg, 20:45 UTC: 23.784 m."""
    delay = klobuchar(ALPHA, BETA, *np.radians([40.0, -100.0, 20.0, 210.0]), 74_700.0)
    assert delay == pytest.approx(23.784, abs=5e-4)


@given(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0), st.floats(3.0, 90.0),
       st.floats(0.0, 360.0), st.floats(0.0, 604_800.0))  # fmt: skip
@settings(max_examples=300, deadline=None)
def test_klobuchar_against_plain_floats(latitude, longitude, elevation, azimuth, time):
    place = np.radians([latitude, longitude, elevation, azimuth])
    expected = SPEED_OF_LIGHT * klobuchar_by_hand(ALPHA, BETA, *place, time)
    assert klobuchar(ALPHA, BETA, *place, time) == pytest.approx(expected, rel=1e-6)


def test_klobuchar_peaks_at_two_in_the_afternoon():
    """Not at midday (SPEC 4.3), and at night 5 ns remain."""
    hours = np.arange(0.0, 24.0, 0.1)
    delay = klobuchar(ALPHA, BETA, radians(45.0), 0.0, pi / 2.0, 0.0, 3600.0 * hours)
    assert hours[np.argmax(delay)] == pytest.approx(14.0, abs=0.11)
    assert delay[0] == pytest.approx(5e-9 * SPEED_OF_LIGHT, rel=1e-3)


def test_multipath_takes_degrees():
    """In radians it would be flat: 0.66 to 0.58 m (SPEC 4.3)."""
    np.testing.assert_allclose(multipath_deviation(np.radians([5.0, 90.0])), [0.45, 0.13],
                               atol=0.005)  # fmt: skip
    assert range_deviation(radians(90.0)) == pytest.approx(
        sqrt(2.93**2 + 0.13**2 + 0.5**2), abs=1e-3
    )


# ----- clock ----------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize("white_frequency", [0.0, 0.3])
def test_the_clocks_noise_is_van_loans(dt, white_frequency):
    motion = with_clock(constant_acceleration(2.0), 0.1, white_frequency)
    entries = motion.build(batch).noise_factor(tuple(np.ones((11, 1))), (), dt)
    factor = np.zeros((11, 11))
    for place, value in zip(motion.noise_pattern, entries, strict=True):
        factor[place] = value[0]
    Q = factor @ factor.T
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    transition, clock = van_loan(A, np.diag(np.sqrt([white_frequency, 0.1])), dt)
    np.testing.assert_allclose(Q[9:, 9:], clock, rtol=1e-12)
    np.testing.assert_allclose(Q[:3, :3], 2.0 * white_jerk(dt), rtol=1e-12)
    assert not Q[:9, 9:].any()  # blkdiag, of which S0 eq 49 prints two of four blocks
    state = np.arange(11.0)[:, None]
    moved = np.stack(motion.build(batch).step(tuple(state), (), dt))[:, 0]
    np.testing.assert_allclose(moved[9:], transition @ state[9:, 0], rtol=1e-14)


def test_the_clock_leaves_the_motion_alone():
    state = np.linspace(1.0, 9.0, 11)[:, None] * np.linspace(10.0, 20.0, 11)[:, None]
    plain, clocked = (
        model.build(batch) for model in (variable_turn(), with_clock(variable_turn()))
    )
    np.testing.assert_array_equal(clocked.step(tuple(state), (), 0.1)[:9],
                                  plain.step(tuple(state[:9]), (), 0.1))  # fmt: skip


@pytest.mark.parametrize("values", [(0.0, 0.0), (-1.0, 0.0), (float("nan"), 0.0), (0.1, -1.0)])
def test_a_clock_needs_sensible_densities(values):
    with pytest.raises(ValueError, match=r"spectral_density|white_frequency"):
        with_clock(constant_acceleration(), *values)


# ----- pseudoranges ---------------------------------------------------------------------


def in_view(seed=0):
    """A receiver's state (1, 11) and the inputs (1, 72) of twelve satellites about it."""
    rng = np.random.default_rng(seed)
    state = np.zeros((1, 11))
    state[0, 0:9:3], state[0, 1:9:3] = TURIN, 100.0 * rng.normal(size=3)
    state[0, 2:9:3], state[0, 9:] = rng.normal(size=3), (300.0, 4.0)
    direction = rng.normal(size=(12, 3)) + 2.0 * TURIN / np.linalg.norm(TURIN)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inputs = np.hstack([TURIN + 2.2e7 * direction, 2000.0 * rng.normal(size=(12, 3))])
    return state, inputs.reshape(1, 72)


def test_pseudoranges_by_vectors():
    state, inputs = in_view()
    measured = np.stack(pseudoranges().build(batch)(tuple(state.T), tuple(inputs.T)))[:, 0]
    satellite = inputs.reshape(12, 2, 3)
    line = satellite[:, 0] - TURIN
    distance = np.linalg.norm(line, axis=1)
    np.testing.assert_allclose(measured[:12], distance + 300.0, rtol=1e-15)
    speed = np.einsum("kj,kj->k", line / distance[:, None], satellite[:, 1] - state[0, 1:9:3])
    np.testing.assert_allclose(measured[12:], speed + 4.0, rtol=1e-12)


def jacobian(sensor, state, inputs):
    outputs = sensor.build(dual)(dual.seed(state), tuple(inputs.T))
    return np.stack([output.gradient[0] for output in outputs])


def test_the_jacobian_at_measurement_time():
    """SPEC 4.3: d rho/dr = -u, d rho/dv = 0, d rhodot/dv = -u; the clock's ones."""
    state, inputs = in_view()
    H = jacobian(pseudoranges(), state, inputs)
    satellite = inputs.reshape(12, 2, 3)
    line, relative = satellite[:, 0] - TURIN, satellite[:, 1] - state[0, 1:9:3]
    distance = np.linalg.norm(line, axis=1, keepdims=True)
    u = line / distance
    speed = np.sum(u * relative, axis=1, keepdims=True)
    expected = np.zeros((2, 12, 11))
    expected[0, :, 0:9:3] = expected[1, :, 1:9:3] = -u
    expected[1, :, 0:9:3] = (speed * u - relative) / distance
    expected[0, :, 9] = expected[1, :, 10] = 1.0
    np.testing.assert_allclose(H, expected.reshape(24, 11), atol=1e-12)


def test_the_printed_jacobian_is_of_the_state_before_the_step():
    """Appendix B is H F, but for the clock's drift and a sign of the acceleration block."""
    state, inputs = in_view()
    dt = 0.1
    H = jacobian(pseudoranges(), state, inputs)
    F = np.eye(11)
    for axis in (0, 3, 6):
        F[axis, axis + 1] = F[axis + 1, axis + 2] = dt
        F[axis, axis + 2] = dt * dt / 2.0
    printed = jacobian(as_printed(dt), state, inputs)
    np.testing.assert_array_equal(printed, printed_jacobian(state, inputs, dt)[0])
    off = np.abs(printed - H @ F)
    assert off[:, :2].max() < 1e-9 and off[:12, 2:9].max() < 1e-9
    acceleration = off[12:, 2:9:3]  # tiny (SPEC 4.3), but there
    assert 1e-9 < acceleration.max() < 2e-5 * np.abs(H @ F)[12:, 2:9:3].max()
    values = [y.value for y in as_printed(dt).build(dual)(dual.seed(state), tuple(inputs.T))]
    right = pseudoranges().build(batch)(tuple(state.T), tuple(inputs.T))
    np.testing.assert_array_equal(values, right)


def test_geodetic_keeps_the_shape():
    latitude, longitude, height = geodetic(np.broadcast_to(TURIN, (1, 4, 3)))
    assert latitude.shape == longitude.shape == height.shape == (1, 4)
    assert degrees(latitude[0, 0]) == pytest.approx(45.2)
