"""Files of flights: what is read, what is refused, and the options that go with them."""

import gymnasium as gym
import numpy as np
import pytest

from kfenv.scenarios.reports import Track, load_track
from kfenv.scenarios.tracks import flight


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


def test_altitude_in_feet(file):
    track = load_track(file(text(header="t,lat,lon,alt_ft")))
    assert track.altitude == pytest.approx(304.8)


def test_order_and_further_columns_do_not_matter(file):
    rows = "".join(f"{1000 + i},x,{5 + i},{50 - i},{i}\n" for i in range(10))
    track = load_track(file("﻿alt_m,callsign,lon,lat, t\n" + rows))
    assert track.time.tolist() == list(range(10))
    assert track.latitude[:2].tolist() == [50.0, 49.0]
    assert track.longitude[:2].tolist() == [5.0, 6.0]
    assert track.altitude[:2].tolist() == [1000.0, 1001.0]


def test_missing_file_is_named(tmp_path):
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
def test_bad_file_is_refused_by_name(file, content, complaint):
    path = file(content)
    with pytest.raises(ValueError, match=complaint) as caught:
        load_track(path)
    assert str(path) in str(caught.value)


def test_arrays_of_different_length_are_refused():
    ten = np.arange(10.0)
    with pytest.raises(ValueError, match="'lon' has shape"):
        Track(ten, ten, ten[:9], ten)


def test_changed_file_is_read_again(file, tmp_path, monkeypatch):
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
def test_options_go_with_a_track(env_id, wrong):
    with pytest.raises(ValueError, match="goes with a real flight: give a track too"):
        gym.make(f"kfenv/{env_id}-v0", **wrong)


@pytest.mark.parametrize("name", ["cutoff", "longest_gap", "altitude_offset"])
def test_options_are_numbers(name, file):
    with pytest.raises(ValueError, match=f"{name} must be a number"):
        gym.make("kfenv/RadarTracking-v0", track=str(file(text())), **{name: "high"})
