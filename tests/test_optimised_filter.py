"""Okf: constant Q and R by their factors; untuned it is a filter of constant process noise."""

import numpy as np
import pytest
from kfenv.agents.contest.rollout import draw_episodes, rollout
from kfenv.agents.contest.tuning import tune
from kfenv.agents.contestants.optimised import initial_noise_factor
from kfenv.agents.contestants.registry import make_agent

from kfenv.envs.options import split_keywords
from kfenv.scenarios.radar.bistatic import BistaticTracking

ENV, KEYWORDS = "kfenv/BistaticTracking-v0", {"duration": 20.0}
SCENARIO, OPTIONS = split_keywords(BistaticTracking, KEYWORDS)


@pytest.fixture(scope="module")
def recording():
    return draw_episodes(ENV, KEYWORDS, "tuning", 0, 8)


def test_untuned_it_is_the_nominal_filter_where_its_noise_is_constant(recording):
    okf, fixed = (rollout(make_agent(n), ENV, KEYWORDS, recording) for n in ("okf", "fixed"))
    np.testing.assert_allclose(okf.rmse, fixed.rmse, rtol=1e-9)


def test_its_noise_is_what_its_factors_say(recording):
    own, states = initial_noise_factor(SCENARIO, recording)[0], SCENARIO.motion.states
    a, b = states[4].name, states[1].name
    okf = make_agent("okf").with_values({f"q {a}": 3.0, f"q {a} {b}": np.exp(0.5)})
    factor = okf._process_noise(SCENARIO, recording)[0]
    size = np.linalg.norm(own, axis=1)
    expected = own.copy()
    expected[4] = 3.0 * (own[4] + 0.5 * size[4] / size[1] * own[1])
    np.testing.assert_allclose(factor, expected)
    assert np.all(np.linalg.eigvalsh(factor @ factor.T) > 0.0)


def test_all_of_q_and_r_is_tuned():
    n, m = len(SCENARIO.motion.states), len(SCENARIO.sensor.channels)
    parameters = make_agent("okf").tunable(SCENARIO, ())
    assert len({p.name for p in parameters}) == len(parameters) == n * (n + 1) // 2 + m


def test_tuning_lowers_the_error_it_is_tuned_on(recording):
    tuned = tune(make_agent("okf"), ENV, KEYWORDS, recording, trials=1, seed=0)
    before, after = (rollout(a, ENV, KEYWORDS, recording) for a in (make_agent("okf"), tuned))
    assert np.mean(np.log(after.rmse / before.rmse)) < -0.02
