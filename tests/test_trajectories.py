"""Trajectories: consistent derivatives, the papers' figures, limits, coverage, same bits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kfenv.scenarios import coverage, trajectories
from kfenv.scenarios.radar.tracking import RadarTracking
from kfenv.scenarios.trajectories import paper_trajectory, random_trajectory

POSITION, VELOCITY, ACCELERATION = slice(0, 9, 3), slice(1, 9, 3), slice(2, 9, 3)
SEEDS = st.integers(0, 2**32 - 1)


def times(duration, rate):
    return np.arange(round(duration * rate) + 1) / rate


def random(seed, time):
    return random_trajectory(np.random.default_rng(seed), time)


def slope(values, step):
    """Fourth-order central difference, two samples shorter at either end."""
    return (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step)


def assert_derivatives_agree(states, step):
    """Position, velocity and acceleration belong together, to the error of the difference."""
    inner = states[2:-2]
    assert np.abs(slope(states[:, POSITION], step) - inner[:, VELOCITY]).max() < 0.01
    assert np.abs(slope(states[:, VELOCITY], step) - inner[:, ACCELERATION]).max() < 0.01


def turn_rate(states):
    vx, vy, ax, ay = states[:, 1], states[:, 4], states[:, 2], states[:, 5]
    return (vy * ax - vx * ay) / (vx**2 + vy**2)


class TestPaperTrajectories:
    def test_a_spans_what_the_specification_says(self):
        x, y, z = paper_trajectory("A", times(250, 20))[:, POSITION].T / 1e3
        assert (x.min(), x.max()) == pytest.approx((-10.0, 8.6), abs=0.05)
        assert (y.min(), y.max()) == pytest.approx((0.6, 8.2), abs=0.05)
        assert (z.min(), z.max()) == pytest.approx((0.3, 1.456), abs=1e-6)

    def test_a_passes_the_radar_at_922_m(self):
        time = times(250, 20)
        distance = np.linalg.norm(paper_trajectory("A", time)[:, POSITION], axis=1)
        assert distance.min() == pytest.approx(922.0, abs=0.5)
        assert time[distance.argmin()] == pytest.approx(75.1, abs=0.06)

    def test_b_stays_before_the_array(self):
        x, y, z = paper_trajectory("B", times(250, 20))[:, POSITION].T
        azimuth = np.degrees(np.arctan2(x, y))
        distance = np.sqrt(x**2 + y**2 + z**2) / 1e3
        assert (azimuth.min(), azimuth.max()) == pytest.approx((-45.0, 42.3), abs=0.1)
        assert (distance.min(), distance.max()) == pytest.approx((5.4, 17.3), abs=0.05)

    @pytest.mark.parametrize(("name", "speed"), [("A", 133.0), ("B", 130.0)])
    def test_speed_is_constant(self, name, speed):
        velocity = paper_trajectory(name, times(250, 10))[:, VELOCITY]
        assert np.linalg.norm(velocity, axis=1) == pytest.approx(speed, abs=1e-9)

    @pytest.mark.parametrize("name", ["A", "B"])
    def test_derivatives_agree(self, name):
        assert_derivatives_agree(paper_trajectory(name, times(250, 50)), 0.02)

    @pytest.mark.parametrize("name", ["A", "B"])
    def test_sampling_does_not_matter(self, name):
        fine, coarse = paper_trajectory(name, times(250, 10)), paper_trajectory(name, [31.0, 205.5])
        assert np.abs(fine[[310, 2055]] - coarse).max() < 1e-9

    def test_steady_turn_and_climb(self):
        state = paper_trajectory("A", [40.0, 100.0, 165.0])
        assert np.degrees(turn_rate(state)) == pytest.approx([-1.0, 0.0, -2.0], abs=1e-9)
        assert state[:, 7] == pytest.approx([10.0, 10.0, 8.0], abs=1e-9)

    @pytest.mark.parametrize(
        ("arguments", "complaint"),
        [
            (("C", [0.0]), "'A' or 'B'"),
            (("A", [-1.0, 0.0]), "begins at 0 s"),
            (("A", [0.0, 0.0]), "increase"),
            (("A", [0.0, np.nan, 1.0]), "increase"),
            (("A", [0.0, np.inf]), "finite"),
            (("A", []), "one or more"),
            (("A", [[0.0, 1.0]]), "shape"),
        ],
    )
    def test_bad_input_is_refused(self, arguments, complaint):
        with pytest.raises(ValueError, match=complaint):
            paper_trajectory(*arguments)


class TestRandomTrajectories:
    @given(seed=SEEDS, duration=st.sampled_from([20.0, 120.0, 300.0]))
    @settings(max_examples=60, deadline=None)
    def test_stays_in_coverage(self, seed, duration):
        east, north, up = random(seed, times(duration, 10))[:, POSITION].T
        distance = np.sqrt(east**2 + north**2 + up**2)
        azimuth = np.degrees(np.arctan2(east, north))
        elevation = np.degrees(np.arctan2(up, np.hypot(east, north)))
        assert distance.min() >= 1_500.0
        assert distance.max() <= 17_000.0
        assert np.abs(azimuth).max() <= 55.0
        assert elevation.min() >= -35.0
        assert elevation.max() <= 75.0

    @given(seed=SEEDS)
    @settings(max_examples=60, deadline=None)
    def test_keeps_its_limits(self, seed):
        states = random(seed, times(120, 10))
        speed = np.linalg.norm(states[:, VELOCITY], axis=1)
        assert speed.min() >= 35.0 - 1e-9
        assert speed.max() <= 140.0 + 1e-9
        assert states[:, 6].min() >= 150.0 - 0.1  # between two nodes
        assert states[:, 6].max() <= 3_000.0 + 0.1
        assert np.abs(states[:, 7]).max() <= 12.0 + 1e-9
        assert np.degrees(np.abs(turn_rate(states))).max() <= 10.0 + 1e-9
        assert np.linalg.norm(states[:, ACCELERATION], axis=1).max() < 30.0

    @given(seed=SEEDS)
    @settings(max_examples=20, deadline=None)
    def test_derivatives_agree(self, seed):
        assert_derivatives_agree(random(seed, times(60, 50)), 0.02)

    @given(seed=SEEDS)
    @settings(max_examples=20, deadline=None)
    def test_jerk_is_finite(self, seed):
        acceleration = random(seed, times(60, 100))[:, ACCELERATION]
        assert np.abs(np.diff(acceleration, axis=0)).max() < 0.5  # of up to 24 m/s^2, in 10 ms

    @given(seed=SEEDS)
    @settings(max_examples=20, deadline=None)
    def test_sampling_does_not_matter(self, seed):
        fine, coarse = random(seed, times(120, 10)), random(seed, times(120, 2))
        assert np.abs(fine[::5] - coarse).max() < 1e-3

    def test_position_is_the_integral_of_velocity(self):
        from scipy.integrate import simpson

        time = times(120, 50)
        for seed in range(5):
            states = random(seed, time)
            travelled = simpson(states[:, VELOCITY], x=time, axis=0)
            assert states[-1, POSITION] - states[0, POSITION] == pytest.approx(travelled, abs=2e-3)

    @given(seed=SEEDS)
    @settings(max_examples=10, deadline=None)
    def test_same_seed_gives_same_bits(self, seed):
        time = times(30, 10)
        assert random(seed, time).tobytes() == random(seed, time).tobytes()

    def test_start_time_does_not_matter(self):
        time = times(60, 4)
        assert np.abs(random(3, time) - random(3, time + 64.0)).max() < 1e-9

    def test_flights_differ_and_cover_the_repertoire(self):
        flights = np.stack([random(seed, times(120, 2)) for seed in range(60)])
        speed = np.linalg.norm(flights[:, :, VELOCITY], axis=2)
        rate = np.degrees(np.abs([turn_rate(flight) for flight in flights]))
        distance = np.linalg.norm(flights[:, :, POSITION], axis=2)
        assert speed.min() < 45.0
        assert speed.max() > 130.0
        assert rate.max() > 9.0
        assert 0.2 < (rate < 0.1).mean() < 0.6  # straight legs
        assert flights[:, :, 7].min() < -10.0
        assert flights[:, :, 7].max() > 10.0
        assert distance.min() < 3_000.0
        assert distance.max() > 14_000.0

    def test_ten_minutes_still_fit(self):
        states = random(0, times(600, 1))
        assert coverage.in_coverage(*states[:, POSITION].T).all()

    def test_one_sample_is_a_trajectory(self):
        assert random(0, [5.0]).shape == (1, 9)

    def test_more_than_ten_minutes_is_refused(self):
        with pytest.raises(ValueError, match="at most 600 s, time spans 700 s"):
            random(0, [0.0, 700.0])

    def test_decreasing_times_are_refused(self):
        with pytest.raises(ValueError, match="increase"):
            random(0, [0.0, 2.0, 1.0])

    def test_search_ends(self, monkeypatch):
        monkeypatch.setattr(trajectories, "MAX_ALTITUDE", 100.0)  # below the least height
        monkeypatch.setattr(trajectories, "MAX_ATTEMPTS", 5)
        with pytest.raises(RuntimeError, match="no random flight of 10 s"):
            random(0, times(10, 1))


class TestSmoothFlights:
    @given(seed=SEEDS)
    @settings(max_examples=40, deadline=None)
    def test_keeps_its_limits_and_coverage(self, seed):
        states = random_trajectory(np.random.default_rng(seed), times(120, 10), "smooth")
        speed = np.linalg.norm(states[:, VELOCITY], axis=1)
        assert speed.min() >= 60.0 - 1e-9
        assert speed.max() <= 230.0 + 1e-9
        assert np.abs(states[:, 7]).max() <= 5.0 + 1e-9
        assert np.degrees(np.abs(turn_rate(states))).max() <= 1.5 + 1e-9
        assert np.linalg.norm(states[:, ACCELERATION], axis=1).max() < 8.0
        assert coverage.in_coverage(*states[:, POSITION].T).all()

    def test_the_radar_scenario_flies_them(self):
        scenario = RadarTracking(rate=2.0, faults="none", flights="smooth")
        truth = scenario.sample([np.random.default_rng(0)]).truth[0]
        expected = random_trajectory(np.random.default_rng(0), scenario.time, "smooth")
        np.testing.assert_array_equal(truth, expected)

    def test_what_is_not_drawn_has_no_style(self):
        with pytest.raises(ValueError, match="Did you mean 'smooth'"):
            RadarTracking(flights="smoth")
        with pytest.raises(ValueError, match="leave it out"):
            RadarTracking(faults="paper", flights="smooth")


class TestCoverage:
    @pytest.mark.parametrize(
        ("distance", "azimuth", "elevation", "inside"),
        [
            (10_000.0, 0.0, 20.0, True),
            (1_499.0, 0.0, 20.0, False),
            (1_501.0, 0.0, 20.0, True),
            (16_999.0, 0.0, 20.0, True),
            (17_001.0, 0.0, 20.0, False),
            (10_000.0, 54.9, 20.0, True),
            (10_000.0, 55.1, 20.0, False),
            (10_000.0, -55.1, 20.0, False),
            (10_000.0, 180.0, 20.0, False),
            (10_000.0, 0.0, 74.9, True),
            (10_000.0, 0.0, 75.1, False),
            (10_000.0, 0.0, -34.9, True),
            (10_000.0, 0.0, -35.1, False),
        ],
    )
    def test_limits(self, distance, azimuth, elevation, inside):
        azimuth, elevation = np.radians([azimuth, elevation])
        ground = distance * np.cos(elevation)
        point = ground * np.sin(azimuth), ground * np.cos(azimuth), distance * np.sin(elevation)
        assert coverage.in_coverage(*point) == inside

    def test_turn_is_clockwise(self):
        north = np.array([[0.0], [1.0]])
        assert coverage.turn(north, np.pi / 2) == pytest.approx(np.array([[1.0], [0.0]]))

    def test_placement_does_what_it_says(self):
        rng = np.random.default_rng(1)
        path = np.array([[0.0, 100.0, 300.0], [0.0, 0.0, 50.0], [900.0, 900.0, 900.0]])
        angle, shift = coverage.place(rng, path, path[:2, 1], (5_000.0, 6_000.0))
        east, north = coverage.turn(path[:2], angle) + shift[:, None]
        assert 5_000.0 <= np.hypot(east[1], north[1]) <= 6_000.0
        assert coverage.in_coverage(east, north, path[2]).all()

    def test_a_path_too_long_has_no_placement(self):
        path = np.array([[-30_000.0, 30_000.0], [0.0, 0.0], [900.0, 900.0]])
        rng = np.random.default_rng(1)
        assert coverage.place(rng, path, np.zeros(2), (5_000.0, 6_000.0)) is None
