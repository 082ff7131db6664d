"""One sentence for each mistake in a user's own model."""

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.contest.rollout import scenario_and_options
from kfenv.agents.contestants.registry import make_agent
from numpy_models import DT, SWING, linear, linear_models, numpy_pendulum, swing
from pairs import PAIRS
from rollouts import OWN

from kfenv.envs.loop import make_filter
from kfenv.filters.engine import Engine
from kfenv.filters.pointwise import PointwiseFilter
from kfenv.models.model import Component
from kfenv.models.own import own_motion, own_sensor
from kfenv.models.turns import undeclared_angles
from kfenv.scenarios.own import OwnFilter, simulate


def a_branch(xp):
    @xp.function
    def step(x, u, dt):
        return (x[0] if x[0] > 0.0 else -x[0], x[1])

    return step


def a_math_function(xp):
    from math import sin

    @xp.function
    def step(x, u, dt):
        return sin(x[0]), x[1]

    return step


def a_numpy_function(xp):
    @xp.function
    def step(x, u, dt):
        return np.sin(x[0]), x[1]

    return step


def a_missing_function(xp):
    @xp.function
    def step(x, u, dt):
        return xp.tanh(x[0]), x[1]

    return step


def too_few(xp):
    @xp.function
    def step(x, u, dt):
        return (x[0],)

    return step


def a_list(xp):
    @xp.function
    def step(x, u, dt):
        return [x[0], x[1]]

    return step


def undecorated(xp):
    def step(x, u, dt):
        return x[0], x[1]

    return step


def other_states(xp):
    @xp.function
    def step(x, u, dt):
        a, b, c = x
        return a, b + c

    return step


def an_input_too_many(xp):
    @xp.function
    def step(x, u, dt):
        return x[0] + u[0], x[1]

    return step


@pytest.mark.parametrize(("f", "words"), [
    (a_branch, r"f \(line \d+ of test_own_mistakes.py\) branches on a component.*xp.maximum"),
    (a_math_function, r"f \(line \d+.*gives a component to a function for single numbers.*`math`"),
    (a_numpy_function, r"f .*gives a component to NumPy.*namespace's functions"),
    (a_missing_function, r"f .*asks the namespace for tanh, and it has .*sqrt"),
    (too_few, r"f returns 1 components for 2 states \(a, b\): return one for each"),
    (a_list, r"f returns a list, expected a tuple of 2 components \(a, b\)"),
    (undecorated, r"f\(xp\) gives a function without a decorator.*@xp.function"),
    (other_states, r"f .*other components than it is given, which are 2 states and 0 inputs"),
    (an_input_too_many, r"f .*other components than it is given, which are 2 states and 0 inputs"),
    (lambda x, u, dt: x[:1], r"f gives an array of shape \(1,\).*there are 2 states"),
    (lambda x, u, dt: np.array([x[0], x[2]]), r"f fails for a state of shape \(2,\).*IndexError"),
    (lambda x, u: x, r"f\(xp\) or f\(x, u, dt\)"),
    (3, r"f\(xp\) or f\(x, u, dt\), got 3"),
])  # fmt: skip
def test_a_mistake_in_a_function_is_one_sentence(f, words):
    with pytest.raises(ValueError, match=words) as caught, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        own_motion(("a", "b"), f, (1.0, 1.0))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("h", [lambda x: x[:1], lambda x: np.array([x[0] + 1.0]), lambda x: 2 * x])
def test_a_sensor_as_other_libraries_have_it_is_told_its_form(h):
    with pytest.raises(ValueError, match=r"h .*of one argument is given the namespace.*h\(x, s\)"):
        own_sensor(("a",), h, 2)


def test_what_only_the_compiler_refuses_is_one_sentence_too():
    def f(xp):
        def half(value):  # lacks its decorator
            return 0.5 * value

        @xp.function
        def step(x, u, dt):
            return (half(x[0]),)

        return step

    engine = Engine(own_motion(("a",), f, (1.0,)), own_sensor(("a",), a_copy, 1))
    still, sound = np.zeros((1, 1)), np.zeros(1, np.int64)
    words = r"cannot compile the model: 'half' .*@xp\.function"
    with pytest.raises(ValueError, match=words) as told:
        engine.predict(still, np.ones((1, 1, 1)), np.zeros((1, 0)), np.full(1, DT), sound)
    assert "\n" not in str(told.value)


def a_copy(xp):
    @xp.function
    def measure(x, s):
        return (x[0],)

    return measure


@pytest.mark.parametrize(("Q", "words"), [
    ([[1.0, 2.0], [2.0, 1.0]], r"Q must not have a negative eigenvalue.*smallest.* is -1"),
    ((1.0, 2.0, 3.0), r"Q has shape \(3,\), expected \(2, 2\)"),
    ([[1.0, 0.5], [0.0, 1.0]], r"Q is not symmetric"),
    ((1.0, np.nan), r"Q holds NaN"),
    ("big", r"Q must be an array of numbers"),
])  # fmt: skip
def test_a_covariance_that_is_none_is_refused(Q, words):
    with pytest.raises(ValueError, match=words):
        own_motion(("a", "b"), lambda x, u, dt: x, Q)


