"""Inertial navigation's flights, unit, fixes and faults are what the page and SPEC E6 say."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rollouts import INERTIAL, draw, play
from test_bad_input import complaint

from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs, measured
from kfenv.filters.results import Prediction
from kfenv.models.namespaces import scalar
from kfenv.models.strapdown import GRAVITY, mechanise
from kfenv.scenarios.faults import Draft
from kfenv.scenarios.inertial.faults import AccelerationStep, Interference, Outliers, RateStep
from kfenv.scenarios.inertial.flights import exact_samples, paper_flight, random_flight
from kfenv.scenarios.inertial.ins_gnss import InsGnss

TIME = np.arange(5001) / 100.0


def wrapped(difference):
    difference = difference.copy()
    difference[..., 6:] = np.angle(np.exp(1j * difference[..., 6:]))
    return difference


# ----- flights --------------------------------------------------------------------------


def test_a_unit_without_errors_reproduces_the_papers_flight():
    flight = paper_flight(TIME)
    off = wrapped(mechanise(flight[0], exact_samples(flight, TIME), TIME) - flight)
    assert np.abs(off[:, :3]).max() < 1e-9 and np.abs(off).max() < 1e-9


@given(st.integers(0, 10_000), st.sampled_from([100.0, 10.0, 1.0]))
@settings(max_examples=10, deadline=None)
def test_and_every_random_one_at_any_rate(seed, rate):
    time = np.arange(round(30 * rate) + 1) / rate
    flight = random_flight(np.random.default_rng(seed), time)
    off = wrapped(mechanise(flight[0], exact_samples(flight, time), time) - flight)
    assert np.abs(off).max() < 1e-6
    assert np.abs(flight[:, 6:8]).max() < np.radians(80.0)


def test_our_flight_from_the_papers_start():
    flight = paper_flight(TIME)
    np.testing.assert_allclose(flight[0, :6], [1000, 1000, -1000, 260, 70, -50])
    np.testing.assert_allclose(np.degrees(flight[0, 6:]), [45, 10, 10])
    np.testing.assert_allclose(flight[2500, 5], 50.0)  # half way round: descending, other bank
    np.testing.assert_allclose(np.degrees(flight[2500, 6]), -45.0)
    speed = np.hypot(flight[:, 3], flight[:, 4])
    np.testing.assert_allclose(speed, np.hypot(260.0, 70.0))
    yaw_rate = np.gradient(flight[:, 8], TIME)[1:-1]
    expected = GRAVITY * np.tan(flight[1:-1, 6]) / 270.0
    np.testing.assert_allclose(yaw_rate, expected, atol=1e-6)
    sideslip = np.degrees(np.arctan2(flight[:, 4], flight[:, 3]) - flight[:, 8])
    np.testing.assert_allclose(sideslip, 5.07, atol=0.01)


def test_a_random_turn_is_coordinated():
    """No specific force to the side, but for what angle of attack and slow rolling leave."""
    flight = random_flight(np.random.default_rng(5), TIME)
    force = exact_samples(flight, TIME)[:, :3]
    assert np.abs(force[:, 1]).max() < 0.5 and np.abs(flight[:, 6]).max() > np.radians(10.0)
    assert (force[:, 2] < -5.0).all()


# ----- the unit -------------------------------------------------------------------------


def errors(faults, **keywords):
    """Errors (T, 6) of the inertial samples of an episode."""
    scenario = InsGnss(faults=faults, **keywords)
    recording = scenario.sample([np.random.default_rng(2)])
    return recording.motion_inputs[0] - exact_samples(recording.truth[0], scenario.time)


def test_a_perfect_unit_is_perfect():
    assert np.abs(errors("none", imu_noise=(0, 0), imu_bias=(0, 0))).max() < 1e-9


@pytest.mark.parametrize("rate", [100.0, 25.0])
def test_white_noise_keeps_its_density(rate):
    off = errors("paper", rate=rate, measurement_rate=5.0)
    units = np.repeat([1.0, np.radians(1.0)], 3)
    np.testing.assert_allclose(off.mean(0) / units, 0.1, atol=0.04)  # the same in every episode
    np.testing.assert_allclose(off.std(0) / units, 0.3 * np.sqrt(rate / 100.0), rtol=0.06)


def test_bias_is_drawn_and_may_wander():
    units = np.repeat([1.0, np.radians(1.0)], 3)
    quiet = {"imu_noise": (0.0, 0.0)}
    bias = np.array([
        (samples - exact_samples(truth, TIME)).mean(0) / units
        for seed in range(2)
        for samples, truth in [_episode(InsGnss(faults="none", **quiet), seed)]
    ])  # fmt: skip
    assert np.ptp(bias, axis=0).min() > 1e-3 and 0.03 < bias.std() < 0.2
    still = errors("none", imu_bias=(0.5, 0.5), **quiet)
    assert np.abs(np.ptp(still, axis=0)).max() < 1e-9
    wander = errors("none", imu_bias=(0, 0), imu_instability=(0.2, 0.2), duration=600.0,
                    rate=10.0, **quiet) / units  # fmt: skip
    assert 0.08 < wander.std() < 0.35
    step = np.diff(wander, axis=0).std()
    assert step == pytest.approx(0.2 * np.sqrt(2.0 * 0.1 / 100.0), rel=0.1)


def _episode(scenario, seed):
    recording = scenario.sample([np.random.default_rng(seed)])
    return recording.motion_inputs[0], recording.truth[0]


# ----- fixes ----------------------------------------------------------------------------


def test_a_fix_falls_on_every_tenth_sample():
    recording = InsGnss(faults="none").sample([np.random.default_rng(0)])
    arrived = ~np.isnan(recording.measurement[0])
    assert arrived[::10].all() and arrived.sum() == 9 * 501
    assert recording.motion_inputs.shape == (1, 5001, 6)


def test_a_fix_has_its_noise():
    recording = InsGnss(faults="none").sample([np.random.default_rng(s) for s in range(4)])
    off = wrapped(recording.measurement - recording.truth)[:, ::10].reshape(-1, 9)
    units = np.array([100.0, 100.0, 150.0, 2.0, 2.0, 5.0, *np.radians([1.5] * 3)])
    np.testing.assert_allclose(off.std(0) / units, 1.0, atol=0.06)
    np.testing.assert_allclose(recording.noise[0, 0], units)


def test_what_the_filter_is_told_is_the_papers():
    """S4 Tables 1 and 2, as SPEC 7.1 reads them."""
    scenario = InsGnss(faults="paper")
    recording = scenario.sample([np.random.default_rng(0)])
    prior = np.repeat([100.0, 10.0, np.radians(10.0)], 3)
    np.testing.assert_allclose(recording.factor[0], np.diag(prior))
    noise = scenario.motion.build(scalar).noise_factor((0.0,) * 9, (0.0,) * 6, 0.01)
    second = np.repeat([10.0, 2.0, np.radians(0.5)], 3)
    np.testing.assert_allclose(noise, 0.1 * second)
    assert scenario.mixture == (0.15, 500.0)
    parts = np.square(recording.noise[0, 0]).reshape(3, 3).sum(axis=1)
    position, _, attitude = parts / parts.sum()  # of the trace of R, SPEC 6
    assert position == pytest.approx(0.9992, abs=5e-5) and attitude == pytest.approx(5e-8, rel=0.05)


def test_a_deviation_may_be_one_for_all_axes():
    one, three = InsGnss(gnss_noise=(3.0, 0.2, 1.0)), InsGnss(gnss_noise=[[3] * 3, 0.2, [1.0] * 3])
    np.testing.assert_array_equal(one.fix_deviations, three.fix_deviations)
    np.testing.assert_allclose(one.fix_deviations, np.repeat([3.0, 0.2, np.radians(1.0)], 3))


@pytest.mark.parametrize("by", ["vector", "channel"])
def test_outliers_are_a_mixture_inside_their_window(by):
    draft = Draft.clean(np.arange(200_000) / 100.0, 9)
    Outliers(start=500.0, duration=1000.0, by=by).apply(draft, np.random.default_rng(0))
    inside = (draft.time >= 500.0) & (draft.time < 1500.0)
    assert (draft.noise_factor[~inside] == 1.0).all()
    assert set(np.unique(draft.noise_factor)) == {1.0, np.sqrt(500.0)}
    hit = draft.noise_factor[inside] > 1.0
    assert hit.mean() == pytest.approx(0.15, abs=0.005)
    alike = (hit.all(axis=1) | ~hit.any(axis=1)).mean()
    assert alike == 1.0 if by == "vector" else alike < 0.3
    assert draft.intervals == [("outliers", 500.0, 1500.0)]


def test_interference_varies_its_mixture_inside_bursts():
    shares, factors, kinds = [], [], set()
    for seed in range(60):
        draft = Draft.clean(np.arange(50_000) / 100.0, 9)
        Interference(bursts=(1, 1)).apply(draft, np.random.default_rng(seed))
        ((_, start, stop),) = draft.intervals
        inside = (draft.time >= start) & (draft.time < stop)
        assert (draft.noise_factor[~inside] == 1.0).all()
        hit = draft.noise_factor[inside] > 1.0
        shares.append(hit.mean())
        factors.append(draft.noise_factor.max())
        kinds.add(bool((hit.all(axis=1) | ~hit.any(axis=1)).all()))
        assert len(np.unique(draft.noise_factor)) == 2
    assert min(shares) < 0.15 and max(shares) > 0.5 and kinds == {True, False}
    assert 3.0 <= min(factors) < 5.0 and 20.0 < max(factors) <= 31.0


@pytest.mark.parametrize(("kind", "first", "unit"), [
    (AccelerationStep, 0, 1.0), (RateStep, 3, np.radians(1.0)),
])  # fmt: skip
def test_a_step_of_the_unit(kind, first, unit):
    fault = kind(1.0, size=(2.0, 2.0), duration=(10.0, 10.0), start=10.0, axes=(0, 2))
    draft = Draft.clean(TIME, 9, motion_inputs=np.zeros((5001, 6)))
    fault.apply(draft, np.random.default_rng(0))
    inside = (TIME >= 10.0) & (TIME < 20.0)
    expected = np.zeros(6)
    expected[[first, first + 2]] = 2.0 * unit
    assert (draft.motion_inputs[inside] == expected).all()
    assert not draft.motion_inputs[~inside].any()
    assert draft.intervals == [(kind.label, 10.0, 20.0)] and (draft.noise_factor == 1.0).all()
    axes, present = set(), 0
    for seed in range(100):
        draft = Draft.clean(TIME, 9, motion_inputs=np.zeros((5001, 6)))
        kind().apply(draft, np.random.default_rng(seed))
        present += len(draft.intervals)
        moved = np.flatnonzero(np.abs(draft.motion_inputs).max(axis=0))
        axes.update((axis, np.sign(draft.motion_inputs[:, axis].sum())) for axis in moved)
    assert 30 < present < 70 and axes == {(first + k, s) for k in range(3) for s in (-1.0, 1.0)}


# ----- decisions ------------------------------------------------------------------------


def test_a_decision_concerns_one_fix():
    env = gym.make(INERTIAL, duration=3.0, faults="none").unwrapped
    heard = play(env, np.zeros((99, 5)), seed=0)
    assert len(heard) == 1 + 31 and heard[-1][3]
    pending = np.array([step[-1]["innovation_variance"] for step in heard[:-1]])
    assert np.isfinite(pending).all()
    np.testing.assert_allclose([step[-1]["time"] for step in heard[1:4]], [0.09, 0.19, 0.29])


def test_fading_acts_once_per_fix():
    """The engine stepped by hand, fading applied to the pending prediction only."""
    keywords = {"duration": 1.0, "faults": "none", "actions": ["fading"]}
    env = gym.make(INERTIAL, **keywords).unwrapped
    heard = play(env, np.full((99, 1), 0.3), seed=0)
    recording = draw(INERTIAL, [0], rate=100.0, **keywords)
    fading, status = 10.0**0.3, np.zeros(1, np.int64)
    tier, nominal = Engine(env.scenario.motion, env.scenario.sensor), Knobs.nominal(1)
    mean, factor = recording.mean, recording.factor
    for t in range(len(recording.time)):
        prediction = Prediction(mean, factor, np.zeros_like(factor))
        if t > 0:
            dt = recording.time[t : t + 1] - recording.time[t - 1 : t]
            prediction = tier.predict(mean, factor, recording.motion_inputs[:, t], dt, status)
        knobs = nominal._replace(fading=np.array([fading])) if t % 10 == 0 else nominal
        updated = tier.update(prediction, knobs, measured(recording, t), status)
        mean, factor = updated.mean, updated.factor
    np.testing.assert_allclose(heard[-1][4]["estimate"], mean[0], rtol=1e-9, atol=1e-9)


# ----- bad input ------------------------------------------------------------------------


@pytest.mark.parametrize(("keywords", "culprit"), [
    ({"measurement_rate": 0.0}, "measurement_rate must be a positive number"),
    ({"measurement_rate": 30.0}, "rate=100 is no multiple of measurement_rate=30"),
    ({"gnss_noise": (1.0, 1.0)}, "gnss_noise must hold three deviations (position in m"),
    ({"gnss_noise": (0.0, 1.0, 1.0)}, "gnss_noise"),
    ({"gnss_noise": ((1.0, 1.0), 1.0, 1.0)}, "gnss_noise"),
    ({"gnss_noise": ((1.0, 1.0, -1.0), 1.0, 1.0)}, "gnss_noise"),
    ({"gnss_noise": (1.0, "2", 1.0)}, "gnss_noise"),
    ({"process_noise": (1.0, -1.0, 1.0)}, "process_noise"),
    ({"imu_noise": 0.3}, "imu_noise must hold 2 numbers, zero or more (m/s^2, deg/s)"),
    ({"imu_bias": (0.1, -0.1)}, "imu_bias"),
    ({"imu_instability": (0.1, "a")}, "imu_instability"),
    ({"duration": 601.0}, "600 s"),
    ({"faults": {"outliers": {"by": "vectr"}}}, "'vectr'. Did you mean 'vector'"),
    ({"faults": {"outliers": {"share": 1.5}}}, "Outliers.share"),
    ({"faults": {"outliers": {"variance_ratio": 0.0}}}, "Outliers.variance_ratio"),
    ({"faults": {"interference": {"share": [0.5, 1.5]}}}, "Interference.share"),
    ({"faults": {"rate_step": {"axes": [3]}}}, "RateStep.axes"),
    ({"faults": {"acceleration_step": {"size": [0.0, 1.0]}}}, "AccelerationStep.size"),
    ({"faults": {"rate_step": {"probability": 2}}}, "RateStep.probability"),
])  # fmt: skip
def test_bad_arguments_are_named(keywords, culprit):
    assert culprit in complaint(ValueError, gym.make, INERTIAL, **keywords)
