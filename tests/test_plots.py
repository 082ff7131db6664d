"""A file of radar plots at the door: what is served, and what is refused and how (about 2 s)."""

import numpy as np
import pytest
from plot_files import written
from test_bad_input import complaint

from kfenv.models.position import position
from kfenv.models.radar import radar
from kfenv.scenarios.clock import seconds
from kfenv.scenarios.radar.plots import read_plots

HEADER = "t,range_m,azimuth_deg,elevation_deg"
TIME = 0.5 * np.arange(400)
# Straight past the radar at 200 m/s
EAST, NORTH, UP = -15_000.0 + 190.0 * TIME, 6_000.0 + 60.0 * TIME, np.full(400, 3_000.0)
VALUE = np.stack(
    [
        np.sqrt(EAST**2 + NORTH**2 + UP**2),
        np.arctan2(EAST, NORTH),
        np.arctan2(UP, np.hypot(EAST, NORTH)),
    ],
    axis=1,
)
UNIT = np.array([1.0, np.degrees(1.0), np.degrees(1.0)])


def read(tmp_path, header, rows):
    path = tmp_path / "plots.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return read_plots(path, radar())


def rows(time=TIME, value=VALUE * UNIT):
    return [",".join(f"{x:.12g}" for x in row) for row in np.column_stack([time, value])]


def said(tmp_path, header, lines):
    return complaint(ValueError, read, tmp_path, header, lines)


def test_what_is_written_is_read(tmp_path):
    plots = read_plots(written(tmp_path / "plots.csv", radar(), TIME, VALUE), radar())
    np.testing.assert_array_equal(plots.time, TIME)
    np.testing.assert_allclose(plots.value, VALUE, rtol=1e-15)
    assert np.isnan(plots.deviation).all() and plots.complete.all() and plots.repeated == 0


def test_positions_are_plots_too(tmp_path):
    value = np.stack([EAST, NORTH, UP], axis=1)
    path = written(tmp_path / "p.csv", position(), TIME, value, np.full((400, 3), 2.0))
    plots = read_plots(path, position())
    np.testing.assert_array_equal(plots.value, value)
    assert (plots.deviation == 2.0).all()


def test_disorder_repetition_gaps_and_other_columns_are_served(tmp_path):
    lines = rows()
    lines[7] = "3.5,,,"  # looked, and saw nothing
    lines[8] = f"4.0,{VALUE[8, 0]},nan,"
    lines = [f"{line},AB123" for line in [*lines[::-1], lines[20]]]
    plots = read(tmp_path, f"{HEADER},callsign", lines)
    np.testing.assert_array_equal(plots.time, TIME)
    assert plots.repeated == 1 and not plots.complete[7] and not plots.complete[8]
    assert np.isfinite(plots.value[8, 0]) and plots.complete.sum() == 398


@pytest.mark.parametrize(("texts", "passed"), [
    (("12:00:00", "12:00:01.25"), 1.25),
    (("2024-02-29T23:59:59Z", "2024-03-01T00:00:00.5Z"), 1.5),
    (("2024-02-29 12:00:00+01:00", "2024-02-29T11:00:02"), 2.0),
    (("1.7e9", "1700000000.5"), 0.5),
])  # fmt: skip
def test_times_are_read_in_several_forms(texts, passed):
    first, second = map(seconds, texts)
    assert second - first == passed


def test_a_clock_with_dates_gives_the_same_plots(tmp_path):
    stamps = np.datetime64("2024-05-01T09:00:00", "ms") + (1000 * TIME).astype("timedelta64[ms]")
    cells = [line.split(",", 1)[1] for line in rows()]
    lines = [f"{stamp}Z,{rest}" for stamp, rest in zip(stamps, cells, strict=True)]
    np.testing.assert_allclose(np.diff(read(tmp_path, HEADER, lines).time), 0.5, atol=1e-6)


def changed(row, column, to):
    value = (VALUE * UNIT).copy()
    value[row, column] = to
    return rows(value=value)


