"""Broadcast orbits and single-epoch fixes, on an hour of a real GPS station.

The files lie beside the repository; without them what needs them is skipped, saying so.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rinex_files import needs_rinex
from station import broadcast, doppler, east_north_up, fixes, observed

from kfenv.models.gnss.orbits import EARTH_RATE, SPEED_OF_LIGHT, Constellation
from kfenv.scenarios.gnss.ephemeris import RELATIVITY, satellite_states
from kfenv.scenarios.gnss.fix import fix, signals

pytestmark = needs_rinex


def all_rows():
    """Every ephemeris, and times about its own."""
    row = np.arange(len(broadcast().time))
    return row[:, None], broadcast().time[:, None] + np.linspace(-7200.0, 7200.0, 9)


# ----- orbits and clocks ------------------------------------------------------------------


def test_velocity_is_the_rate_of_position_and_clock_rate_that_of_the_clock():
    row, time = all_rows()
    here = satellite_states(broadcast(), row, time)
    before, after = (satellite_states(broadcast(), row, time + h) for h in (-0.5, 0.5))
    assert np.abs(after.position - before.position - here.velocity).max() < 1e-4
    assert np.abs(after.clock - before.clock - here.clock_rate).max() < 1e-15


def test_without_corrections_the_orbit_is_that_of_the_almanac_model():
    """An implementation of its own: the constellation of the simulated environment."""
    v = broadcast().value
    plain = {name: np.zeros_like(value) for name, value in v.items()}
    kept = (
        "gravity",
        "earth_rate",
        "toe",
        "root_a",
        "e",
        "i0",
        "omega0",
        "omega_dot",
        "omega",
        "m0",
    )
    plain |= {name: v[name] for name in kept}
    second = np.mod(broadcast().time, 604_800.0)
    same = Constellation(
        broadcast().satellite, broadcast().time, v["root_a"] ** 2, v["e"], v["i0"],
        v["omega0"] - EARTH_RATE * second, v["omega_dot"], v["omega"], v["m0"],
        np.ones(second.size, bool),
    )  # fmt: skip
    row, time = all_rows()
    found = satellite_states(replace(broadcast(), value=plain), row, time)
    for k in range(time.shape[1]):
        position, velocity = same.states(time[:, k])
        np.testing.assert_allclose(found.position[:, k], position, rtol=0.0, atol=1e-4)
        np.testing.assert_allclose(found.velocity[:, k], velocity, rtol=0.0, atol=1e-6)


def test_orbits_look_like_gps_and_corrections_are_small():
    row, time = all_rows()
    states = satellite_states(broadcast(), row, time)
    radius = np.linalg.norm(states.position, axis=-1)
    assert radius.min() > 25.9e6 and radius.max() < 27.2e6
    inertial = states.velocity + EARTH_RATE * np.cross([0.0, 0.0, 1.0], states.position)
    speed = np.linalg.norm(inertial, axis=-1)
    assert speed.min() > 3.7e3 and speed.max() < 4.0e3


def test_neighbouring_ephemerides_agree_where_they_meet():
    """Half way between two updates, which were fitted to different hours."""
    apart, clocks = [], []
    for prn in np.unique(broadcast().satellite):
        rows = np.flatnonzero(broadcast().satellite == prn)
        rows = rows[np.argsort(broadcast().time[rows])]
        for before, after in pairwise(rows):
            gap = broadcast().time[after] - broadcast().time[before]
            if 3600.0 < gap <= 7200.0:
                middle = broadcast().time[before] + 0.5 * gap
                one = satellite_states(broadcast(), np.array(before), middle)
                other = satellite_states(broadcast(), np.array(after), middle)
                apart.append(np.linalg.norm(one.position - other.position))
                clocks.append(SPEED_OF_LIGHT * abs(one.clock - other.clock))
    assert len(apart) > 80
    assert np.median(apart) < 1.0 and max(apart) < 10.0
    assert np.median(clocks) < 1.0 and max(clocks) < 10.0


def test_the_relativistic_term_is_minus_two_r_dot_v_over_c_squared():
    row, time = all_rows()
    states = satellite_states(broadcast(), row, time)
    v, since = broadcast().value, time - broadcast().clock_time[row]
    polynomial = v["af0"][row] + v["af1"][row] * since + v["af2"][row] * since**2
    effect = states.clock - polynomial + v["tgd"][row]
    direct = -2.0 * np.sum(states.position * states.velocity, axis=-1) / SPEED_OF_LIGHT**2
    assert np.abs(effect - direct).max() < 1e-10  # 3 cm; the effect reaches 7 m
    assert np.abs(effect).max() > 1e-8
    assert RELATIVITY == pytest.approx(-2.0 * np.sqrt(3.986005e14) / SPEED_OF_LIGHT**2, rel=1e-9)


def test_the_nearest_ephemeris_is_chosen_and_none_when_all_are_old():
    time = observed().time[0]
    chosen = broadcast().choose(observed().satellite, np.array(time))
    assert (broadcast().satellite[chosen] == observed().satellite).all()
    for prn, row in zip(observed().satellite, chosen, strict=True):
        away = np.abs(broadcast().time[broadcast().satellite == prn] - time)
        assert abs(broadcast().time[row] - time) == away.min()
    assert (broadcast().choose(np.array([1, 99]), np.array(time + 10 * 86_400.0)) == -1).all()
    old = satellite_states(broadcast(), np.array([-1]), np.array([time]))
    assert np.isnan(old.position).all() and np.isnan(old.clock).all()


# ----- single epochs ----------------------------------------------------------------------


def test_fixes_are_right_within_a_metre_across_and_two_metres_up():
    error = east_north_up(fixes().position)
    bias, spread = error.mean(axis=0), error.std(axis=0)
    assert np.abs(bias[:2]).max() < 1.0 and abs(bias[2]) < 2.0
    # The reference computation: bias (-0.3, -0.3, -0.5) m, deviation (0.3, 0.3, 0.8) m.
    np.testing.assert_allclose(bias, (-0.3, -0.3, -0.5), atol=0.35)
    np.testing.assert_allclose(spread, (0.3, 0.3, 0.8), atol=0.15)


@pytest.mark.parametrize(
    ("without", "least"),
    [("tgd", 0.3), ("crs", 3.0), ("cuc", 3.0), ("af0", 1e4), ("i_dot", 0.1)],
)
def test_every_broadcast_term_is_needed(without, least):
    """Left out, the position goes wrong by more than its scatter."""
    value = broadcast().value | {without: np.zeros_like(broadcast().time)}
    spoiled = fix(signals(observed(), replace(broadcast(), value=value)))
    away = np.linalg.norm(spoiled.position - fixes().position, axis=1)
    assert np.isnan(away).any() or away.max() > least


def test_the_ionosphere_and_the_files_day_are_checked():
    with pytest.raises(ValueError, match="lacks the ionosphere's coefficients"):
        signals(observed(), replace(broadcast(), klobuchar=None))
    late = replace(observed(), time=observed().time + 30 * 86_400.0)
    with pytest.raises(ValueError, match="do not belong together"):
        signals(late, broadcast())


def test_fewer_than_four_satellites_give_no_fix():
    few = observed().pseudorange.copy()
    few[3, np.flatnonzero(np.isfinite(few[3]))[3:]] = np.nan
    found = fix(signals(replace(observed(), pseudorange=few), broadcast()))
    assert np.isnan(found.bias[3]) and np.isnan(found.position[3]).all()
    np.testing.assert_allclose(found.position[4:], fixes().position[4:])


def test_doppler_gives_a_velocity_of_zero_and_the_clocks_drift():
    found = fix(signals(replace(observed(), doppler=doppler()), broadcast()))
    inner = slice(1, -1)
    assert np.nanmax(np.abs(np.nanmean(found.velocity[inner], axis=0))) < 0.02
    drift = np.diff(fixes().bias).sum() / np.diff(observed().time).sum()
    assert np.nanmean(found.drift[inner]) == pytest.approx(drift, abs=0.5)
    assert drift < -300.0  # a part in a million slow
