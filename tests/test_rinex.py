"""RINEX 2 and 3 are read alike; what is wrong with a file is one sentence with its line."""

from dataclasses import replace

import numpy as np
import pytest
from rinex_files import (
    BROADCAST,
    header_line,
    needs_rinex,
    write_navigation,
    write_observations,
)
from station import broadcast, observed

from kfenv.scenarios.gnss.ephemeris import read_navigation
from kfenv.scenarios.gnss.fix import signals
from kfenv.scenarios.gnss.rinex import read_observations

EPOCH = " 05  4  2  0  0  0.0000000  0  2G 3R 7"
HEADER = (
    header_line("     2.11           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE")
    + header_line(" -3978242.4348  3382841.1715  3649902.7667", "APPROX POSITION XYZ")
    + header_line("     6    L1    C1    L2    P2    D1    S1", "# / TYPES OF OBSERV")
    + header_line("  2005     4     2     0     0    0.0000000     GPS", "TIME OF FIRST OBS")
    + header_line("", "END OF HEADER")
)
ROWS = (
    " -41706426.668 7  24801780.917   -32471209.7934   24801779.3144       1234.567",
    "        45.000",
)
GOOD = HEADER + "\n".join((EPOCH, *ROWS, *ROWS)) + "\n"


def written(folder, text, name="log.05o"):
    path = folder / name
    path.write_text(text)
    return path


@needs_rinex
def test_the_real_file_is_read_as_it_stands():
    found = observed()
    assert found.time.shape == (120,) and found.codes == {"G": "C1"} and not found.moved
    assert found.time[0] == 1316 * 604_800 + 6 * 86_400  # GPS week 1316, Saturday
    assert tuple(found.satellite) == (1, 3, 4, 7, 8, 11, 19, 20, 23, 24, 27, 28)
    assert found.pseudorange[0, 1] == 24801780.917 and found.pseudorange[-1, -1] == 19618895.340
    # how many satellites each epoch announces, summed over the file
    assert np.isfinite(found.pseudorange).sum() == 42 * 8 + 77 * 9 + 10
    assert np.isnan(found.doppler).all()
    np.testing.assert_array_equal(found.position, (-3978242.4348, 3382841.1715, 3649902.7667))


@needs_rinex
def test_the_real_navigation_file_is_read_as_it_stands():
    found = broadcast()
    assert found.klobuchar[0] == 1.118e-8 and found.klobuchar[-1] == -1.311e5
    first = np.flatnonzero(found.satellite == 1)[0]
    assert found.value["af0"][first] == 3.966595977540e-4
    assert found.value["root_a"][first] == 5153.636478420
    assert found.value["tgd"][first] == -3.259629011150e-9
    assert (np.abs(found.time - found.clock_time) < 7200.0).all()


@needs_rinex
def test_rinex_3_says_the_same_as_rinex_2(tmp_path):
    again = read_observations(write_observations(tmp_path / "log.rnx", observed()))
    np.testing.assert_allclose(again.time, observed().time, rtol=0.0, atol=2e-7)
    np.testing.assert_array_equal(again.pseudorange, observed().pseudorange)
    np.testing.assert_array_equal(again.satellite, observed().satellite)
    assert again.codes == {"G": "C1C"}
    orbits = read_navigation(write_navigation(tmp_path / "nav.rnx", BROADCAST))
    np.testing.assert_array_equal(orbits.satellite, broadcast().satellite)
    np.testing.assert_array_equal(orbits.klobuchar, broadcast().klobuchar)
    np.testing.assert_array_equal(orbits.time, broadcast().time)
    for name, value in broadcast().value.items():
        np.testing.assert_array_equal(orbits.value[name], value, err_msg=name)


