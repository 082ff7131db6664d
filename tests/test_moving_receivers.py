"""Receivers that move, of several systems: simulated drives as RINEX, and a real phone's log."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.contest import figures
from kfenv.agents.contest.evaluation import Contest, evaluate
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contestants.registry import make_agent
from moving_receivers import BIAS, START, drive, write_truth
from pymap3d import ecef2geodetic, uvw2enu
from rinex_files import FOLDER, header_line, needs_rinex
from scipy.linalg import expm

import kfenv  # noqa: F401  (registers the environments)
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.gnss.orbits import look_angles
from kfenv.models.markov_acceleration import markov_acceleration
from kfenv.models.namespaces import batch
from kfenv.scenarios.gnss.calibration import calibrated
from kfenv.scenarios.gnss.ephemeris import read_navigation, satellite_states
from kfenv.scenarios.gnss.fix import fix, signals
from kfenv.scenarios.gnss.reading import read_log
from kfenv.scenarios.gnss.rinex import read_observations
from kfenv.scenarios.gnss.satellite_channels import assign_channels, by_channel
from kfenv.scenarios.gnss.tracking import GnssTracking
from kfenv.scenarios.positions import read_positions
from kfenv.scenarios.recording import Recording

POSITION, VELOCITY = [0, 3, 6], [1, 4, 7]
BUS = FOLDER / "bus_phone.20o", FOLDER / "bus_phone.20n"
DURATION = 60.0


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A drive of four minutes with noise, its truth, and its log."""
    folder = tmp_path_factory.mktemp("drive")
    found = drive(folder)
    truth = write_truth(folder / "truth.csv", found, "t")
    return found, truth, read_log(found.observed, found.broadcast, truth)


def starts(log, every=40):
    chosen = log.start[::every]
    return chosen[log.row[chosen] + DURATION / log.step <= log.row[-1]]


def run(recording):
    scenario = GnssTracking(moving=True)
    return ReferenceFilter(scenario.motion, scenario.sensor).run(recording)


def position_error(run, truth):
    """RMS after five seconds, m."""
    error = np.linalg.norm((run.mean - truth)[:, 5:, POSITION], axis=-1)
    return np.sqrt(np.mean(error**2))


# ----- the files, against what was simulated ------------------------------------------------


def test_without_noise_all_systems_are_read_back_to_the_files_digits(tmp_path):
    """Satellite clocks, delays of three systems, their biases and the atmosphere come off."""
    simulated = drive(tmp_path, duration=60.0, noise=False)
    truth = write_truth(tmp_path / "truth.pos", simulated, "pos")
    log = read_log(simulated.observed, simulated.broadcast, truth)
    here = log.start
    assert np.abs(log.mean[here][:, POSITION] - simulated.position[here]).max() < 0.005
    assert np.abs(log.mean[here][:, VELOCITY] - simulated.velocity[here]).max() < 0.005
    assert np.abs(log.truth[log.row][:, POSITION] - simulated.position).max() < 1e-3
    assert np.abs(log.truth[log.row][:, 9] - simulated.clock).max() < 0.005
    assert log.moving and log.told and log.known.all()
    assert np.isfinite(log.measurement[:, :12]).all()  # 24 satellites share twelve channels


def test_biases_between_systems_are_found_through_the_noise(driven):
    observed = read_observations(driven[0].observed)
    raw = signals(observed, read_navigation(driven[0].broadcast))
    taken = np.nanmedian(raw.pseudorange - calibrated(raw, slice(70)).pseudorange, axis=0)
    for letter, bias in BIAS.items():
        assert taken[observed.system == letter] == pytest.approx(bias, abs=1.5)


def test_more_systems_give_a_better_fix(driven):
    observed = read_observations(driven[0].observed)
    orbits = read_navigation(driven[0].broadcast)
    alone = fix(signals(observed.of(observed.system == "G"), orbits))
    together = fix(calibrated(signals(observed, orbits), slice(70)))
    errors = [np.std(found.position - driven[0].position) for found in (alone, together)]
    assert errors[1] < 0.8 * errors[0]


def test_noise_follows_the_signals_strength(driven):
    simulated, _, log = driven
    up = np.isfinite(simulated.range)
    elevation = look_angles(simulated.position, simulated.seen[..., :3])[0]
    channel = assign_channels(up, elevation)
    strength = by_channel(simulated.strength, channel, 45.0)
    rate = log.noise[:, 12:] * 10.0 ** ((strength - 45.0) / 20.0)
    assert rate == pytest.approx(0.05, rel=0.15)
    code = log.noise[:, :12]
    weak, strong = strength < 36.0, strength > 46.0
    assert np.median(code[weak]) > 1.3 * np.median(code[strong])


