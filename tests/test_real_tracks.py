"""Real flights: the smoothing takes jitter out and leaves turns in; windows; bad files.

What needs the flights themselves reads them from beside the repository and is skipped,
saying so, where they are not.
"""

import re
from functools import cache
from pathlib import Path

import disordered_flights as disordered
import gymnasium as gym
import numpy as np
import pymap3d
import pytest

from kfenv.scenarios.coverage import in_coverage
from kfenv.scenarios.reports import Track, load_track
from kfenv.scenarios.tracks import flight, from_radar, smooth_track, window

TRACKS = Path(__file__).parents[1].parent / "shared" / "data" / "tracks"
FLIGHTS = ("af393322_departure.csv", "afr787v_39c424.csv", "transavia737_484506.csv")
POSITION, VELOCITY, ACCELERATION = slice(0, 9, 3), slice(1, 9, 3), slice(2, 9, 3)
GRAVITY = 9.81

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


def turn_rate(states):
    vx, vy, ax, ay = states[:, 1], states[:, 4], states[:, 2], states[:, 5]
    return (vy * ax - vx * ay) / (vx**2 + vy**2)


def made_up(duration=300.0, step=1.0, jitter=0.0, seed=0):
    """A flight at 100 m/s and 1000 m whose turns of 1.5 deg/s swing with a period of 150 s."""
    time = np.arange(0.0, duration + 0.5 * step, step)
    omega = 2.0 * np.pi / 150.0
    heading = np.radians(1.5) / omega * (1.0 - np.cos(omega * time))
    fine = np.linspace(0.0, time[-1], 20 * time.size)
    direction = np.interp(fine, time, heading)
    travelled = [
        np.concatenate([[0.0], np.cumsum(100.0 * part(direction[:-1]) * np.diff(fine))])
        for part in (np.sin, np.cos)
    ]
    enu = np.array([np.interp(time, fine, part) for part in travelled] + [np.zeros(time.size)])
    enu += jitter * np.random.default_rng(seed).standard_normal(enu.shape)
    latitude, longitude, _ = pymap3d.enu2geodetic(*enu, 50.0, 5.0, 1000.0)
    return Track(time, latitude, longitude, 1000.0 + enu[2])


def text(rows=12, header="t,lat,lon,alt_m", **replaced):
    """A CSV file of a straight flight with some of its lines replaced, counted from 1."""
    lines = [header] + [f"{i},{50 + 1e-3 * i:.4f},5.0,1000" for i in range(rows)]
    for line, new in replaced.items():
        lines[int(line.removeprefix("line")) - 1] = new
    return "\n".join(lines) + "\n"


def in_units(factor):
    """A straight flight at 111 m/s whose times are in other units than seconds."""
    return text(
        rows=0, line1="t,lat,lon,alt_m\n" + "\n".join(
            f"{factor * i:.0f},{50 + 1e-3 * i:.4f},5.0,1000" for i in range(20)
        )
    )  # fmt: skip


def climb():
    """A flight whose altitudes are in feet, which nobody says."""
    return "t,lat,lon,alt_m\n" + "".join(
        f"{i},{50 + 1e-3 * i:.4f},5.0,{1000 + 25 * i}\n" for i in range(40)
    )


@pytest.fixture
def file(tmp_path):
    def write(content):
        path = tmp_path / "flight.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


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

    def test_changed_file_is_read_again(self, file, tmp_path, monkeypatch):
        path = file(text(rows=30))
        assert flight(path).duration == 29.0
        file(text(rows=40))
        assert flight(path).duration == 39.0
        (tmp_path / "other").mkdir()
        monkeypatch.chdir(tmp_path)
        assert flight("flight.csv").duration == 39.0
        monkeypatch.chdir(tmp_path / "other")
        with pytest.raises(FileNotFoundError, match=r"other/flight\.csv"):
            flight("flight.csv")

    @pytest.mark.parametrize("env_id", ["RadarTracking", "RadarValidation", "GnssTracking"])
    @pytest.mark.parametrize("wrong", [{"cutoff": 20.0}, {"longest_gap": 60.0}])
    def test_options_go_with_a_track(self, env_id, wrong):
        with pytest.raises(ValueError, match="goes with a real flight: give a track too"):
            gym.make(f"kfenv/{env_id}-v0", **wrong)

    @pytest.mark.parametrize("name", ["cutoff", "longest_gap", "altitude_offset"])
    def test_options_are_numbers(self, name, file):
        with pytest.raises(ValueError, match=f"{name} must be a number"):
            gym.make("kfenv/RadarTracking-v0", track=str(file(text())), **{name: "high"})


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


class TestFiles:
    def test_altitude_in_feet(self, file):
        track = load_track(file(text(header="t,lat,lon,alt_ft")))
        assert track.altitude == pytest.approx(304.8)

    def test_order_and_further_columns_do_not_matter(self, file):
        rows = "".join(f"{1000 + i},x,{5 + i},{50 - i},{i}\n" for i in range(10))
        track = load_track(file("﻿alt_m,callsign,lon,lat, t\n" + rows))
        assert track.time.tolist() == list(range(10))
        assert track.latitude[:2].tolist() == [50.0, 49.0]
        assert track.longitude[:2].tolist() == [5.0, 6.0]
        assert track.altitude[:2].tolist() == [1000.0, 1001.0]

    def test_missing_file_is_named(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"no track file .*nowhere\.csv"):
            load_track(tmp_path / "nowhere.csv")

    @pytest.mark.parametrize(
        ("content", "complaint"),
        [
            (b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "not a CSV text file"),
            ("", "column 't' is missing"),
            (text(header="t,lat,lon,alt"), "column 'alt_m' is missing; rename 'alt'"),
            (text(header="time,lat,lon,alt_m"), "column 't' is missing"),
            (text(rows=9), "at least 10 rows, got 9"),
            (text(rows=0), "at least 10 rows, got 0"),
            (text(line5="3,fifty,5.0,1000"), "column 'lat' in line 5 is no number: 'fifty'"),
            (text(line5="3,,5.0,1000"), "column 'lat' in line 5 is no number: ''"),
            (text(line5="3,50.003"), "column 'lon' in line 5 is no number: ''"),
            (text(line5="3,50.003,nan,1000"), "column 'lon' in data row 4 is nan"),
            (text(line5="3,50.003,5.0,inf"), "column 'alt_m' in data row 4 is inf"),
            (text(line5="3,95,5.0,1000"), "lat must be within 90 deg of zero, got 95"),
            (text(line5="3,50,400,1000"), "lon must be within 360 deg of zero, got 400"),
            (text(line5="-86397,50.003,5.0,1000"), "'t' decreases by 86399 s in data row 4; sort"),
            (
                text().replace(",1000", ",33000"),
                "'alt_m' reaches 33000 m: .* name the column 'alt_ft'",
            ),
            (in_units(1e3), "'t' is in milliseconds, .* divide the column by 1e\\+03"),
            (in_units(1e6), "'t' is in microseconds"),
            (in_units(1e9), "'t' is in nanoseconds"),
            (climb(), "'alt_m' is always a multiple of 25: altitudes in feet"),
        ],
    )
    def test_bad_file_is_refused_by_name(self, file, content, complaint):
        path = file(content)
        with pytest.raises(ValueError, match=complaint) as caught:
            load_track(path)
        assert str(path) in str(caught.value)

    def test_arrays_of_different_length_are_refused(self):
        ten = np.arange(10.0)
        with pytest.raises(ValueError, match="'lon' has shape"):
            Track(ten, ten, ten[:9], ten)
