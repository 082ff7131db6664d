"""The zero action is the nominal fixed filter, every other one turns its knob as documented."""

import numpy as np
import pytest
from rollouts import change, draw, every_environment, make, make_vec, zeros

from kfenv.envs.knobs import LEAST_FADING, MOST_FADING, NOISE_RANGE, PROCESS_NOISE
from kfenv.filters.engine import Engine
from kfenv.filters.protocol import Knobs

SEEDS = range(3)


def ranges(env_id):
    """The knobs by name, and the factors at their ends."""
    return {
        "fading": (LEAST_FADING, MOST_FADING),
        "process_noise": (PROCESS_NOISE.low, PROCESS_NOISE.high),
        **{f"{group}_noise": NOISE_RANGE for group in make(env_id).scenario.sensor.groups},
    }


def nominal_run(env_id, recording, noise_scale=1.0, fading=1.0, process_scale=1.0):
    scenario = make(env_id).scenario
    recording = change(recording, noise=noise_scale * recording.noise)
    ones = np.ones(len(recording))
    knobs = Knobs(fading * ones, process_scale * ones)
    return Engine(scenario.motion, scenario.sensor).run(recording, knobs)


def estimates(env_id, action, **keywords):
    """Those of whole episodes under a constant action: (B, T, 9)."""
    env = make_vec(env_id, len(SEEDS), **keywords)
    env.reset(seed=SEEDS[0])
    actions = np.broadcast_to(action, env.action_space.shape)
    heard, over = [], np.zeros(len(SEEDS), bool)
    while not over.any():
        _, _, terminated, over, info = env.step(actions)
        assert not terminated.any()
        heard.append(info["estimate"])
    assert over.all()
    return np.stack(heard, axis=1)


@every_environment
@pytest.mark.parametrize("rate", [10.0, 2.0])
@pytest.mark.parametrize("action", [0.0, -0.0])
def test_zero_is_the_engine_with_unit_knobs(env_id, rate, action):
    keywords = {"duration": 120.0, "rate": rate}
    run = nominal_run(env_id, draw(env_id, SEEDS, **keywords))
    assert not run.status.any()
    np.testing.assert_allclose(
        estimates(env_id, action, **keywords), run.mean, rtol=1e-12, atol=1e-12
    )


@every_environment
def test_every_knob_turns_the_filter(env_id):
    zero = estimates(env_id, 0.0)
    for knob in ranges(env_id):
        for action in (1e-3, -1e-3):
            assert np.abs(estimates(env_id, action, actions=[knob]) - zero).max() > 1e-6, knob


@every_environment
@pytest.mark.parametrize("action", [0.02, -0.4])
def test_all_knobs_do_what_they_say(env_id, action):
    """A constant action is the engine run with its factors."""
    factor = {name: high**action if action > 0 else low**-action
              for name, (low, high) in ranges(env_id).items()}  # fmt: skip
    channels = make(env_id).scenario.sensor.channels
    noise_scale = [factor[f"{channel.group}_noise"] for channel in channels]
    run = nominal_run(
        env_id, draw(env_id, SEEDS), noise_scale, factor["fading"], factor["process_noise"]
    )
    np.testing.assert_allclose(estimates(env_id, action), run.mean, rtol=1e-9, atol=1e-9)


@every_environment
def test_info_tells_the_knobs_applied(env_id):
    env = make(env_id)
    assert "knobs" not in env.reset(seed=0)[1]
    rng, zero = np.random.default_rng(0), zeros(env)
    known = ranges(env_id)
    for action in [*rng.uniform(-1, 1, (10, *zero.shape)), zero + 1.0, zero - 1.0, zero]:
        env.reset(seed=0)  # a bad action may have lost the track
        told = env.step(action)[4]["knobs"]
        assert list(told) == list(known)
        for a, (name, (low, high)) in zip(action, known.items(), strict=True):
            assert told[name] == pytest.approx(high**a if a >= 0 else low**-a, rel=1e-12)
    assert told == dict.fromkeys(known, 1.0)  # of the zero action, exactly


@every_environment
def test_an_action_beyond_the_space_is_taken_to_its_edge(env_id):
    one, other = make(env_id), make(env_id)
    one.reset(seed=0), other.reset(seed=0)
    shape = one.action_space.shape
    beyond = one.step(np.resize([9.0, -9.0, np.inf, -np.inf], shape))[4]
    edge = other.step(np.resize([1.0, -1.0, 1.0, -1.0], shape))[4]
    assert beyond["knobs"] == edge["knobs"]