def test_beidou_is_gps_fourteen_seconds_later_with_constants_of_its_own(tmp_path):
    orbits = read_navigation(drive(tmp_path, "GC", duration=2.0).broadcast)
    rows = np.flatnonzero(orbits.satellite > 300)[:5]
    value = {name: column.copy() for name, column in orbits.value.items()}
    # the same orbit said in GPS's words: its week, its gravity and the earth's rate
    value["toe"][rows] += 14.0
    value["omega0"][rows] += value["earth_rate"][rows] * 14.0
    same = replace(orbits, value=value)
    time = orbits.time[rows][:, None] + np.linspace(-1800.0, 1800.0, 5)
    found, expected = (satellite_states(o, rows[:, None], time) for o in (orbits, same))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-5)
    assert (orbits.time[rows] - START) == pytest.approx(0.0, abs=1e-6)
    radius = np.linalg.norm(found.position, axis=-1)
    assert radius == pytest.approx(27.9e6, rel=0.02)


# ----- truth ------------------------------------------------------------------------------


@pytest.mark.parametrize("style", ["week", "t", "pos"])
def test_truth_is_read_in_each_form(driven, style, tmp_path):
    path = write_truth(
        tmp_path / ("truth.pos" if style == "pos" else "truth.csv"), driven[0], style
    )
    log = read_log(driven[0].observed, driven[0].broadcast, path)
    assert np.abs(log.truth[log.row][:, POSITION] - driven[0].position).max() < 5e-3


