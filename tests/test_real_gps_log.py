"""Broadcast orbits, single-epoch fixes and the filter, on an hour of a real GPS station.

The files lie beside the repository; without them what needs them is skipped, saying so.
"""

import json
import pickle
from dataclasses import replace
from functools import cache
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pymap3d
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.rollout import draw_episodes
from rinex_files import (
    BROADCAST,
    OBSERVED,
    needs_rinex,
    write_navigation,
    write_observations,
)
from typer.testing import CliRunner

import kfenv  # noqa: F401  (registers the environments)
from kfenv.envs.options import check_recording
from kfenv.filters.engine import Engine
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.gnss.clock import with_clock
from kfenv.models.gnss.orbits import EARTH_RATE, SPEED_OF_LIGHT, Constellation
from kfenv.models.gnss.pseudorange import pseudoranges
from kfenv.scenarios.gnss.ephemeris import RELATIVITY, read_navigation, satellite_states
from kfenv.scenarios.gnss.fix import fix, signals
from kfenv.scenarios.gnss.reading import MILLISECOND, read_log
from kfenv.scenarios.gnss.rinex import L1, read_observations
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.windows import PARTS

pytestmark = needs_rinex

POSITION = [0, 3, 6]


@cache
def observed():
    return read_observations(OBSERVED)


@cache
def broadcast():
    return read_navigation(BROADCAST)


@cache
def log():
    return read_log(OBSERVED, BROADCAST)


@cache
def fixes():
    return fix(signals(observed(), broadcast()))


def east_north_up(position):
    """Errors of positions (..., 3) about the station's, m."""
    latitude, longitude, _ = pymap3d.ecef2geodetic(*observed().position)
    error = np.moveaxis(position - observed().position, -1, 0)
    return np.stack(pymap3d.uvw2enu(*error, latitude, longitude), axis=-1)


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


def doppler():
    """What the real pseudoranges' change says, Hz: positive when approaching."""
    rate = (observed().pseudorange[2:] - observed().pseudorange[:-2]) / (
        observed().time[2:] - observed().time[:-2]
    )[:, None]
    return np.pad(-rate * L1 / SPEED_OF_LIGHT, ((1, 1), (0, 0)), constant_values=np.nan)


def test_doppler_gives_a_velocity_of_zero_and_the_clocks_drift():
    found = fix(signals(replace(observed(), doppler=doppler()), broadcast()))
    inner = slice(1, -1)
    assert np.nanmax(np.abs(np.nanmean(found.velocity[inner], axis=0))) < 0.02
    drift = np.diff(fixes().bias).sum() / np.diff(observed().time).sum()
    assert np.nanmean(found.drift[inner]) == pytest.approx(drift, abs=0.5)
    assert drift < -300.0  # a part in a million slow


# ----- logs as recordings -----------------------------------------------------------------


def run(recording, density=1.0):
    """The filter that logs are tracked with, in the reference tier: errors and the result.

    Its motion is linear, so that the instants at which nothing arrives change nothing:
    they are left out. The errors (B, E, 3) are those where something arrives.
    """
    arrives = np.isfinite(recording.measurement).any(axis=(0, 2))
    arrives[0] = True
    motion = with_clock(constant_acceleration(density))
    series = ("measurement", "noise", "motion_inputs", "sensor_inputs")
    heard = Recording(
        recording.time[arrives],
        **{name: getattr(recording, name)[:, arrives] for name in series},
        mean=recording.mean,
        factor=recording.factor,
    )
    result = ReferenceFilter(motion, pseudoranges()).run(heard)
    assert (result.status == 0).all()
    return east_north_up(result.mean[..., POSITION]), result