def test_rinex_2_with_two_lines_a_satellite_other_systems_doppler_and_events(tmp_path):
    event = "                            4  1\nA REMARK                                 COMMENT\n"
    later = GOOD[len(HEADER) :].replace("0  0.0000000  0  2", "0 30.0000000  0  2")
    found = read_observations(written(tmp_path, GOOD + event + later))
    assert tuple(found.satellite) == (3,) and not found.moved
    np.testing.assert_array_equal(found.pseudorange, [[24801780.917]] * 2)
    np.testing.assert_array_equal(found.doppler, [[1234.567]] * 2)
    np.testing.assert_array_equal(np.diff(found.time), [30.0])


def test_more_than_twelve_satellites_go_on_in_a_second_line(tmp_path):
    epoch = EPOCH[:29] + " 13" + "".join(f"G{prn:2d}" for prn in range(1, 13))
    text = HEADER + "\n".join((epoch, " " * 32 + "G13", *(ROWS * 13))) + "\n"
    found = read_observations(written(tmp_path, text))
    assert tuple(found.satellite) == tuple(range(1, 14))
    assert np.isfinite(found.pseudorange).all()


def test_zero_and_blank_mean_missing(tmp_path):
    zero = ROWS[0].replace("24801780.917", "       0.000")
    found = read_observations(written(tmp_path, GOOD.replace(ROWS[0], zero, 1) + "\n"))
    assert np.isnan(found.pseudorange).all() and np.isfinite(found.doppler).all()


COMMENT = header_line("caf\u00e9 \u2026 \u00c5", "COMMENT")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("last", ["", "\x1a", "\x1a\r\n\x1a"])
def test_lines_end_as_they_like_and_comments_hold_any_letters(tmp_path, end, encoding, last):
    """Byte 0x85, an ellipsis in cp1252 and part of letters in UTF-8, ends no line."""
    event = "                            4  1\n" + COMMENT
    text = GOOD.replace(HEADER[81:], COMMENT + HEADER[81:]) + event
    text += GOOD[len(HEADER) :].replace("0  0.0000000  0  2", "0 30.0000000  0  2")
    path = tmp_path / "log.05o"
    path.write_bytes((text.replace("\n", end) + last).encode(encoding))
    found = read_observations(path)
    np.testing.assert_array_equal(found.pseudorange, [[24801780.917]] * 2)


def test_rinex_3_epochs_may_lack_their_first_blank(tmp_path):
    text = header_line("     3.02           OBSERVATION DATA    G", "RINEX VERSION / TYPE")
    text += header_line("G    1 C1C", "SYS / # / OBS TYPES") + header_line("", "END OF HEADER")
    text += ">2005 04 02 00 00  0.0000000  0  1\nG03  24801780.917\n"
    text += "> 2005 04 02 00 00 30.0000000  0  1\nG03  24801780.917\n"
    found = read_observations(written(tmp_path, text))
    np.testing.assert_array_equal(np.diff(found.time), [30.0])


def test_each_system_has_columns_of_its_own(tmp_path):
    text = header_line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    for row in ("G    3 C1C D1C S1C", "E    2 S1X C1X", "C    2 C2I D2I", "R    1 C1C"):
        text += header_line(row, "SYS / # / OBS TYPES")
    text += header_line("", "END OF HEADER") + "> 2020 10 30 00 00  0.0000000  0  4\n"
    text += f"G03{20e6:14.3f}  {-5.0:14.3f}  {45.0:14.3f}\n" + f"R05{19e6:14.3f}\n"
    text += f"E11{40.0:14.3f}  {24e6:14.3f}\n" + f"C21{23e6:14.3f}  {7.0:14.3f}\n"
    found = read_observations(written(tmp_path, text))
    assert found.names.tolist() == ["G03", "E11", "C21"]
    assert found.codes == {"G": "C1C", "E": "C1X", "C": "C2I"}
    np.testing.assert_array_equal(found.pseudorange, [[20e6, 24e6, 23e6]])
    np.testing.assert_array_equal(found.doppler, [[-5.0, np.nan, 7.0]])
    np.testing.assert_array_equal(found.strength, [[45.0, 40.0, np.nan]])
    assert found.frequency[2] == 1561.098e6 and found.frequency[1] == found.frequency[0]


