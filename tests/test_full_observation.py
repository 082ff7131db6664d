"""The observation with memory: what its names say, told from infos; the short one stays."""

import inspect
import warnings
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from rollouts import (
    GNSS,
    INERTIAL,
    TRACKING,
    assert_same,
    change,
    draw,
    every_environment,
    make,
    make_vec,
    play,
    random_actions,
    truth_leaves,
    zeros,
)

from kfenv.envs.memory import PER_CHANNEL, Memory
from kfenv.envs.statistics import BOUND
from kfenv.filters.protocol import Measurement
from kfenv.filters.results import Update

ALL = ["fading", "process_noise", "measurement_noise", "channel_noise"]
SPOILT = {
    "jamming": {"bursts": [1, 2], "duration": [0.5, 1.5], "factor": [5.0, 30.0]},
    "signal_loss": {"duration": [0.3, 0.8]},
}

RADAR = make(TRACKING).scenario


def full(env_id, **keywords):
    return make(env_id, observation="full", **keywords)


def log_root(square):
    return min(BOUND, 0.5 * np.log(square + 1e-4))


def signed_log(value):
    return np.sign(value) * min(BOUND, np.log1p(abs(value)))


class Mean:
    """Exponential, over so many arrivals."""

    def __init__(self, window, start=0.0):
        self.window, self.value = window, start

    def add(self, value):
        self.value += (value - self.value) / self.window


class Oracle:
    """Every feature by its name, from the infos of one episode."""

    def __init__(self, env):
        scenario = env.scenario
        self.scale, self.env = scenario.error_scale, env
        self.channels = [channel.name for channel in scenario.sensor.channels]
        self.groups = {}
        for c, channel in enumerate(scenario.sensor.channels):
            self.groups.setdefault(channel.group, []).append(c)
        self.means = {}
        self.first, self.before = {}, np.zeros(len(self.channels))

    def mean(self, name, window, value=None, start=0.0):
        mean = self.means.setdefault((name, window), Mean(window, start))
        if value is not None:
            mean.add(value)
        return mean.value

    def features(self, info):
        missing = ~np.isfinite(info["innovation_variance"])
        deviation, told = np.sqrt(info["innovation_variance"]), info["noise"]
        n = np.where(missing, np.nan, info["innovation"] / deviation)
        over = np.abs(np.where(missing, np.nan, info["innovation"])) / told
        out = {}
        for group, members in self.groups.items():
            self.of_group(group, np.array(members), n, over, told, out)
        for c, name in enumerate(self.channels):
            here = not missing[c]
            now, before = n[c] if here else None, f"{name} alone: "
            log = log_root(over[c] ** 2) if here else None
            share = (told[c] / deviation[c]) ** 2 if here else 0.0
            out[before + "log of abs(innovation) over the told noise now"] = log or 0.0
            for w in (5, 20):
                what = f"the mean of that over {w} arrivals"
                out[before + what] = self.mean(name + " over", w, log)
            for w in (3, 10):
                value = signed_log(self.mean(name, w, now))
                out[f"{before}signed log of the mean of n over {w} arrivals"] = value
                out[f"{name}: signed log of the mean of n over {w} arrivals"] = value
            out[f"{name}: signed log of n now"] = signed_log(now) if here else 0.0
            square = self.mean(name + " square", 10, now**2 if here else None, start=1.0)
            out[before + "log RMS of n over 10 arrivals"] = log_root(square)
            out[before + "share of the noise in the innovation variance"] = share
        self.before = np.where(missing, self.before, n)
        return out

    def of_group(self, group, members, n, over, told, out):
        here = members[~np.isnan(n[members])]
        some, before = len(here) > 0, f"{group}: "
        square = np.mean(n[here] ** 2) if some else None
        log = log_root(np.mean(over[here] ** 2)) if some else None
        size = np.sqrt(np.mean(told[here] ** 2)) if some else None
        if some:
            self.first.setdefault(group, size)
        out[before + "log RMS of n now"] = log_root(square) if some else 0.0
        largest = log_root(np.max(n[here] ** 2)) if some else 0.0
        out[before + "log of the largest abs(n) now"] = largest
        out[before + "log RMS of the innovation over the told noise now"] = log or 0.0
        relative = np.log(size / self.first[group]) if some else 0.0
        out[before + "log of the told noise over the episode's first"] = relative
        for w in (3, 10, 30):
            value = log_root(self.mean(f"{group} squares", w, square, start=1.0))
            out[f"{before}log RMS of n over {w} arrivals"] = value
        for w in (5, 20):
            what = f"mean log over the told noise over {w} arrivals"
            out[before + what] = self.mean(f"{group} overs", w, log)
        if len(members) > 3:
            total = n[here].sum() / np.sqrt(len(here)) if some else None
            for w in (3, 10):
                value = signed_log(self.mean(f"{group} sums", w, total))
                out[f"{before}signed log of the mean of n over {w} arrivals"] = value
        product = np.mean(n[here] * self.before[here]) if some else None
        out[f"{before}signed log of the mean product of n and the one before over 10 arrivals"] = (
            signed_log(self.mean(f"{group} products", 10, product))
        )


