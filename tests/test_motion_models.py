"""The motion and sensor models mean the same on every backend, and what the physics says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from pairs import beacon, robot

from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.markov_acceleration import markov_acceleration
from kfenv.models.namespaces import batch, compiled, dual, scalar
from kfenv.models.navigation_fix import navigation_fix
from kfenv.models.radar import radar
from kfenv.models.strapdown import strapdown
from kfenv.models.variable_turn import variable_turn

MOTIONS = {"constant acceleration": constant_acceleration(2.0), "variable turn": variable_turn(2.0),
           "markov acceleration": markov_acceleration(1.5, 10.0),
           "robot": robot(), "strapdown": strapdown((5.0, 3.0, 0.005))}  # fmt: skip
SENSORS = {"radar": (radar(), 9), "beacon": (beacon(), 4), "fix": (navigation_fix(), 9),
           "fix without attitude": (navigation_fix(attitude=False), 9)}  # fmt: skip
DT = 0.3


def states(n, count=20, seed=0):
    """Aircraft for nine states, robots for four; far from the floors of speed and range."""
    rng = np.random.default_rng(seed)
    if n == 9:
        return np.array([2e3, 60.0, 0.0] * 3) + rng.normal(size=(count, 9)) * ([3e3, 80.0, 5.0] * 3)
    return rng.normal(size=(count, 4)) * [10.0, 10.0, 1.0, 2.0]


def navigation_states():
    """Of a vehicle that is nowhere near straight up or down."""
    x = np.random.default_rng(2).uniform(-1.0, 1.0, size=(20, 9))
    return x * ([1e3] * 3 + [100.0] * 3 + [3.0, 1.2, 3.0])


def _cases():
    """(build the function on a namespace, states, known inputs, further arguments)."""
    rng = np.random.default_rng(1)
    for label, motion in MOTIONS.items():
        x = navigation_states() if label == "strapdown" else states(len(motion.states))
        u = rng.normal(size=(len(x), len(motion.inputs)))
        for i, name in enumerate(("step", "noise_factor")):

            def build(xp, motion=motion, i=i):
                return motion.build(xp)[i]

            yield pytest.param(build, x, u, (DT,), id=f"{label} {name}")
    for label, (sensor, n) in SENSORS.items():
        x = states(n)
        s = 20.0 * rng.normal(size=(len(x), len(sensor.inputs)))
        yield pytest.param(sensor.build, x, s, (), id=label)


CASES = list(_cases())


def on_batch(build, x, u, dt):
    return np.stack(build(batch)(tuple(x.T), tuple(u.T), *dt), axis=1)


def jacobian(build, x, u, dt):
    components = build(dual)(dual.seed(x), tuple(u.T), *dt)
    return np.stack([component.gradient for component in components], axis=1)


def called(inner):
    """What compiled code alone calls, for Python."""

    @njit
    def call(*arguments):
        return inner(*arguments)

    return call


@pytest.mark.parametrize(("build", "x", "u", "dt"), CASES)
@pytest.mark.parametrize("namespace", [scalar, compiled])
def test_one_at_a_time_equals_the_batch(namespace, build, x, u, dt):
    together = on_batch(build, x, u, dt)
    function = called(build(namespace)) if namespace is compiled else build(namespace)
    for row, state, inputs in zip(together, x, u, strict=True):
        alone = function(tuple(map(float, state)), tuple(map(float, inputs)), *dt)
        np.testing.assert_allclose(alone, row, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("build", "x", "u", "dt"), CASES)
def test_duals_carry_the_value_and_the_central_difference(build, x, u, dt):
    components = build(dual)(dual.seed(x), tuple(u.T), *dt)
    values = np.stack([component.value for component in components], axis=1)
    np.testing.assert_allclose(values, on_batch(build, x, u, dt), rtol=1e-14)
    slopes = jacobian(build, x, u, dt)
    for i in range(x.shape[1]):
        h = 1e-5 * max(1.0, np.abs(x[:, i]).max())
        ahead, behind = x.copy(), x.copy()
        ahead[:, i] += h
        behind[:, i] -= h
        difference = (on_batch(build, ahead, u, dt) - on_batch(build, behind, u, dt)) / (2.0 * h)
        scale = np.abs(difference).max(axis=0) + 1e-4
        assert np.max(np.abs(slopes[:, :, i] - difference) / scale) < 1e-4


@pytest.mark.parametrize(("build", "x", "u", "dt"), CASES)
def test_tensors_carry_the_value_and_the_gradient(build, x, u, dt):
    torch = pytest.importorskip("torch")
    from kfenv.models.namespaces import tensor

    known = tuple(torch.as_tensor(column) for column in u.T)
    state = [torch.tensor(column, requires_grad=True) for column in x.T]
    components = build(tensor)(tuple(state), known, *dt)
    slopes = jacobian(build, x, u, dt)
    for c, (component, expected) in enumerate(
        zip(components, on_batch(build, x, u, dt).T, strict=True)
    ):
        np.testing.assert_allclose(component.detach(), expected, rtol=1e-12)
        if not component.requires_grad:
            assert not slopes[:, c].any()
            continue
        gradients = torch.autograd.grad(
            component.sum(), state, retain_graph=True, allow_unused=True
        )
        for i, gradient in enumerate(gradients):
            found = 0.0 if gradient is None else gradient.numpy()
            np.testing.assert_allclose(found, slopes[:, c, i], rtol=1e-9, atol=1e-14)


def turn_jacobians(v, a):
    """dg/dv and dg/da of the jerk g(v, a) as SPEC 3.2 writes them."""
    v2, va, a2 = v @ v, v @ a, a @ a
    eye = np.eye(3)
    dg_da = 2.0 * (np.outer(a, v) + va * eye) / v2
    dg_da -= np.outer(v, 2.0 * va * v / v2**2 + 2.0 * a / v2)
    dg_dv = (
        2.0 * np.outer(a, a) / v2
        - 4.0 * va * np.outer(a, v) / v2**2
        - (va**2 / v2**2 + a2 / v2) * eye
        - np.outer(v, 2.0 * va * a / v2**2 - 4.0 * va**2 * v / v2**3 - 2.0 * a2 * v / v2**2)
    )
    return dg_dv, dg_da


def test_turn_model_has_the_published_jacobian():
    """The slope of the step's Jacobian at dt = 0 is the Jacobian of the differential equation."""
    x = states(9)

    def build(xp):
        return variable_turn().build(xp).step

    h, nothing = 1e-4, np.zeros((len(x), 0))
    rates = (jacobian(build, x, nothing, (h,)) - jacobian(build, x, nothing, (-h,))) / (2.0 * h)
    for rate, state in zip(rates, x, strict=True):
        dg_dv, dg_da = turn_jacobians(state[1::3], state[2::3])
        np.testing.assert_allclose(rate[2::3, 1::3], dg_dv, atol=1e-7)
        np.testing.assert_allclose(rate[2::3, 2::3], dg_da, atol=1e-7)
        np.testing.assert_allclose(rate[0::3, 1::3], np.eye(3), atol=1e-7)
        np.testing.assert_allclose(rate[1::3, 2::3], np.eye(3), atol=1e-7)


