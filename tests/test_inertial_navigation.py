"""The strapdown mechanisation: rotations, signs, errata, noise, and an independent library."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pairs import PAIRS, Case
from scipy.spatial.transform import Rotation

from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs
from kfenv.models.namespaces import batch, scalar
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.rotations import (
    angles_from_matrix,
    exponential,
    exponential_as_printed,
    logarithm,
    matrix_from_angles,
)
from kfenv.models.strapdown import GRAVITY, mechanise, step_as_printed, strapdown
from kfenv.scenarios.inertial.flights import exact_samples, random_flight

PROCESS = (5.0, 3.0, 0.005)  # m, m/s, rad after a second

# ----- rotations ------------------------------------------------------------------------


def vectors(size):
    direction = np.random.default_rng(0).normal(size=(200, 3))
    return size * direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.11, 1.0])
def test_the_exponential_is_a_turn_by_its_vector(size):
    expected = Rotation.from_rotvec(vectors(size)).as_matrix()
    assert np.abs(exponential(vectors(size)) - expected).max() < 5e-16
    np.testing.assert_allclose(logarithm(expected), vectors(size), rtol=1e-7, atol=1e-15)


def test_the_printed_exponential_turns_backwards():
    """S4 eq 5 at a turn of 0.11 rad: wrong by twice the sine, the right one by nothing."""
    expected = Rotation.from_rotvec(vectors(0.11)).as_matrix()
    wrong = exponential_as_printed(vectors(0.11))
    x, y, z = vectors(0.11).T / 0.11
    axis = np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]).transpose(2, 0, 1)
    printed = np.eye(3) - np.sin(0.11) * axis + (1.0 - np.cos(0.11)) * axis @ axis
    np.testing.assert_allclose(wrong, printed, atol=1e-15)
    assert 0.15 < np.abs(wrong - expected).max() < 2.0 * np.sin(0.11) + 1e-9
    np.testing.assert_allclose(wrong, expected.transpose(0, 2, 1), atol=1e-15)


def test_angles_are_roll_pitch_yaw_of_the_sequence_3_2_1():
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 3)) * [3.1, 1.5, 3.1]
    C = matrix_from_angles(angles)
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    np.testing.assert_allclose(C, expected, atol=1e-15)
    np.testing.assert_allclose(angles_from_matrix(C), angles, atol=1e-13)
    nose_up = matrix_from_angles([0.0, 0.1, 0.0]) @ [1.0, 0.0, 0.0]
    assert nose_up[2] < 0.0  # down is positive


# ----- mechanisation --------------------------------------------------------------------


def fly(state, sample, duration, dt=0.01):
    time = np.arange(round(duration / dt) + 1) * dt
    return mechanise(np.asarray(state, float), np.tile(sample, (len(time), 1)), time)[-1]


def test_at_rest_and_level_nothing_moves():
    rest = np.zeros(9)
    held = [0.0, 0.0, -GRAVITY, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(fly(rest, held, 10.0), rest)
    assert step_as_printed(rest, np.array(held), 0.01)[5] == pytest.approx(-0.02 * GRAVITY)


def test_free_fall_is_exact():
    x = fly([0, 0, -1000, 30, 0, 0, 0.3, -0.2, 1.0], np.zeros(6), 4.0)
    np.testing.assert_allclose(x[:6], [120, 0, -1000 + 8 * GRAVITY, 30, 0, 4 * GRAVITY], rtol=1e-12)


def test_a_level_turn_closes():
    """A body that yaws at w and feels w v to its right flies a circle."""
    w, v = 0.1, 50.0
    full = 2.0 * np.pi / w
    steps = 5000
    time = np.linspace(0.0, full, steps + 1)
    # over one step the circle's velocity changes by the chord: sinc of half the turn
    shrink = np.sin(0.5 * w * time[1]) / (0.5 * w * time[1])
    sample = [0.0, w * v * shrink, -GRAVITY, 0.0, 0.0, w]
    start = np.array([0, 0, 0, v, 0, 0, 0, 0, 0.0])
    states = mechanise(start, np.tile(sample, (steps + 1, 1)), time)
    np.testing.assert_allclose(states[-1, :6], start[:6], atol=1e-7)
    half = states[steps // 2]
    np.testing.assert_allclose(half[3:6], [-v, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(half[:3], [0.0, 2.0 * v / w, 0.0], atol=1e-2)


def test_the_step_is_of_second_order():
    def error(dt):
        time = np.arange(round(4.0 / dt) + 1) * dt
        middle = time - 0.5 * dt
        forces = [np.sin(middle), 0.3 * middle, -GRAVITY + 0.0 * middle]
        rates = [0.5 * np.cos(middle), 0.3 + 0.0 * middle, 0.2 * middle]
        samples = np.stack(forces + rates, axis=1)
        return mechanise(np.array([0, 0, 0, 9.0, 0, 0, 0.1, 0.2, 0.3]), samples, time)[-1]

    reference = error(1.0 / 1024.0)
    coarse, fine = (np.linalg.norm((error(dt) - reference)[:6]) for dt in (1 / 16, 1 / 32))
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
@settings(max_examples=50, deadline=None)
def test_straight_up_is_finite(roll, yaw):
    step = strapdown(PROCESS).build(scalar).step
    for pitch in (np.pi / 2.0, -np.pi / 2.0):
        x = step((0.0,) * 6 + (roll, pitch, yaw), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01)
        assert np.isfinite(x).all() and x[7] == pytest.approx(pitch, abs=1e-7)


# ----- against an independent library ------------------------------------------------------

LATITUDE, HEIGHT = 45.0, 1000.0  # deg, m


def by_pyins(start, samples, dt):
    """States (T, 9) by pyins on a turning ellipsoid, position as the way travelled."""
    pandas, strapdown = pytest.importorskip("pandas"), pytest.importorskip("pyins.strapdown")
    theta = samples[1:, 3:] * dt
    dv = samples[1:, :3] * dt
    dv = dv + 0.5 * np.cross(theta, dv)  # force and rate constant over the step
    index = pandas.Index(dt * np.arange(len(samples)), name="time")
    increments = pandas.DataFrame(
        np.hstack([np.full((len(theta), 1), dt), theta, dv]), index[1:],
        ["dt", *(f"theta_{axis}" for axis in "xyz"), *(f"dv_{axis}" for axis in "xyz")],
    )  # fmt: skip
    pva = [LATITUDE, 7.0, HEIGHT, *start[3:6], *np.degrees(start[6:])]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    integrator = strapdown.Integrator(pandas.Series(pva, names, name=0.0))
    trajectory = integrator.integrate(increments)[names].to_numpy()
    velocity = trajectory[:, 3:6]
    travelled = np.cumsum(0.5 * dt * (velocity[1:] + velocity[:-1]), axis=0)
    position = start[:3] + np.vstack([np.zeros(3), travelled])
    return np.hstack([position, velocity, np.radians(trajectory[:, 6:])])


def with_earth(state, sample):
    """The sample as it would be felt on a flat Earth at rest: less Earth and transport rate,
    Coriolis force, and the difference of WGS 84's gravity from 9.81 m/s^2."""
    from pyins import earth

    north, _, down, vn, ve, vd = state[:6]
    latitude, height = LATITUDE + np.degrees(north / 6.37e6), HEIGHT - down
    rn, re, _ = earth.principal_radii(latitude, height)
    sine, cosine = np.sin(np.radians(latitude)), np.cos(np.radians(latitude))
    spin = earth.RATE * np.array([cosine, 0.0, -sine])
    transport = np.array([ve / re, -vn / rn, -ve / re * sine / cosine])
    push = -np.cross(2.0 * spin + transport, [vn, ve, vd])
    push[2] += earth.gravity(latitude, height) - GRAVITY
    C = matrix_from_angles(state[6:])
    return sample + np.concatenate([C.T @ push, -C.T @ (spin + transport)])