def test_truth_with_gaps_counts_where_it_is_told(driven, tmp_path):
    lines = driven[1].read_text().splitlines()
    path = tmp_path / "truth.csv"
    path.write_text("\n".join(lines[:61] + lines[101:]))
    log = read_log(driven[0].observed, driven[0].broadcast, path)
    assert not log.known[61:99].any() and log.known[:60].all() and log.known[101:].all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t + 30 * 86_400.0, "cover 0 % of .*give GPS seconds since then"),
        (lambda t: t + 18.0, "from the fixes .* are its times GPS time"),
    ],
)
def test_truth_of_another_time_is_refused(driven, tmp_path, change, said):
    moved = replace(driven[0], time=change(driven[0].time))
    path = write_truth(tmp_path / "truth.csv", moved, "week")
    with pytest.raises(ValueError, match=said):
        read_log(driven[0].observed, driven[0].broadcast, path)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("p.csv", "t,lat,lon\n", "column 'height' is missing"),
        ("p.csv", "lat,lon,height\n", "column 'week' is missing"),
        ("p.csv", "t,lat,lon,height\n" + "1,48,11,0\n" * 5, "position 2 is not later"),
        ("p.csv", "t,lat,lon,height\n1,148,11,0\n", "lat must be within 90"),
        ("p.pos", "1316 518400 48 11 0 1 9\n", "is no RTKLIB solution file of GPST times"),
        ("p.pos", "%  UTC latitude(deg) longitude(deg) height(m) Q\n", "have RTKLIB write GPST"),
        ("p.pos", "%  GPST latitude(deg) longitude(deg) height(m) Q\n1 2 3\n", "line 2: 6 fields"),
    ],
)
def test_bad_positions_are_refused_by_name(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        read_positions(path)
    assert name in str(caught.value)


# ----- filtered -----------------------------------------------------------------------------


def test_a_drive_read_back_is_as_good_as_its_direct_recording(driven):
    simulated, _, log = driven
    recording = log.recording(starts(log), DURATION)
    elevation = look_angles(simulated.position, simulated.seen[..., :3])[0]
    channel = assign_channels(np.isfinite(simulated.range), elevation)
    exact = np.concatenate(
        [by_channel(values, channel, np.nan) for values in (simulated.range, simulated.rate)], 1
    )
    inputs = by_channel(simulated.seen, channel, 0.0).reshape(len(channel), -1)
    direct = replace(log, measurement=exact, sensor_inputs=inputs).recording(starts(log), DURATION)
    ours, best = (position_error(run(r), r.truth) for r in (recording, direct))
    assert ours == pytest.approx(best, rel=0.05)
    assert best < 2.5


def test_sparse_epochs_do_not_run_away(tmp_path):
    """Half a minute between fixes without Doppler, at up to 15 m/s."""
    simulated = drive(tmp_path, "GE", duration=1500.0, interval=30.0, doppler=False)
    log = read_log(simulated.observed, simulated.broadcast, moving=True)
    recording = log.recording(log.start[:20:5], 600.0)
    path = np.stack([np.interp(np.arange(log.row[-1] + 1), log.row, axis)
                     for axis in simulated.position.T], axis=-1)  # fmt: skip
    found = run(recording).mean[..., POSITION]
    for episode, start in enumerate(log.row[log.start[:20:5]]):
        at = np.arange(0, 601, 30)
        at = at[np.isfinite(recording.measurement[episode, at]).any(axis=1)]
        error = found[episode, at] - path[start + at]
        assert np.linalg.norm(error, axis=-1).max() < 25.0


def test_without_truth_withheld_fixes_are_the_yardstick(driven):
    log = read_log(driven[0].observed, driven[0].broadcast, moving=True)
    recording = log.recording(log.start[:1], DURATION)
    withheld = recording.scored[0] > 0.0
    np.testing.assert_array_equal(recording.time[withheld], np.arange(50.0, 60.0))
    brief = log.recording(log.start[:1], 30.0)
    np.testing.assert_array_equal(brief.time[brief.scored[0] > 0.0], np.arange(25.0, 30.0))
    assert np.isnan(recording.measurement[0, withheld]).all()
    rows = log.row[log.start[0]] + np.flatnonzero(withheld)
    away = recording.truth[0, withheld][:, POSITION] - driven[0].position[rows]
    assert np.linalg.norm(away, axis=-1).max() < 12.0
    with pytest.raises(ValueError, match=r"has no APPROX POSITION XYZ.* moved \(moving=True\)"):
        read_log(driven[0].observed, driven[0].broadcast)


@pytest.mark.parametrize("flag", [2, 3])
def test_an_event_of_motion_in_the_file_is_served(driven, tmp_path, flag):
    """Nobody need say that the receiver moved where the file does."""
    text = driven[0].observed.read_text()
    second = text.index("\n>", text.index("\n>") + 1) + 1
    event = f">{'':30s}{flag}  1\n" + header_line("A BUS STOP", "MARKER NAME")
    path = tmp_path / "drive.obs"
    path.write_text(text[:second] + event + text[second:])
    log = read_log(path, driven[0].broadcast)
    assert log.moving and not log.told and len(log.row) == len(driven[2].row)


@needs_rinex
def test_a_real_phones_log_is_filtered_with_sane_innovations():
    with pytest.warns(UserWarning, match=r"14:00 to 2020-10-30 14:00.* 10 % of them .*G26"):
        log = read_log(*BUS, moving=True)
    recording = log.recording(log.start[[5, 60, 105, 180, 220]], 60.0)
    done = run(recording)
    arrived = np.isfinite(recording.measurement).sum(axis=-1)
    nis = np.sum(np.nan_to_num(done.nis) * (arrived > 0)) / arrived.sum()
    assert 0.3 < nis < 3.0
    withheld = recording.scored > 0.0
    away = np.linalg.norm((done.mean - recording.truth)[..., POSITION], axis=-1)[withheld]
    assert withheld.sum() >= 30 and np.median(away) < 10.0


@needs_rinex
@pytest.mark.filterwarnings("ignore:.*ephemerides")
def test_tuned_to_its_innovations_a_real_log_has_both_kinds_as_told():
    """Process noise by the NIS of the part to tune on; the error would not tell its scale."""
    kwargs = {"rinex": list(map(str, BUS)), "moving": True, "duration": 30.0}
    place = "kfenv/GnssTracking-v0", kwargs
    windows = {split: draw_episodes(*place, split, 0, 16) for split in ("tuning", "test")}

    def nis(process_noise, split):
        agent = make_agent("fixed-tuned").with_values({"process_noise": process_noise})
        return np.nanmean(rollout(agent, *place, windows[split]).nis[:, 1:], axis=0)

    levels = [1.0, 0.2, 0.1, 0.05, 0.02]
    chosen = min(levels, key=lambda level: np.abs(np.log(nis(level, "tuning"))).sum())
    assert nis(1.0, "test")[1] < 0.2 and chosen < 0.2  # the bus stands: 0.1 m/s
    found = nis(chosen, "test")
    assert (found > 0.5).all() and (found < 2.0).all()


# ----- the scenario -------------------------------------------------------------------------


def test_the_scenario_takes_a_truth_and_a_motion_that_fits(driven, tmp_path):
    files = [str(driven[0].observed), str(driven[0].broadcast), str(driven[1])]
    scenario = GnssTracking(rinex=files, duration=30.0)
    assert scenario.log.moving and "markov-acceleration" in scenario.motion.name
    sampled = scenario.sample([np.random.default_rng(0)])
    assert sampled.scored is None and sampled.truth is not None
    assert len(scenario.recorded("test", 10)) >= 2
    late = tmp_path / "truth.csv"
    lines = driven[1].read_text().splitlines()
    late.write_text("\n".join(lines[:1] + lines[-40:]))
    with pytest.raises(ValueError, match=r"no window of 30 s .* truth is known; give a longer"):
        GnssTracking(rinex=[*files[:2], str(late)], duration=30.0)


@pytest.mark.parametrize("told", [True, False])
def test_a_contest_draws_a_map_of_the_widest_window(driven, tmp_path, monkeypatch, told):
    """Tracks and truth lie on the street that was driven, in metres of the same length."""
    simulated, truth, log = driven
    files = [str(simulated.observed), str(simulated.broadcast), str(truth)]
    kwargs = {"rinex": files} if told else {"rinex": files[:2], "moving": True}
    contest = Contest("kfenv/GnssTracking-v0", kwargs | {"duration": 30.0}, ("huber-gate",), 2, 0,
                      tuning_trials=0)  # fmt: skip
    results = evaluate(contest, tmp_path, processes=1)
    drawn = {}
    monkeypatch.setattr(figures, "save", lambda figure, path: drawn.update({path.name: figure}))
    assert figures.draw_contest(contest, results, tmp_path)[-1] == tmp_path / "map.png"
    [axes] = drawn["map.png"].axes
    assert axes.get_aspect() == 1.0 and axes.get_xlabel() == "east, m"
    streets = [simulated.position[i : i + 31] for i in log.row[log.starts(30.0, "test")[:2]]]
    street = max(streets, key=lambda street: np.linalg.norm(np.ptp(street, axis=0)))
    *around, _ = ecef2geodetic(*street[0])
    east, north, _ = uvw2enu(*(street - street[0]).T, *around)
    street = np.stack([east, north], axis=-1)
    lines = {line.get_label(): np.array(line.get_data()).T for line in axes.lines}
    assert list(lines) == ["fixed", "huber-gate", "truth" if told else "withheld fixes"]
    assert len(lines["fixed"]) >= 30 and np.ptp(street, axis=0).max() > 100.0
    for track in lines.values():
        away = np.linalg.norm(track[:, None] - street, axis=-1).min(axis=1)
        assert len(track) >= 5 and away.max() < 15.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"moving": "yes"}, "moving must be True or False"),
        ({"moving": True, "manoeuvre": 3.0}, "manoeuvre must be an acceleration's deviation"),
        ({"moving": True, "manoeuvre": (0.0, 10.0)}, "deviation must be a positive number"),
        ({"moving": True, "manoeuvre": (1.0, 0.1)}, "time_constant must be a number of seconds, 1"),
        ({"rinex": ["a"]}, "rinex must be the paths"),
        ({"rinex": ["a", "b", "c", "d"]}, "rinex must be the paths"),
    ],
)
def test_wrong_arguments_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        _ = GnssTracking(**wrong).motion


