"""The position NEES holds for covariances that no product of factors can carry."""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from rollouts import TRACKING, change, draw, make, make_vec, zeros

from kfenv.envs import scoring
from kfenv.models.yardstick import lines_of

ROOT = Path(__file__).parents[1]
POSITION = np.arange(3)
# Rows of a lower factor: what the product of the rows loses of it.
HARD = {
    "correlated axes": [[1e8, 0, 0], [1e8, 1, 0], [1e8, 1, 1]],
    "1e4 m along, 1e-5 m across": [[6e3, 0, 0], [8e3, 1e-7 / 6, 0], [3e2, 2e-7, 1e-5]],
    "far apart": [[1e-9, 0, 0], [0, 1e9, 0], [1e-9, 1e9, 1.0]],
}


def nees_of(factor, error, position=POSITION):
    """What the environment makes of an estimate at the origin."""
    states, out = len(factor[0]), np.zeros((2, 1))
    truth = np.zeros((1, states))
    truth[0, position] = np.negative(error)
    factor = np.array([factor], float)
    lines = lines_of(position, np.array(position) + 1, np.zeros(3))
    scoring.score(
        np.zeros((1, states)), factor, truth, lines, np.ones(3), np.zeros(1, np.int64), *out
    )
    return float(out[1, 0])


def exact_nees(factor, error, position=POSITION):
    """The same in fractions, by elimination in the covariance."""
    rows = [[Fraction(x) for x in factor[i]] for i in position]
    table = [
        [sum(a * b for a, b in zip(one, other, strict=True)) for other in rows] + [Fraction(e)]
        for one, e in zip(rows, error, strict=True)
    ]
    total = Fraction(0)
    for i in range(3):
        total += table[i][3] ** 2 / table[i][i]
        for j in range(i + 1, 3):
            share = table[j][i] / table[i][i]
            table[j] = [a - share * b for a, b in zip(table[j], table[i], strict=True)]
    return float(total)


@pytest.mark.parametrize("name", HARD)
def test_nees_of_a_hard_factor_is_exact(name):
    for error in ([1.0, -2.0, 0.5], [3e7, 1e7, -2e7], [1e-5, 1e-5, 0.0]):
        expected = exact_nees(HARD[name], error)
        assert nees_of(HARD[name], error) == pytest.approx(expected, rel=1e-9)


def test_nees_of_positions_anywhere_in_the_state():
    rng = np.random.default_rng(0)
    for position in ([0, 3, 6], [2, 5, 1], [8, 4, 0]):
        factor = np.tril(rng.normal(size=(9, 9))) + 3.0 * np.eye(9)
        error = rng.normal(size=3)
        told = nees_of(factor, error, np.array(position))
        assert told == pytest.approx(exact_nees(factor, error, position), rel=1e-12)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e200])
def test_what_is_no_covariance_has_no_nees(value):
    assert np.isnan(nees_of([[1, 0, 0], [1, value, 0], [1, 0, 1]], [1.0, 1.0, 1.0]))


def test_a_degenerate_start_does_not_end_the_batch():
    def correlate(factor):
        factor[1, position[0], position[0]] = 1e8
        factor[1, position[1], position[:2]] = 1e8, 1.0

    def go_missing(measurement):
        measurement[1] = np.nan

    position = list(make(TRACKING).scenario.motion.position)
    recording = change(draw(TRACKING, range(3)), factor=correlate, measurement=go_missing)
    others = {"nees": [], "position_error": []}
    for chosen in ([0, 1, 2], [0, 2]):
        env = make_vec(TRACKING, len(chosen), recording=recording[chosen])
        infos = [env.reset()[1], env.step(zeros(env))[4]]
        for name, found in others.items():
            found.append(np.array([info[name] for info in infos]))
    assert np.isfinite(others["nees"][0][0]).all()
    for together, alone in others.values():
        np.testing.assert_array_equal(together[:, [0, 2]], alone)


def test_no_compiled_function_ends_a_batch_by_a_division():
    compiled = [
        (path.name, line)
        for folder in ("kfenv", "agents")
        for path in (ROOT / folder).rglob("*.py")
        for line in path.read_text().splitlines()
        if re.match("@njit|.*= njit|.*return njit", line)
    ]
    assert len(compiled) > 60
    for where, line in compiled:
        known = 'error_model="numpy"|FLOATING_POINT|INNER|KERNEL|ENTRY_POINT'
        assert re.search(known, line), (where, line)
