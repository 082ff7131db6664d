"""Smoothing of made-up flights, sound and disordered, against their known truth; windows."""

import re

import disordered_flights as disordered
import gymnasium as gym
import numpy as np
import pymap3d
import pytest
from flights import ACCELERATION, POSITION, VELOCITY, made_up, turn_rate

from kfenv.scenarios.reports import Track
from kfenv.scenarios.tracks import from_radar, smooth_track, window


class TestMadeUpFlight:
    def test_turns_come_through(self):
        smooth = smooth_track(made_up())
        time = np.arange(40.0, 260.0)
        expected = 1.5 * np.sin(2.0 * np.pi / 150.0 * time)
        states = smooth.states(time)
        assert np.degrees(turn_rate(states)) == pytest.approx(expected, abs=0.05)
        assert np.hypot(states[:, 1], states[:, 4]) == pytest.approx(100.0, abs=0.5)

    def test_jitter_is_taken_out(self):
        clean, noisy = (
            smooth_track(made_up(jitter=jitter), origin=(50.0, 5.0, 0.0)) for jitter in (0.0, 15.0)
        )
        time = np.arange(20.0, 280.0)
        error = noisy.states(time) - clean.states(time)
        assert error[:, POSITION].std() < 6.0
        assert error[:, VELOCITY].std() < 1.5

    def test_gain_at_the_cutoff_is_a_half_at_any_sampling(self):
        for step in (0.5, 2.0):
            time = np.arange(0.0, 1_000.0, step)
            wave = 5.0 * np.sin(2.0 * np.pi * time / 25.0)
            enu = 100.0 * time, np.zeros(time.size), wave
            track = Track(time, *pymap3d.enu2geodetic(*enu, 0.0, 0.0, 1000.0))
            at = np.arange(400.0, 600.0, 0.5)
            smooth = smooth_track(track, cutoff=25.0, origin=(0.0, 0.0, 1000.0))
            up = smooth.states(at)[:, 6]
            kept = 2.0 / 5.0 * np.mean(up * np.sin(2.0 * np.pi * at / 25.0))
            assert kept == pytest.approx(0.5, abs=0.01)

    def test_stale_report_is_left_out(self):
        track = made_up(jitter=5.0)
        latitude = track.latitude.copy()
        latitude[100] += 400.0 / 111_000.0
        stale = smooth_track(Track(track.time, latitude, track.longitude, track.altitude))
        difference = stale.states([100.0]) - smooth_track(track).states([100.0])
        assert stale.rejected == 1
        assert np.linalg.norm(difference[:, POSITION]) < 3.0

    def test_gaps_are_named_and_avoided(self):
        track = made_up(duration=600.0)
        kept = (track.time <= 200.0) | (track.time >= 240.0)
        smooth = smooth_track(
            Track(*(v[kept] for v in (track.time, track.latitude, track.longitude, track.altitude)))
        )
        assert smooth.gaps == ((200.0, 240.0),)
        rng = np.random.default_rng(0)
        starts = np.array([smooth.random_start(rng, 60.0) for _ in range(300)])
        assert ((starts <= 140.0) | (starts >= 240.0)).all()
        assert starts.max() <= 540.0
        assert 0.2 < (starts < 200.0).mean() < 0.45  # 140 of 440 s
        with pytest.raises(ValueError, match=r"360 s without a gap.* episode 400 s"):
            window(rng, smooth, np.arange(0.0, 401.0))
        assert np.isfinite(smooth.states(np.arange(200.0, 241.0))).all()

    def test_same_seed_gives_same_bits(self):
        smooth, time = smooth_track(made_up()), np.arange(0.0, 60.0, 0.5)
        first, again = (window(np.random.default_rng(7), smooth, time) for _ in range(2))
        assert first.tobytes() == again.tobytes()

    def test_window_keeps_the_flight_but_for_turn_and_shift(self):
        smooth, time = smooth_track(made_up()), np.arange(0.0, 60.5, 0.5)
        placed = window(np.random.default_rng(7), smooth, time, altitude_offset=-300.0)
        start = smooth.random_start(np.random.default_rng(7), 60.0)
        original = smooth.states(start + time)
        for derivative in (VELOCITY, ACCELERATION):
            lengths = [np.linalg.norm(s[:, derivative], axis=1) for s in (placed, original)]
            assert lengths[0] == pytest.approx(lengths[1], abs=1e-9)
        assert turn_rate(placed) == pytest.approx(turn_rate(original), abs=1e-5)
        assert placed[:, 6] == pytest.approx(700.0, abs=2.0)

    def test_level_flight_is_level_in_its_window(self):
        """In the frame of an origin 110 km away it climbs by 0.9 m/s."""
        smooth = smooth_track(made_up(), origin=(51.0, 5.0, 0.0))
        assert np.abs(smooth.states([100.0, 200.0])[:, 7]).max() > 0.7
        for seed in range(5):
            level = window(np.random.default_rng(seed), smooth, np.arange(0.0, 100.0))
            assert np.abs(level[:, 7]).max() < 0.1

    def test_offset_below_ground_is_refused(self):
        with pytest.raises(ValueError, match=r"offset of -1500 m; an altitude_offset of 0 m would"):
            window(
                np.random.default_rng(0),
                smooth_track(made_up()),
                [0.0, 60.0],
                altitude_offset=-1500.0,
            )

    def test_radar_sees_true_geometry(self):
        track = made_up()
        radar = (50.05, 4.95, 100.0)
        seen = from_radar(smooth_track(track, cutoff=5.0), radar, track.time)
        enu = pymap3d.geodetic2enu(track.latitude, track.longitude, track.altitude, *radar)
        error = (seen[:, POSITION] - np.stack(enu, axis=-1))[5:-5]  # ends are straightened
        assert np.abs(error).max() < 0.05
        slope = (seen[2:, POSITION] - seen[:-2, POSITION]) / 2.0
        assert np.abs(slope - seen[1:-1, VELOCITY]).max() < 0.1

    def test_radar_at_the_origin_changes_nothing(self):
        smooth = smooth_track(made_up())
        states = smooth.states([50.0, 60.0])
        assert from_radar(smooth, smooth.origin, [50.0, 60.0]) == pytest.approx(states, abs=1e-6)

    @pytest.mark.parametrize("time", [[-1.0, 5.0], [295.0, 301.0]])
    def test_times_beyond_the_flight_are_refused(self, time):
        with pytest.raises(ValueError, match="lasts from 0 to 300 s"):
            from_radar(smooth_track(made_up()), (50.0, 5.0, 0.0), time)

    def test_radar_off_the_earth_is_refused(self):
        with pytest.raises(ValueError, match=r"latitude of the radar.* got 120"):
            from_radar(smooth_track(made_up()), (120.0, 5.0, 0.0), [0.0])

    @pytest.mark.parametrize("cutoff", [0.0, -1.0, 301.0, float("nan")])
    def test_unusable_cutoff_is_refused(self, cutoff):
        with pytest.raises(
            ValueError, match="cutoff must be positive and at most the flight's 300"
        ):
            smooth_track(made_up(), cutoff)

    def test_two_aircraft_in_one_file_are_refused(self):
        track = made_up()
        mixed = track.latitude.copy()
        mixed[::9] += 0.5
        with pytest.raises(ValueError, match="mixes aircraft"):
            smooth_track(Track(track.time, mixed, track.longitude, track.altitude))