S0, S1, W = 130.0, 1.5, 0.05  # initial speed, its rate and the turn rate of the oracle


def exact_flight(t):
    """State after t of v(t) = (s0 + s1 t)(T cos wt + N sin wt) in a tilted plane."""
    tangent, normal = np.array([0.6, 0.64, 0.48]), np.array([-0.8, 0.48, 0.36])

    def integral(time):
        return ((S0 + S1 * time) / (1j * W) + S1 / W**2) * np.exp(1j * W * time)

    speed, turn = S0 + S1 * t, np.exp(1j * W * t)
    plane = (integral(t) - integral(0.0), speed * turn, (S1 + 1j * W * speed) * turn)
    x = np.zeros(9)
    for k, value in enumerate(plane):
        x[k::3] = value.real * tangent + value.imag * normal
    return x


def flight_error(dt, duration=20.0):
    """Position error of the model after the oracle's flight, m."""
    step = variable_turn().build(scalar).step
    x = tuple(exact_flight(0.0))
    for _ in range(round(duration / dt)):
        x = step(x, (), dt)
    return np.linalg.norm((np.array(x) - exact_flight(duration))[0::3])


def test_turn_model_flies_exact_turns():
    for dt, expected in ((2.0, 3.3e-3), (1.0, 2.0e-4), (0.5, 1.3e-5)):
        assert flight_error(dt) == pytest.approx(expected, rel=0.1)
    assert flight_error(0.1) < 2.5e-8


def test_turn_model_is_of_fourth_order():
    dt = np.array([2.0, 1.0, 0.5, 0.25])
    order = np.polyfit(np.log(dt), np.log([flight_error(h) for h in dt]), 1)[0]
    assert 3.9 < order < 4.1


@given(st.lists(st.floats(-1e4, 1e4), min_size=9, max_size=9))
@settings(max_examples=100, deadline=None)
def test_no_state_at_rest_or_overhead_is_singular(x):
    x[1::3] = [1e-3 * v for v in x[1::3]]  # below the floor of speed
    assert np.isfinite(variable_turn().build(scalar).step(tuple(x), (), 0.1)).all()
    assert np.isfinite(variable_turn().build(scalar).noise_factor(tuple(x), (), 0.1)).all()
    x[0] = x[3] = 0.0
    assert np.isfinite(radar().build(scalar)(tuple(x), ())).all()


def test_hard_acceleration_at_low_speed_does_not_explode():
    """A sigma point of a vague prior: unclipped, its speed would be 1e9 m/s after 10 s."""
    step = variable_turn().build(scalar).step
    x = (0.0, 100.0, 0.0, 0.0, 0.0, 1200.0, 0.0, 0.0, 0.0)
    for _ in range(40):
        x = step(x, (), 0.25)
    assert np.hypot(x[1], x[4]) < 1e5


def test_azimuth_is_clockwise_from_north_in_every_quadrant():
    measure = radar().build(scalar)
    x = [0.0] * 9
    x[0], x[3], x[6] = 3.0, -4.0, 5.0
    distance, azimuth, elevation = measure(tuple(x), ())
    assert np.degrees(azimuth) == pytest.approx(143.130102)  # arctan(x/y) would say -36.9
    assert (distance, np.degrees(elevation)) == (pytest.approx(np.sqrt(50.0)), pytest.approx(45.0))


@pytest.mark.parametrize("make", [constant_acceleration, variable_turn])
@pytest.mark.parametrize("density", [0.0, -1.0, float("nan"), float("inf")])
def test_a_bad_spectral_density_is_named(make, density):
    with pytest.raises(ValueError, match="spectral_density"):
        make(density)