@needs_rinex
def test_a_navigation_file_of_part_of_the_log_says_so():
    some = broadcast().satellite < 12
    few = replace(
        broadcast(), satellite=broadcast().satellite[some], time=broadcast().time[some],
        clock_time=broadcast().clock_time[some],
        value={name: column[some] for name, column in broadcast().value.items()},
    )  # fmt: skip
    share = 100.0 * np.mean(
        few.choose(observed().satellite, observed().time[:, None] + 0.0 * observed().satellite)[
            np.isfinite(observed().pseudorange)
        ]
        < 0
    )
    with pytest.warns(UserWarning, match=rf"ephemerides from .* to .*: {share:.0f} % of them have"):
        signals(observed(), few)
    late = replace(observed(), time=observed().time + 30 * 86_400.0)
    with pytest.raises(ValueError, match=r"from 2005-05-02 00:00 to 2005-05-02 .*do not belong"):
        signals(late, broadcast())


@needs_rinex
def test_the_whole_days_file_says_nothing(recwarn):
    signals(observed(), broadcast())
    assert not recwarn


def test_a_start_of_motion_is_told(tmp_path):
    event = "                            2  0\n"
    later = GOOD[len(HEADER) :].replace("0  0.0000000  0  2", "0 30.0000000  0  2")
    assert read_observations(written(tmp_path, GOOD + event + later)).moved


def test_the_antenna_stands_above_its_marker(tmp_path):
    offset = header_line("        1.5000        0.0000        0.0000", "ANTENNA: DELTA H/E/N")
    marker = read_observations(written(tmp_path, GOOD)).position
    above = read_observations(written(tmp_path, offset.join(GOOD.split("     6    L1", 1)).replace(
        offset, offset + "     6    L1", 1))).position  # fmt: skip
    np.testing.assert_allclose(np.linalg.norm(above - marker), 1.5, atol=1e-6)
    assert np.linalg.norm(above) > np.linalg.norm(marker) + 1.49


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("OBSERVATION DATA ", "NAVIGATION DATA  "), "line 1: an observation file (type 'O')"),
        (("     2.11", "     4.00"), "line 1: RINEX version 4.00 is not read"),
        (("M (MIXED)", "R (GLONA)"), "line 1: only GPS, alone or mixed with others, is read"),
        (("RINEX VERSION / TYPE", "CRINEX VERS   / TYPE"), "decompress it with crx2rnx"),
        (("RINEX VERSION / TYPE", "SOMETHING"), "line 1: a RINEX file begins with"),
        (("# / TYPES OF OBSERV", "COMMENT"), "no line '# / TYPES OF OBSERV'"),
        (("     6    L1", "     7    L1"), "line 3: 7 types of observation are said, 6 listed"),
        (("    C1    L2    P2", "    C2    L2    P2"), "no GPS pseudorange on L1, only L1, C2"),
        (
            (
                "# / TYPES OF OBSERV\n",
                "# / TYPES OF OBSERV\n" + header_line("G   10", "SYS / SCALE FACTOR"),
            ),
            "line 4: observations with a scale factor",
        ),
        (("     GPS", "     GLO"), "line 4: GPS times are wanted, the file has GLO"),
        (("END OF HEADER", "COMMENT"), "before the end of its header"),
        ((" -3978242.4348", " -3978x42.4348"), "line 2: APPROX POSITION XYZ should be a number"),
        ((" -3978242.4348", "           NaN"), "line 2: APPROX POSITION XYZ should be a number"),
        ((EPOCH, EPOCH.replace(" 4 ", "14 ")), "line 6: the time of the epoch is no date"),
        ((EPOCH, EPOCH.replace("  2G 3", "  xG 3")), "line 6: the epoch's number of satellites"),
        ((EPOCH, EPOCH.replace("G 3", "G x")), "line 6: a satellite's number should be a whole"),
        (("24801780.917", "2480178x.917"), "line 8: a pseudorange should be a number"),
        (("  24801780.917", " 24801780.917 "), "line 8: a pseudorange should fill 14 columns"),
        ((GOOD[len(HEADER) :], EPOCH), "ends after line 6, before a satellite's observations"),
        ((GOOD[len(HEADER) :], f"{EPOCH}\n{ROWS[0][:28]}"), "ends after line 7"),
        ((GOOD[len(HEADER) :], ""), "holds no GPS observation"),
        ((GOOD, GOOD + GOOD[len(HEADER) :]), "not later than the one before"),
        ((GOOD, GOOD + " " * 28 + f"4  1\n{HEADER.splitlines()[2]}\n"), "types of observation ch"),
    ],
)
def test_a_malformed_observation_file_is_one_sentence(tmp_path, change, said):
    assert change[0] in GOOD
    path = written(tmp_path, GOOD.replace(*change, 1))
    with pytest.raises(ValueError) as caught:
        read_observations(path)
    message = str(caught.value)
    assert said in message and str(path) in message
    assert message.endswith(".") and "\n" not in message