class TestDisorders:
    """Simulated flights with what spoils recorded ones, against their known truth."""

    @pytest.mark.parametrize(
        ("spoilt", "most"),
        [  # the error that is left, rms, as a share of the reports'
            ({"density": "1"}, 0.8),
            ({"density": "4", "jitter": 15.0}, 0.7),
            ({"density": "mixed"}, 1.0),
            ({"density": "1", "stamps": "whole"}, 0.3),
            ({"density": "4", "stamps": "whole"}, 0.9),
            ({"density": "mixed", "stamps": "whole"}, 1.0),
            ({"density": "4", "late": 0.1}, 0.3),
            ({"density": "4", "late": 0.1, "stamps": "whole"}, 0.6),
            ({"density": "1", "stale": 0.3}, 0.1),
            ({"density": "mixed", "stamps": "whole", "late": 0.1, "stale": 0.1}, 0.2),
        ],
    )
    def test_error_after_smoothing_is_below_the_reports_jitter(self, spoilt, most):
        track = disordered.reports(**spoilt)
        smooth = smooth_track(track, origin=disordered.PLACE)
        time = np.arange(15.0, smooth.duration - 15.0)
        smoothed = smooth.states(time)[:, POSITION]
        enu = pymap3d.geodetic2enu(
            track.latitude, track.longitude, track.altitude, *disordered.PLACE
        )
        left = disordered.error(time + track.time.min(), smoothed)
        assert left < most * disordered.error(track.time, np.stack(enu, axis=-1))

    def test_accurate_reports_stay(self):
        """Turns and accelerations come through where nothing jitters."""
        track = disordered.reports(density="1", jitter=0.0)
        smooth = smooth_track(track, origin=disordered.PLACE)
        time = np.arange(15.0, smooth.duration - 15.0)
        assert disordered.error(time + track.time[0], smooth.states(time)[:, POSITION]) < 3.5

    @pytest.mark.parametrize("density", ["1", "mixed"])
    def test_flown(self, density, tmp_path):
        track = disordered.reports(density, stamps="whole", late=0.05, stale=0.05)
        path = tmp_path / "flight.csv"
        columns = (track.time, track.latitude, track.longitude, track.altitude / 0.3048)
        rows = [",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
        path.write_text("\n".join(["t,lat,lon,alt_ft", *rows]))
        env = gym.make("kfenv/RadarTracking-v0", track=str(path), duration=40.0, rate=2.0)
        _, info = env.reset(seed=0)
        assert 100.0 < info["truth"][6] < 8000.0

    def test_a_small_aircraft_may_turn_fast(self):
        """Turns of 6 deg/s at 70 m/s, reported each 5 s: a cutoff of 25 s would cut them."""
        time = np.arange(0.0, 600.0, 5.0)
        fine = np.arange(0.0, 600.0, 0.05)
        heading = np.radians(np.cumsum(np.where(fine % 100.0 < 60.0, 6.0, 0.0)) * 0.05)
        east, north = np.cumsum(70.0 * 0.05 * np.stack((np.sin(heading), np.cos(heading))), axis=1)
        enu = np.stack([np.interp(time, fine, axis) for axis in (east, north, 0.0 * fine)])
        noise = 3.0 * np.random.default_rng(0).standard_normal(enu.shape)
        track = Track(time, *pymap3d.enu2geodetic(*(enu + noise), 50.0, 5.0, 1000.0))
        left = []
        for cutoff in (None, 25.0):
            smooth = smooth_track(track, cutoff, origin=(50.0, 5.0, 1000.0))
            away = (smooth.states(time[:-2])[:, POSITION] - enu.T[:-2])[3:-3]
            left.append(np.sqrt(np.mean(np.sum(away**2, axis=1))))
            assert smooth.rejected <= 2 or cutoff == 25.0
        assert left[0] < 26.0 and left[0] < 0.8 * left[1]

    def test_repeated_times_are_one_report(self):
        track = made_up(step=0.5)
        whole = Track(np.floor(track.time), *(
            column for column in (track.latitude, track.longitude, track.altitude)
        ))  # fmt: skip
        states = smooth_track(whole, origin=(50.0, 5.0, 0.0)).states([100.0, 200.0])
        exact = smooth_track(track, origin=(50.0, 5.0, 0.0)).states([100.25, 200.25])
        assert np.abs(states - exact)[:, POSITION].max() < 0.5

    def test_rows_out_of_order_are_sorted(self):
        track = made_up()
        order = np.arange(track.time.size)
        order[50:53] = order[50:53][::-1]
        columns = track.time, track.latitude, track.longitude, track.altitude
        mixed, plain = (
            smooth_track(Track(*(column[rows] for column in columns)), origin=(50.0, 5.0, 0.0))
            for rows in (order, slice(None))
        )
        assert mixed.states([50.0]) == pytest.approx(plain.states([50.0]))

    def test_standing_aircraft_repeats_its_position_rightly(self):
        track = disordered.reports("4", jitter=0.0)
        smooth = smooth_track(track)
        assert smooth.rejected == 0
        assert smooth.states([20.0, 40.0])[:, VELOCITY] == pytest.approx(0.0, abs=0.1)

    def test_limit_is_local(self):
        """What is far off for an aircraft on its stand is nothing special in cruise."""
        track = disordered.reports("4", stamps="whole", jitter=1.0)
        latitude = track.latitude.copy()
        latitude[8] += 90.0 / 111_000.0
        smooth = smooth_track(Track(track.time, latitude, track.longitude, track.altitude))
        assert smooth.rejected == 1

    def test_too_high_for_the_radar_says_what_would_fit(self):
        track = made_up()
        high = Track(track.time, track.latitude, track.longitude, track.altitude + 17_000.0)
        rng, smooth = np.random.default_rng(0), smooth_track(high)
        with pytest.raises(ValueError, match=r"altitude_offset of -\d+ m would fit") as caught:
            window(rng, smooth, [0.0, 60.0])
        offset = float(re.search(r"an altitude_offset of (-\d+) m would", str(caught.value))[1])
        assert window(rng, smooth, [0.0, 60.0], offset)[0, 6] == pytest.approx(
            18_000.0 + offset, abs=200.0
        )

    def test_gap_is_bridged_on_request(self):
        track = made_up(duration=300.0, step=30.0)
        with pytest.raises(ValueError, match=r"lasts 0 s without .* longest_gap=30 or"):
            window(np.random.default_rng(0), smooth_track(track), [0.0, 60.0])
        sparse = np.append(track.time, 1300.0 + track.time)  # a gap that need not be bridged
        twice = Track(sparse, *(np.tile(column, 2) for column in (
            track.latitude, track.longitude, track.altitude)))  # fmt: skip
        with pytest.raises(ValueError, match=r"longest_gap=30 or"):
            window(np.random.default_rng(0), smooth_track(twice), [0.0, 60.0])
        bridged = smooth_track(track, longest_gap=30.0)
        assert len(window(np.random.default_rng(0), bridged, [0.0, 60.0])) == 2