@every_environment
@pytest.mark.parametrize("actions", [None, ["channel_noise"]])
def test_the_features_are_what_their_names_say(env_id, actions):
    env = full(env_id, duration=7.0, actions=actions, faults=SPOILT)
    begin = make(env_id, actions=actions).core.observation_size - len(env.core.knobs)
    names = env.core.feature_names()[begin : -len(env.core.knobs)]
    oracle, checked = Oracle(env), 0
    for step in play(env, random_actions(env.action_space.shape, 60), seed=3):
        ended = len(step) == 5 and (step[2] or step[3])
        if ended:
            break
        wanted = oracle.features(step[-1])
        for name, value in zip(names, step[0][begin:], strict=False):
            if name in wanted:
                assert value == pytest.approx(wanted[name], abs=2e-5), name
                checked += 1
    common = 4 if env.scenario.yardstick.rates else 2
    assert sum(name in wanted for name in names) == len(names) - common
    assert checked > 5 * (len(names) - common)


@every_environment
def test_the_flight_is_told_as_the_filter_predicts_it(env_id):
    env = full(env_id, decision_interval=2)
    motion, scale = env.scenario.motion, env.scenario.error_scale
    yardstick = env.scenario.yardstick
    acceleration = [i for i, state in enumerate(motion.states) if state.unit == "m/s^2"]
    common = 4 if yardstick.rates else 2
    begin = len(env.core.feature_names()) - len(env.core.knobs) - common
    env.reset(seed=1)
    origin = np.zeros(len(yardstick))
    if env_id == GNSS:  # from where the filter believes to start
        origin = env.core._update.mean[0, list(yardstick.states)].copy()
    for action in zeros(env, 15):
        told = env.step(action)[0][begin : begin + common]
        state = env.core._pending.mean[0]
        assert told[0] == pytest.approx(np.log(0.2), abs=1e-5)
        distance = np.linalg.norm(state[list(yardstick.states)] - origin)
        assert told[1] == pytest.approx(np.log1p(distance / scale), rel=1e-5)
        if not yardstick.rates:
            continue
        speed = np.linalg.norm(state[list(yardstick.rates)])
        assert told[2] == pytest.approx(np.log1p(speed / (0.1 * scale)), rel=1e-5)
        if acceleration:
            size = np.linalg.norm(state[acceleration])
            assert told[3] == pytest.approx(np.log1p(size / (0.01 * scale)), rel=1e-5)