def test_a_value_cut_short_is_not_read_as_another_one(tmp_path):
    """What a plain conversion takes for 248017 m is the beginning of 24801780.917 m."""
    path = written(tmp_path, HEADER + f"{EPOCH}\n{ROWS[0][:24]}\n{ROWS[1]}\n")
    with pytest.raises(ValueError, match="should fill 14 columns with three decimals"):
        read_observations(path)


def test_no_file_and_no_text_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="There is no RINEX file"):
        read_observations(tmp_path / "none.05o")
    (tmp_path / "log.gz").write_bytes(b"\x1f\x8b\0\xff\0")
    with pytest.raises(ValueError, match="decompress it first"):
        read_observations(tmp_path / "log.gz")


@needs_rinex
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("N: GPS NAV DATA", "G: GLO NAV DATA"), "line 1: a navigation file (type 'N')"),
        (("    1.1180D-08", "    1.1x80D-08"), "line 8: ION ALPHA should be a number"),
        (("5.153636478420D+03", "5.153636478420D+02"), "this ephemeris is no satellite's orbit"),
        (("-5.218750000000D+01", "-5.21875000x000D+01"), "line 14: crs should be a number"),
        (("-5.218750000000D+01", "                NaN"), "line 14: crs should be a number"),
        (("-5.218750000000D+01", "-5.21875000000D+999"), "line 14: crs should be a number"),
        ((" 5.256000000000D+05", " 6.048010000000D+05"), "toe = 604801 s of this ephemeris is no"),
        ((" 1 05  4  2  2", " 1 05 14  2  2"), "line 13: the time of the clock is no date"),
    ],
)
def test_a_malformed_navigation_file_is_one_sentence(tmp_path, change, said):
    text = "".join(BROADCAST.read_text().splitlines(keepends=True)[:20])
    assert change[0] in text
    path = written(tmp_path, text.replace(*change, 1), "nav.05n")
    with pytest.raises(ValueError) as caught:
        read_navigation(path)
    assert said in str(caught.value) and str(path) in str(caught.value)


@needs_rinex
def test_a_navigation_file_that_is_cut_off_says_so(tmp_path):
    lines = BROADCAST.read_text().splitlines(keepends=True)[:20]
    with pytest.raises(ValueError, match="ends after line 16, before the end of an ephemeris"):
        read_navigation(written(tmp_path, "".join(lines[:16])))
    lines[16] = lines[16][:40] + "\n"  # within the exponent of the second number
    with pytest.raises(ValueError, match="line 17: crc should fill 19 columns, but reads"):
        read_navigation(written(tmp_path, "".join(lines)))


@needs_rinex
def test_unhealthy_satellites_are_left_out(tmp_path):
    lines = BROADCAST.read_text().splitlines(keepends=True)[:28]
    assert len(read_navigation(written(tmp_path, "".join(lines))).satellite) == 2
    row = lines[18]  # accuracy and health of the first ephemeris
    lines[18] = row[:22] + " 6.300000000000D+01" + row[41:]
    assert tuple(read_navigation(written(tmp_path, "".join(lines))).satellite) == (3,)