def test_the_filter_is_at_least_as_good_as_the_fixes_once_settled():
    recording = log().recording(log().start[:1], log().duration - 60.0)
    settled = slice(20, -1)
    alone = east_north_up(fixes().position[log().start[0] :])[settled]
    nominal, slow = (run(recording, scale)[0][0, settled] for scale in (1.0, 1e-15))
    for error in (nominal, slow):
        assert np.abs(error.mean(axis=0)[:2]).max() < 1.0 and abs(error.mean(axis=0)[2]) < 2.0
    root = [np.sqrt(np.mean(np.sum(e**2, axis=1))) for e in (alone, nominal, slow)]
    assert root[1] < 1.01 * root[0]
    # A filter told that the receiver hardly moves averages what scatters
    assert (slow.std(axis=0) < 0.95 * alone.std(axis=0)).all()


def test_between_epochs_nothing_arrives_and_the_first_one_is_spent():
    recording = log().recording(log().start[:2], 300.0)
    assert recording.time.size == 301 and np.diff(recording.time).max() == 1.0
    arrived = np.isfinite(recording.measurement).any(axis=2)
    assert (np.flatnonzero(arrived[0]) == np.arange(30, 301, 30)).all()
    assert np.isnan(recording.measurement[:, :, 12:]).all()  # the file has no Doppler
    np.testing.assert_allclose(
        recording.mean[:, POSITION], fixes().position[log().start[:2]], atol=1e-6
    )
    assert recording.truth is not None and recording.true_noise is None


def test_noise_is_that_of_the_error_budget():
    arrived = np.isfinite(log().measurement[:, :12])
    told = log().noise[:, :12][arrived]
    assert told.min() > 2.93 and told.max() < 10.0 and np.ptp(told) > 1.0


def test_doppler_becomes_rates(tmp_path):
    path = write_observations(tmp_path / "log.rnx", observed(), doppler())
    with_rates = read_log(path, BROADCAST)
    recording = with_rates.recording(with_rates.start[:1], 600.0)
    assert np.isfinite(recording.measurement[:, :, 12:]).any()
    start = int(with_rates.start[0])
    assert np.sqrt(np.sum(with_rates.factor[start, 1] ** 2)) < 0.5  # vx known from Doppler
    error, result = run(recording)
    assert np.sqrt(np.mean(error[0, 5:] ** 2)) < 1.5
    assert np.abs(result.mean[0, 5:, [1, 4, 7]]).max() < 0.3


def test_rinex_3_gives_the_same_recording(tmp_path):
    again = read_log(
        write_observations(tmp_path / "log.rnx", observed()),
        write_navigation(tmp_path / "nav.rnx", BROADCAST),
    )
    ours, theirs = (x.recording(x.start[:1], 300.0) for x in (log(), again))
    np.testing.assert_allclose(ours.measurement, theirs.measurement, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0.0, atol=1e-3)


def test_a_clock_set_by_whole_milliseconds_is_set_back_and_told(tmp_path):
    jumped = observed().pseudorange.copy()
    jumped[50:] -= 2.0 * MILLISECOND
    jumped[90:] += MILLISECOND
    path = write_observations(tmp_path / "log.rnx", replace(observed(), pseudorange=jumped))
    found = read_log(path, BROADCAST)
    assert found.clock_jumps == (-2, 1) and log().clock_jumps == ()
    assert np.abs(np.diff(found.truth[found.row, 9], 2)).max() < 500.0
    # 2 ms earlier by the satellites' own motion, up to 2 m, which the orbits account for
    whole = found.recording(found.start[40:41], 600.0)
    assert np.sqrt(np.mean(run(whole)[0][0, 10:] ** 2)) < 2.0


def test_parts_of_a_log_share_no_epoch():
    spans = {}
    for part in PARTS:
        starts = log().starts(300.0, part)
        first, last = log().row[starts - 1], log().row[starts] + 300
        assert (first[1:] >= last[:-1]).all()
        spans[part] = (first[0], last[-1])
    assert spans["tuning"][1] <= spans["validation"][0]
    assert spans["validation"][1] <= spans["test"][0] and len(log().starts(300.0, "test")) == 5
    rngs = [np.random.default_rng(seed) for seed in range(200)]
    drawn = log().random_starts(rngs, 300.0, "tuning")
    assert len(np.unique(drawn)) > 10
    assert (log().row[drawn] + 300).max() <= spans["validation"][0]