RADIANS = rows(value=VALUE)
REFUSED = {
    "no header": (rows()[0], rows()[1:], "put t,range_m,azimuth_deg,elevation_deg above it"),
    "missing": ("t,range_m,azimuth_deg", rows(), "column 'elevation_deg' missing"),
    "another unit": (HEADER.replace("_m", "_km"), rows(), "'range_km' is unknown; rename it"),
    "deviation's name": (f"{HEADER},azimuth_std", rows(), "rename it 'azimuth_std_deg'"),
    "infinite": (HEADER, changed(3, 0, np.inf), "'range_m' in data row 4 is inf"),
    "behind": (HEADER, changed(5, 0, -1.0), "in data row 6 is -1; ranges are positive"),
    "over the top": (HEADER, changed(9, 2, 91.0), "'elevation_deg' in data row 10 is 91"),
    "text": (HEADER, ["one,2,3,4"], "column 't' in line 2 is no time (seconds, hh:mm:ss or ISO"),
    "few": (HEADER, rows()[:9], "9 of its 9 rows tell every channel"),
    "two targets": (HEADER, [*rows(), "5,9000,10,10"], "data rows 11 and 401 have the same 't'"),
    "a new day": (HEADER, rows(np.where(TIME > 100.0, TIME, TIME + 86e3)), "add a day's 86400 s"),
    "milliseconds": (HEADER, rows(1000.0 * TIME), "advances by 500 from plot to plot"),
    "kilometres": (HEADER, rows(value=VALUE * UNIT * [1e-3, 1, 1]), "multiply them by 1000"),
    "radians": (HEADER, RADIANS, "multiply them by 180/pi"),
    "semicolons": (HEADER.replace(",", ";"), rows(), "columns are separated by ';'"),
    "cut off": (HEADER, [*rows()[:99], "49.5,12"], "line 101 has 2 cells and the first line 4"),
    "decimal commas": (HEADER, [x.replace(".", ",") for x in rows()], "points in decimals"),
    "too often": (HEADER, rows(0.01 * TIME), "thin them out"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_meant_is_refused_with_the_remedy(tmp_path, name):
    header, lines, expected = REFUSED[name]
    told = said(tmp_path, header, lines)
    assert expected in told and "plots.csv" in told and told.count("\n") == 0


def test_deviations_must_be_positive_where_something_was_measured(tmp_path):
    lines = [f"{line},20" for line in rows()]
    lines[3] = f"{rows()[3]},"
    assert "'range_std_m' in data row 4 is nan" in said(tmp_path, f"{HEADER},range_std_m", lines)


def test_all_that_is_wrong_is_told_at_once(tmp_path):
    value = (VALUE * UNIT).copy()
    value[3, 0], value[4, 2] = -2.0, 100.0
    with pytest.raises(ValueError) as caught:
        read(tmp_path, HEADER, rows(value=value)[:8])
    told = str(caught.value)
    assert told.count("\n") == 2 and all(word in told for word in ("range_m", "elevation", "8 of"))
    with pytest.raises(ValueError) as caught:
        read(tmp_path, "t,range_km,azimuth_deg", rows())
    told = str(caught.value)
    assert told.count("\n") == 1 and "'range_km'" in told and "'elevation_deg' missing" in told


def test_slow_and_small_targets_are_not_taken_for_wrong_units(tmp_path):
    """A ship a few degrees north of the radar, and a drone within a kilometre."""
    east, north = 500.0 + 3.0 * TIME, 20_000.0 + 4.0 * TIME
    ship = np.stack([np.hypot(east, north), np.arctan2(east, north), 0.0 * TIME], axis=1)
    rng = np.random.default_rng(0)
    noisy = ship + rng.standard_normal(ship.shape) * [20.0, 0.002, 0.002]
    assert read(tmp_path, HEADER, rows(value=noisy * UNIT)).complete.all()
    drone = np.stack([300.0 + 4.0 * TIME, 0.3 + 0.001 * TIME, 0.3 + 0.0 * TIME], axis=1)
    assert read(tmp_path, HEADER, rows(value=drone * UNIT)[:100]).complete.all()


def test_a_deviation_of_nothing_is_not_looked_at(tmp_path):
    lines = [f"{line},20" for line in rows()]
    lines[5] = "2.5,,,,-1"
    plots = read(tmp_path, f"{HEADER},range_std_m", lines)
    assert np.isnan(plots.deviation[5, 0]) and (plots.deviation[:5, 0] == 20.0).all()


def test_a_header_that_holds_the_whole_file_gives_a_short_complaint(tmp_path):
    told = said(tmp_path, ",".join([f"{HEADER},azimuth_std", *rows()]), rows())
    assert len(told) < 330


def test_numbers_that_no_radar_measures_are_refused(tmp_path):
    assert "metres within 1e+08" in said(tmp_path, HEADER, changed(2, 0, 1e9))
    lines = [f"{line},1e-300" for line in rows()]
    assert "from 1e-05 to 1e+06" in said(tmp_path, f"{HEADER},azimuth_std_deg", lines)
    moment = [*rows(), f"1e-300,{rows()[9].split(',', 1)[1]}"]
    assert "have the same 't'" in said(tmp_path, HEADER, moment)
