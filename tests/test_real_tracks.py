"""Real flights: the smoothing takes jitter out and leaves turns in; windows.

The flights lie beside the repository; without them what needs them is skipped, saying so.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from flights import ACCELERATION, GRAVITY, POSITION, VELOCITY, turn_rate

from kfenv.scenarios.coverage import in_coverage
from kfenv.scenarios.reports import load_track
from kfenv.scenarios.tracks import flight, smooth_track, window

TRACKS = Path(__file__).parents[1].parent / "shared" / "data" / "tracks"
FLIGHTS = ("af393322_departure.csv", "afr787v_39c424.csv", "transavia737_484506.csv")

needs_flights = pytest.mark.skipif(
    not TRACKS.is_dir(), reason=f"no recorded flights in ../shared/data/tracks ({TRACKS})"
)
every_flight = pytest.mark.parametrize("flight", FLIGHTS)


@cache
def smooth_flight(flight):
    return smooth_track(load_track(TRACKS / flight))


def reports(flight):
    return np.genfromtxt(TRACKS / flight, delimiter=",", names=True)


def residuals(smooth, flight):
    """Along, across and up from the spline to each report, and the spline's states there, m."""
    table = reports(flight)
    table = table[table["t"] <= smooth.duration]
    enu = pymap3d.geodetic2enu(table["lat"], table["lon"], table["alt_m"], *smooth.origin)
    states = smooth.states(table["t"])
    east, north, up = np.stack(enu) - states[:, POSITION].T
    ve, vn = states[:, 1], states[:, 4]
    ground = np.hypot(ve, vn)
    along, across = (east * ve + north * vn) / ground, (east * vn - north * ve) / ground
    return along, across, up, states, table


@needs_flights
class TestSmoothing:
    @every_flight
    def test_residuals_are_the_jitter(self, flight):
        smooth = smooth_flight(flight)
        along, across, up, *_ = residuals(smooth, flight)
        kept = np.hypot(along, across) < 150.0  # the stale ones are hundreds of metres off
        assert (~kept).sum() <= 20
        assert 3.0 < along[kept].std() < 36.0
        assert 1.0 < across[kept].std() < 20.0
        assert up.std() < 7.62 / 2.0

    @every_flight
    def test_speed_is_the_reported_ground_speed(self, flight):
        *_, states, table = residuals(smooth_flight(flight), flight)
        error = np.hypot(states[:, 1], states[:, 4]) - table["gs_mps"]
        assert abs(error.mean()) < 0.5
        assert error.std() < 1.6
        assert np.abs(error).max() < 6.0

    @every_flight
    def test_acceleration_is_an_airliners(self, flight):
        smooth = smooth_flight(flight)
        states = smooth.states(np.arange(0.0, smooth.duration, 0.1))
        assert np.linalg.norm(states[:, ACCELERATION], axis=1).max() < 0.7 * GRAVITY
        assert np.abs(states[:, 8]).max() < 0.1 * GRAVITY

    @every_flight
    def test_turns_stay(self, flight):
        """The heading follows the reported track, and turns through as much of it."""
        smooth = smooth_flight(flight)
        *_, states, table = residuals(smooth, flight)
        heading = np.unwrap(np.arctan2(states[:, 1], states[:, 4]))
        reported = np.unwrap(np.radians(table["track_deg"]))
        drift = np.degrees(heading - reported)
        assert np.median(np.abs(drift - np.median(drift))) < 1.5
        turned, reported_turned = np.ptp(heading), np.ptp(reported)
        assert turned == pytest.approx(reported_turned, abs=np.radians(5.0))

    @every_flight
    def test_straight_flight_is_straight(self, flight):
        smooth = smooth_flight(flight)
        rate = np.degrees(np.abs(turn_rate(smooth.states(np.arange(5.0, smooth.duration - 5.0)))))
        assert np.percentile(rate, 30) < 0.1
        assert 1.5 < rate.max() < 4.0

    @every_flight
    def test_derivatives_agree(self, flight):
        states = smooth_flight(flight).states(np.arange(100.0, 300.0, 0.01))
        for value, derivative in ((POSITION, VELOCITY), (VELOCITY, ACCELERATION)):
            slope = (states[2:, value] - states[:-2, value]) / 0.02
            assert np.abs(slope - states[1:-1, derivative]).max() < 5e-3

    def test_stale_reports_are_left_out(self):
        assert 15 <= smooth_flight("transavia737_484506.csv").rejected <= 30

    @every_flight
    @pytest.mark.parametrize("seed", range(5))
    def test_window_is_before_the_radar(self, flight, seed):
        time = np.arange(0.0, 120.05, 0.1)
        states = window(np.random.default_rng(seed), smooth_flight(flight), time)
        assert in_coverage(*states[:, POSITION].T).all()
        assert 6_000.0 <= np.hypot(states[600, 0], states[600, 3]) <= 13_000.0
        assert np.linalg.norm(states[:, ACCELERATION], axis=1).max() < 0.7 * GRAVITY
        slope = (states[2:, POSITION] - states[:-2, POSITION]) / 0.2
        assert np.abs(slope - states[1:-1, VELOCITY]).max() < 0.02

    def test_flight_shorter_than_the_episode_is_refused(self):
        with pytest.raises(ValueError, match=r"csv lasts 719.* episode 800 s"):
            window(np.random.default_rng(0), smooth_flight(FLIGHTS[0]), np.arange(0.0, 801.0))

    def test_window_that_cannot_fit_ends_in_a_sentence(self):
        remedy = r"csv: none of 200 windows of 399 s .* of 0 m; a duration of 99 s would fit"
        with pytest.raises(ValueError, match=remedy):
            window(np.random.default_rng(0), smooth_flight(FLIGHTS[2]), np.arange(0.0, 400.0))


@needs_flights
@pytest.mark.parametrize("case", ["dense", "fr24_like", "mixed"])
def test_recorded_disorder_is_flown(case):
    """Reports in whole seconds, 60 s apart in cruise, some from the ground."""
    path = TRACKS.parents[1] / "cases" / f"{case}.csv"
    smooth, track = flight(path), load_track(path)
    states = smooth.states(np.arange(0.0, smooth.duration))
    assert smooth.rejected <= 0.01 * track.time.size
    assert np.linalg.norm(states[:, ACCELERATION], axis=1).max() < 0.5 * GRAVITY
    assert np.isfinite(window(np.random.default_rng(0), smooth, np.arange(0.0, 61.0))).all()
    if case == "fr24_like":
        return
    # it flies north at 220 m/s and 10 km
    enu = np.stack(pymap3d.geodetic2enu(track.latitude, track.longitude, 1e4, *smooth.origin))
    line = np.polynomial.Polynomial.fit(track.time, enu.T[:, 1], 5)
    jitter = (enu[1] - line(track.time)).std()
    time = np.arange(10.0, smooth.duration - 10.0)
    assert (smooth.states(time)[:, 3] - line(time)).std() < 0.9 * jitter
    assert 45.0 < jitter < 75.0