# ----- the scenario and the command line --------------------------------------------------


def test_agents_are_tested_on_windows_that_tuning_never_saw():
    kwargs = {"rinex": [str(OBSERVED), str(BROADCAST)], "duration": 300.0}
    tuning, validation, test = (
        draw_episodes("kfenv/GnssTracking-v0", kwargs, split, seed=0, episodes=32)
        for split in ("tuning", "validation", "test")
    )
    assert (len(tuning), len(validation), len(test)) == (32, 2, 5)
    assert len(draw_episodes("kfenv/GnssTracking-v0", kwargs, "test", seed=0, episodes=3)) == 3
    parts = [set(part.measurement[np.isfinite(part.measurement)]) for part in (tuning, test)]
    assert not parts[0] & parts[1]


def test_the_scenario_takes_a_log_in_place_of_all_that_is_simulated():
    scenario = GnssTracking(rinex=(str(OBSERVED), str(BROADCAST)))
    assert (scenario.rate, scenario.duration, scenario.time.size) == (1.0, 300.0, 301)
    assert scenario.motion.name == "constant-acceleration with clock"
    again = pickle.loads(pickle.dumps(scenario))
    rngs = [[np.random.default_rng(seed) for seed in range(3)] for _ in range(2)]
    one, other = scenario.sample(rngs[0]), again.sample(rngs[1])
    np.testing.assert_array_equal(one.measurement, other.measurement)
    np.testing.assert_array_equal(one.time, scenario.time)
    check_recording(one, scenario)


def test_engine_and_reference_agree_on_a_real_log():
    """Within a micrometre: ranges of 2e7 m are known to 4e-9 m each, in float64."""
    scenario = GnssTracking(rinex=(str(OBSERVED), str(BROADCAST)))
    recording = scenario.recorded("test", 3)
    fast = Engine(scenario.motion, scenario.sensor).run(recording)
    plain = ReferenceFilter(scenario.motion, scenario.sensor).history(recording)
    assert not fast.status.any() and not plain.status.any()
    deviation = np.sqrt(np.diagonal(plain.covariance, axis1=2, axis2=3))
    assert np.max(np.abs(fast.mean - plain.mean) / deviation) < 1e-8
    assert np.max(np.abs(fast.mean - plain.mean)[..., POSITION]) < 1e-6
    np.testing.assert_allclose(fast.nis, plain.nis, rtol=1e-8, atol=1e-8)


def test_every_decision_but_the_first_concerns_an_epoch():
    """In the reference tier, so that nothing is compiled."""
    kwargs = {"rinex": (str(OBSERVED), str(BROADCAST)), "filter": "srukf-joseph-prior"}
    env = gym.make("kfenv/GnssTracking-v0", **kwargs).unwrapped
    assert env.scenario.steps_per_measurement == env.core.interval == 30
    _, info = env.reset(seed=0)
    arrives, ended = [], False
    while not ended:
        arrives.append(np.isfinite(info["innovation_variance"]).any())
        _, _, _, ended, info = env.step(np.zeros(4))
    assert arrives == [False] + 10 * [True]


def test_steps_per_epoch_divide_all_times_between_epochs():
    assert log().steps_per_epoch == 30
    gap = np.delete(log().row, [5, 6, 20])
    assert replace(log(), row=gap).steps_per_epoch == 30
    between = np.insert(log().row, 5, log().row[4] + 20)
    assert replace(log(), row=between).steps_per_epoch == 10