def test_a_state_without_acceleration_lets_its_velocity_tell():
    """A steady change is found, whatever the steps."""
    scenario = make(INERTIAL).scenario
    n, m = len(scenario.motion.states), len(scenario.sensor.channels)
    for dt in (0.01, 0.1):
        memory = Memory(scenario, np.zeros(0, np.int64), 1)
        memory.restart(np.zeros(1, np.int64), np.zeros((1, n)))
        for k in range(round(8.0 / dt)):
            mean = np.zeros((1, n))
            mean[0, scenario.motion.velocity[1]] = 100.0 + 3.0 * k * dt
            pending = pending_of(mean, np.full((1, m), np.nan), np.ones((1, m)))
            told = Measurement(np.zeros((1, 0)), np.full((1, m), np.nan), np.ones((1, m)))
            memory.collect(pending, told, np.full(1, dt * (k > 0)), np.ones(1, bool))
        seen = features(memory, pending)
        assert seen[0, -1] == pytest.approx(np.log1p(3.0 / (0.01 * scenario.error_scale)), rel=1e-3)


def pending_of(mean, innovation, variance):
    return Update(mean, None, innovation, variance, *[None] * 3)


def features(memory, pending):
    seen = np.zeros((1, len(memory.feature_names())))
    memory.observe(pending.mean, np.ones(1), np.ones(1, bool), seen)
    return seen


@every_environment
@pytest.mark.parametrize("actions", [None, ALL])
def test_the_short_one_is_its_beginning(env_id, actions):
    short, long = make(env_id, actions=actions), full(env_id, actions=actions)
    knobs = len(short.core.knobs)
    names = short.core.feature_names(), long.core.feature_names()
    assert names[0][:-knobs] == names[1][: len(names[0]) - knobs]
    assert names[0][-knobs:] == names[1][-knobs:]
    assert len(names[1]) == len(set(names[1])) == long.observation_space.shape[0]
    taken = random_actions(short.action_space.shape, 41)
    for one, other in zip(play(short, taken, 2), play(long, taken, 2), strict=True):
        np.testing.assert_array_equal(one[0][:-knobs], other[0][: len(names[0]) - knobs])
        np.testing.assert_array_equal(one[0][-knobs:], other[0][-knobs:])
        assert_same(one[1:], other[1:])


@every_environment
def test_one_alone_and_many_together_see_the_same_bits(env_id):
    many = make_vec(env_id, 3, observation="full", actions=ALL)
    alone = [full(env_id, actions=ALL) for _ in range(3)]
    seen = many.reset(seed=7)[0]
    for i, env in enumerate(alone):
        assert_same(seen[i], env.reset(seed=7 + i)[0])
    for action in random_actions(many.action_space.shape, 20):
        seen, _, lost, ended, _ = many.step(action)
        if lost.any() or ended.any():
            break
        for i, env in enumerate(alone):
            assert_same(seen[i], env.step(action[i])[0])


@every_environment
def test_a_reset_forgets_the_chosen_episodes_alone(env_id):
    recording = draw(env_id, range(2), faults=SPOILT)
    envs = [make_vec(env_id, 2, observation="full", recording=recording[[0, 1]]) for _ in "ab"]
    first = [env.reset()[0] for env in envs]
    for action in zeros(envs[0], 8):
        before = [env.step(action)[0] for env in envs]
    assert_same(*before)
    mask = np.array([True, False])
    seen = envs[0].reset(seed=0, options={"reset_mask": mask})[0]
    assert_same(seen[0], first[0][0])
    assert_same(seen[1], before[0][1])
    for action in zeros(envs[0], 5):
        one, other = (env.step(action)[0] for env in envs)
        assert_same(one[1], other[1])