@pytest.mark.parametrize(("dt", "tau"), [(1.0, 1.0), (1.0, 10.0), (0.05, 10.0)])
def test_markov_acceleration_is_its_differential_equation(dt, tau):
    """Against matrix exponentials: transition, and covariance by Van Loan's way."""
    functions = markov_acceleration(1.5, tau).build(batch)
    x = np.random.default_rng(0).normal(size=(4, 9))
    rates = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]])
    moved = np.stack(functions.step(tuple(x.T), (), dt), axis=-1).reshape(4, 3, 3)
    np.testing.assert_allclose(moved, x.reshape(4, 3, 3) @ expm(rates * dt).T, atol=1e-13)
    both = np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = -rates, rates.T
    both[2, 5] = 2.0 * 1.5**2 / tau
    grown = expm(both * dt)
    factor = np.zeros((3, 3))
    entries = functions.noise_factor(tuple(x.T), (), dt)[:6]
    factor[np.tril_indices(3)] = [np.broadcast_to(value, 4)[0] for value in entries]
    np.testing.assert_allclose(factor @ factor.T, grown[3:, 3:].T @ grown[:3, 3:], rtol=1e-6)


# ----- an episode that runs away --------------------------------------------------------------


def straight_recording(offset):
    """A radar's recording without truth whose range jumps by `offset` after five seconds, m."""
    time = np.arange(0.0, 20.05, 0.1)
    range_ = 8000.0 - 100.0 * time + np.where(time > 5.0, offset, 0.0)
    measurement = np.stack((range_, 0.0 * time, 0.05 + 0.0 * time), axis=-1)[None]
    mean = np.array([0.0, 0.0, 0.0, 8000.0, -100.0, 0.0, 400.0, 0.0, 0.0])
    noise = np.broadcast_to((20.0, 0.02, 0.02), measurement.shape)
    none = np.empty((1, len(time), 0))
    return Recording(time, measurement, noise, mean[None], np.diag([30.0, 10.0, 1.0] * 3)[None],
                     none, none)  # fmt: skip


@pytest.mark.parametrize(("offset", "lost"), [(0.0, False), (1e6, True)])
def test_a_runaway_is_lost_without_truth_and_the_next_episode_is_not(offset, lost):
    env = gym.make("kfenv/RadarValidation-v0", recording=straight_recording(offset))
    for _ in range(2):
        env.reset(seed=0)
        ended = False
        while not ended:
            _, reward, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape))
            ended = terminated or truncated
        assert terminated is lost and truncated is not lost
        assert (reward < 0.0) is lost