@pytest.mark.parametrize(
    ("keywords", "said"),
    [
        ({"rinex": str(OBSERVED)}, "must be the paths of an observation and a navigation file"),
        ({"rinex": [str(OBSERVED)] * 2}, r"a navigation file \(type 'N'\) is wanted"),
        ({"faults": "none"}, "faults is for simulated episodes"),
        ({"track": "flight.csv"}, "track is for simulated episodes"),
        ({"rate": 5.0}, "rate is the log's, 1 per second: leave it out with rinex, got 5.0"),
        ({"duration": 3000.0}, "no room for a window of 3000 s"),
    ],
)
def test_keywords_that_do_not_go_with_a_log_say_so(keywords, said):
    with pytest.raises(ValueError, match=said):
        GnssTracking(**({"rinex": (str(OBSERVED), str(BROADCAST))} | keywords))


def test_evaluate_contests_agents_on_a_real_log(tmp_path):
    """In the reference tier, so that nothing is compiled."""
    folder = tmp_path / "out"
    result = CliRunner().invoke(
        app,
        ["evaluate", "kfenv/GnssTracking-v0", "--rinex", str(OBSERVED), str(BROADCAST),
         "--agent", "huber-gate", "--output", str(folder), "--processes", "1",
         "--option", "filter=srukf-joseph-prior", "--option", "duration=60", "--episodes", "4",
         "--tuning-trials", "0"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "4 windows of a real log, kept from training and tuning" in result.output
    results = json.loads((folder / "results.json").read_text())
    assert [r["episodes"] for r in results] == [4, 4]
    assert all(r["track_loss"] == 0.0 and r["rmse_median"] < 5.0 for r in results)


def test_a_log_too_short_says_for_what():
    with pytest.raises(ValueError, match=r"test \(50 % of 3570 s\) has no room for two windows"):
        log().starts(1200.0, "test")
    with pytest.raises(ValueError, match="no room for a window of 5000 s"):
        log().random_starts([np.random.default_rng(0)], 5000.0, "tuning")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"position": None}, "has no APPROX POSITION XYZ"),
        ({"position": np.array([-3978242.0, 3382841.0, 3650002.0])}, "lies 100 m from the median"),
        ({"time": "irregular"}, "off the 1 s grid"),
        ({"pseudorange": "few"}, "only 0 of its 120 epochs have four usable satellites"),
    ],
)
def test_logs_that_cannot_be_used_say_why(tmp_path, change, said):
    few = observed().pseudorange.copy()
    few[:, 3:] = np.nan
    irregular = observed().time + np.where(np.arange(120) == 60, 0.4, 0.0)
    text = {"irregular": irregular, "few": few}
    change = {k: text.get(v, v) if isinstance(v, str) else v for k, v in change.items()}
    changed = replace(observed(), **change)
    position = np.zeros(3) if changed.position is None else changed.position
    path = write_observations(tmp_path / "log.rnx", changed, position=position)
    with pytest.raises(ValueError) as caught:
        read_log(path, BROADCAST)
    assert said in str(caught.value) and str(path) in str(caught.value)


def test_a_receiver_that_moves_needs_no_position_and_is_judged_by_withheld_fixes(tmp_path):
    path = write_observations(tmp_path / "log.rnx", observed(), position=np.zeros(3))
    moving = read_log(path, BROADCAST, moving=True)
    recording = moving.recording(moving.start[:1], 300.0)
    ours = log().recording(log().start[:1], 300.0)
    withheld = recording.scored[0] > 0.0
    # one epoch of six
    np.testing.assert_array_equal(recording.time[withheld], [150.0])
    assert np.isnan(recording.measurement[0, withheld]).all()
    assert np.linalg.norm((recording.truth - ours.truth)[0, withheld][:, POSITION]) < 5.0
    # Delays are those at each fix rather than at the station: centimetres
    np.testing.assert_allclose(
        recording.measurement[0, ~withheld], ours.measurement[0, ~withheld], atol=0.05
    )