def test_the_difference_to_pyins_is_earth_rate_transport_rate_and_gravity():
    dt = 0.01
    time = dt * np.arange(6001)  # 60 s
    flight = random_flight(np.random.default_rng(3), time)
    flight[:, 2] -= flight[0, 2]
    samples = exact_samples(flight, time)
    theirs = by_pyins(flight[0], samples, dt)
    raw = theirs[-1, :3] - flight[-1, :3]
    assert 5.0 < np.linalg.norm(raw) < 50.0  # what the model leaves out in a minute, m
    step = strapdown(PROCESS).build(scalar).step
    ours = [flight[0]]
    for sample in samples[1:]:
        ours.append(np.array(step(tuple(ours[-1]), tuple(with_earth(ours[-1], sample)), dt)))
    off = np.array(ours) - theirs
    off[:, 6:] = np.angle(np.exp(1j * off[:, 6:]))
    assert np.abs(off[:, :3]).max() < 0.01
    assert np.abs(off[:, 3:6]).max() < 1e-3 and np.abs(off[:, 6:]).max() < 3e-6


# ----- process noise --------------------------------------------------------------------


def covariance(motion, dt):
    entries = motion.build(batch).noise_factor((np.zeros(1),) * 9, (np.zeros(1),) * 6, dt)
    factor = np.zeros((9, 9))
    for (row, column), entry in zip(motion.noise_pattern, entries, strict=True):
        factor[row, column] = entry[0]
    return factor @ factor.T