@every_environment
def test_finite_and_bounded_whatever_happens(env_id):
    def spoil(measurement):
        measurement[:, 5:8] = np.resize([1e9, 3.0, -3.0], measurement.shape[2])
        measurement[:, 10:20, 1] = np.nan
        measurement[:, 20:] = np.nan

    recording = change(draw(env_id, range(2)), measurement=spoil)
    env = make_vec(env_id, 2, observation="full", actions=ALL, recording=recording)
    for action in (0.0, -1.0, 1.0):
        seen = [env.reset()[0]]
        seen += [env.step(zeros(env) + action)[0] for _ in range(45)]
        assert np.isfinite(seen).all() and all(map(env.observation_space.contains, seen))


@every_environment
def test_a_lost_track_has_a_last_observation(env_id):
    env = make(env_id)
    lost = truth_leaves(draw(env_id, [0]), 12, env.scenario)
    heard = play(full(env_id, recording=lost), zeros(env, 41), 0)
    last = heard[-1]
    assert last[2] and np.isfinite(last[0]).all() and last[0].any()
    now = [i for i, name in enumerate(full(env_id).core.feature_names()) if name.endswith(" now")]
    assert not last[0][now].any()


def test_a_failed_filter_tells_nothing_and_harms_nobody():
    def spoil(measurement):
        measurement[0, 10] = 1e300

    whole = draw(TRACKING, range(2))
    envs = [
        make_vec(TRACKING, 2, observation="full", recording=recording)
        for recording in (whole, change(whole, measurement=spoil))
    ]
    seen = [env.reset()[0] for env in envs]
    failed = False
    for action in zeros(envs[0], 14):
        (one, *_), (other, _, lost, _, _) = (env.step(action) for env in envs)
        assert_same(one[1], other[1])
        failed |= lost[0]
        if lost[0]:
            assert not other[0].any()
    assert failed and np.isfinite(seen).all()


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.floats(-1e200, 1e200) | st.just(float("nan")), min_size=3, max_size=24),
    variance=st.floats(1e-12, 1e12), noise=st.floats(1e-6, 1e6),
)  # fmt: skip
def test_any_innovation_leaves_it_finite(values, variance, noise):
    scenario = RADAR
    memory = Memory(scenario, np.arange(3), 1)
    memory.restart(np.zeros(1, np.int64), np.zeros((1, 9)))
    for k in range(len(values) // 3):
        innovation = np.array([values[3 * k : 3 * k + 3]])
        pending = pending_of(np.zeros((1, 9)), innovation, np.full((1, 3), variance))
        told = Measurement(np.zeros((1, 0)), innovation, np.full((1, 3), noise))
        memory.collect(pending, told, np.ones(1), np.ones(1, bool))
        seen = features(memory, pending)
        shares = [i for i, name in enumerate(memory.feature_names()) if "share" in name]
        assert (np.abs(np.delete(seen, shares, axis=1)) <= BOUND).all()


@every_environment
def test_gymnasium_finds_nothing_to_complain_of(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*not within the.*|.*render.*")
        check_env(full(env_id, actions=ALL), skip_render_check=True)


@every_environment
def test_its_page_tells_every_feature(env_id):
    env = full(env_id, actions=ALL)
    page = " ".join(inspect.getdoc(type(env)).split())
    channels = len(env.scenario.sensor.channels)
    more = len(env.core.feature_names()) - make(env_id, actions=ALL).core.observation_size
    told = f'``observation="full"`` puts {more - PER_CHANNEL * channels} components more'
    assert told in page and f"and {PER_CHANNEL} more for each channel with a knob" in page
    for name in env.core.feature_names()[-more - len(env.core.knobs) : -len(env.core.knobs)]:
        what = name.split(": ")[-1]
        assert what in page, name


@every_environment
def test_nothing_of_the_truth_is_in_it(env_id):
    recording = draw(env_id, [0])
    unknown = replace(recording, truth=None, true_noise=None, true_bias=None, faults=())
    heard = []
    for told in (recording, unknown):
        env = full(env_id, recording=told)
        heard.append(np.stack([step[0] for step in play(env, zeros(env, 15), 0)]))
    np.testing.assert_array_equal(*heard)
