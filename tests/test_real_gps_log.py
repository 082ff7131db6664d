"""The filter, the scenario and contests on an hour of a real GPS station.

The files lie beside the repository; without them what needs them is skipped, saying so.
"""

import json
import pickle
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contest.rollout import draw_episodes
from rinex_files import BROADCAST, OBSERVED, needs_rinex, write_navigation, write_observations
from station import POSITION, doppler, east_north_up, fixes, log, observed
from typer.testing import CliRunner

import kfenv  # noqa: F401  (registers the environments)
from kfenv.envs.options import check_recording
from kfenv.filters.engine import Engine
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.gnss.clock import with_clock
from kfenv.models.gnss.pseudorange import pseudoranges
from kfenv.scenarios.gnss.reading import MILLISECOND, read_log
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.recording import Recording
from kfenv.scenarios.windows import PARTS

pytestmark = needs_rinex


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