def test_process_noise_is_a_deviation_per_root_second_or_per_step():
    deviations = (3.0, 0.5, 0.01)
    squares = np.repeat(np.square(deviations), 3)
    Q = covariance(strapdown(deviations), 0.04)
    np.testing.assert_allclose(Q, np.diag(0.04 * squares), rtol=1e-14)
    Q = covariance(strapdown(deviations, per_step=True), 0.04)
    np.testing.assert_allclose(Q, np.diag(squares), rtol=1e-14)


@pytest.mark.parametrize("bad", [(1.0, 1.0), (1.0, 0.0, 1.0), (1.0, -1.0, 1.0), (1, np.nan, 1)])
def test_bad_process_noise_is_named(bad):
    with pytest.raises(ValueError, match="process_deviation must hold three positive"):
        strapdown(bad)


# ----- in the filter --------------------------------------------------------------------


def test_the_filter_wraps_attitude():
    """Yaw believed at 179 deg and measured at -179: two degrees, not 358."""
    tier = Engine(*PAIRS["strapdown, navigation fix"][:2])
    mean = np.zeros((1, 9))
    mean[0, [6, 8]] = np.radians(179.0), np.radians(-179.0)
    factor = np.diag([1.0] * 6 + [0.1] * 3)[None]
    z = np.full((1, 1, 9), np.nan)
    z[0, 0, [6, 8]] = np.radians(-179.0), np.radians(179.0)
    u, s, sd = np.zeros((1, 1, 6)), np.zeros((1, 1, 0)), np.full((1, 1, 9), 1e-3)
    run = tier.run(Case(mean, factor, np.zeros(1), u, s, z, sd, Knobs.nominal(1)))
    np.testing.assert_allclose(np.degrees(run.mean[0, 0, [6, 8]]), [-179.0, 179.0], atol=1e-3)
    assert run.nis[0, 0] == pytest.approx(2.0 * np.radians(2.0) ** 2 / 0.01, rel=1e-3)


def test_channels_and_groups():
    whole, reduced = navigation_fix(), navigation_fix(attitude=False)
    assert whole.groups == ("position", "velocity", "attitude")
    assert [channel.angle for channel in whole.channels] == [False] * 6 + [True] * 3
    assert reduced.groups == ("position", "velocity") and len(reduced.channels) == 6