@pytest.mark.parametrize(("changes", "words"), [
    ({"scored": ("angel",)}, "Unknown state to be scored 'angel'. Did you mean 'angle'"),
    ({"scored": "angle"}, "scored must name the states.*as a tuple"),
    ({"scored": None}, "scored must name the states"),
    ({"scale": None}, "scale must be the error that is just good enough"),
    ({"scored": ("angle", "rate")}, r"one number for each of angle \(rad\), rate \(rad/s\)"),
    ({"scale": (0.1, 0.2)}, "scale has 2 numbers for 1 scored"),
    ({"lost": 0.5}, "lost must be a number of scales above 1"),
    ({"R": (0.0,)}, "R must be positive definite"),
    ({"P": ((1.0, 2.0), (2.0, 1.0))}, "P must be positive definite"),
    ({"mean": (1.0,)}, "mean must hold a number for each of angle, rate"),
    ({"R": None}, "R must be given to simulate the model"),
    ({"motion": "no_such_module:it"}, "motion='no_such_module:it' leads nowhere"),
    ({"motion": 3}, "motion must be a Motion"),
    ({"sensor": None}, "sensor must be a Sensor"),
    ({"recording": 3}, "recording must be a kfenv Recording"),
    ({"measure_every": 0}, "measure_every must be a whole number"),
    ({"scored_rates": ("angle", "rate")}, "scored_rates must name a state for each of the 1"),
])  # fmt: skip
def test_a_wrong_argument_is_one_sentence(changes, words):
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    with pytest.raises(ValueError, match=words):
        gym.make(OWN, **(kwargs | changes))


def test_an_angle_that_is_not_declared_is_found():
    motion, _ = numpy_pendulum()
    plain = own_sensor((Component("angle", "rad"),), lambda x, s: x[:1], 2)
    with pytest.raises(ValueError, match="'angle' jumps by a turn and is not declared an angle"):
        simulate(motion, plain, "none", **(SWING | {"mean": (3.1, 4.0)}))


@pytest.mark.parametrize(("angles", "found"), [
    ((False, False), ["state 'angle'", "channel 'angle'"]),
    ((True, False), ["channel 'angle'"]),
    ((True, True), []),
])  # fmt: skip
def test_an_angle_declared_nowhere_is_found_by_a_turn_more_of_it(angles, found):
    state, channel = (Component("angle", "rad", angle=angle) for angle in angles)
    motion = own_motion((state, "rate"), swing, Q=(0.0, 1e-3))
    sensor = own_sensor((channel,), lambda x, s: x[:1], states=2)
    assert undeclared_angles(motion, sensor) == found
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        OwnFilter(motion=motion, sensor=sensor, scored=("angle",), scale=0.05, **SWING)
    assert [str(warning.message).partition(" is")[0].partition(" are")[0] for warning in told] == (
        [f"The {', the '.join(found)}"] if found else []
    )


@pytest.mark.parametrize("name", PAIRS)
def test_what_is_no_angle_or_declared_one_is_not_taken_for_one(name):
    motion, sensor, _ = PAIRS[name]
    assert undeclared_angles(motion, sensor) == []
    bare = [replace(part, angle=False) for part in motion.states]
    angles = [f"state {state.name!r}" for state in motion.states if state.angle]
    found = undeclared_angles(replace(motion, states=tuple(bare)), sensor)
    assert [one for one in found if "state" in one] == angles


def test_correlated_noise_has_a_remedy():
    motion, sensor = linear_models(*linear(2, 2)[:3])
    with pytest.raises(ValueError, match=r"R must be diagonal.*inverse of its Cholesky factor"):
        simulate(motion, sensor, R=[[1.0, 0.5], [0.5, 1.0]], mean=(0.0, 0.0), P=(1.0, 1.0))


def test_missing_inputs_are_asked_for():
    motion = own_motion(("a",), lambda x, u, dt: x + u, (1.0,), inputs=("push",))
    sensor = own_sensor(("a",), lambda x, s: x, 1)
    with pytest.raises(ValueError, match=r"inputs must be an array of shape \(41, 1\) \(push at"):
        simulate(motion, sensor, R=(1.0,), mean=(0.0,), P=(1.0,), duration=4.0, rate=10.0)
    told = {"R": (1.0,), "mean": (0.0,), "P": (1.0,), "duration": 4.0, "rate": 10.0}
    with pytest.raises(ValueError, match=r"inputs must be an array of shape \(41, 1\)"):
        simulate(motion, sensor, inputs={"push": 1}, **told)


def test_who_needs_the_engine_refuses_numpy_models():
    motion, sensor = numpy_pendulum()
    kwargs = {"motion": motion, "sensor": sensor, "scored": ("angle",), "scale": 0.05} | SWING
    scenario, options = scenario_and_options(OWN, kwargs)
    assert isinstance(make_filter(scenario, options), PointwiseFilter)
    with pytest.raises(ValueError, match="okf works with the compiled filter, which cannot run"):
        make_agent("okf").check(scenario, options, simulate(motion, sensor, **SWING))
    with pytest.raises(ValueError, match=r"the compiled engine cannot run.*f\(xp\)"):
        Engine(motion, sensor)
