"""Short runs stay what they were when they were committed, on every platform.

A failure means that a simulation or a filter gives other numbers. If that is meant, raise the
version of the environment's id and of the suites that meet it (for a filter alone: say so in the
commit), and renew the runs with ``pytest tests/test_golden.py --renew-golden``.

What a version draws is fixed for ever: ``golden/versions.json`` holds a hash of the recordings of
each version of an environment and of a suite. Renewing adds versions and changes none, so that a
changed simulation fails until its version rises; a changed filter leaves recordings as they are.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from kfenv.agents.contest.recording_hash import recording_hash
from kfenv.agents.contest.rollout import scenario_and_options
from kfenv.agents.contest.suites import SUITES
from kfenv.agents.contestants.registry import make_agent
from rollouts import (
    BISTATIC,
    TRACKING,
    draw,
    error_name,
    every_environment,
    make,
    play,
    random_actions,
    short,
)

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS
from kfenv.filters.designs import DESIGNS

GOLDEN = Path(__file__).with_name("golden")
VERSIONS = GOLDEN / "versions.json"
# Of the largest in a column: platforms differ in the last bits of sines and logarithms, 1e-16,
# and observations are single precision, 1e-7.
TOLERANCE = 1e-6
DECISIONS, EVERY = 12, 4


@pytest.fixture
def compare(request):
    """Compare a table with the committed one of that name, or renew that."""

    def with_golden(name, table):
        path = GOLDEN / f"{name}.csv"
        if request.config.getoption("--renew-golden"):
            np.savetxt(path, table, fmt="%.9g", delimiter=",")
        golden = np.loadtxt(path, delimiter=",")
        assert table.shape == golden.shape
        scale = np.nanmax(np.abs(golden), axis=0, initial=1e-12)
        np.testing.assert_allclose(table / scale, golden / scale, rtol=0.0, atol=TOLERANCE)

    return with_golden


@every_environment
def test_environment_is_as_committed(env_id, compare):
    """Observation, reward and error of each decision, with faults and knobs far from nominal."""
    env = make(env_id)
    actions = random_actions(env.action_space.shape, DECISIONS)
    _, *steps = play(env, actions, seed=0)
    rows = [[*seen, reward, info[error_name(env_id)]] for seen, reward, _, _, info in steps]
    assert len(rows) == DECISIONS
    compare(env_id.removeprefix("kfenv/"), np.array(rows, np.float64))


@pytest.mark.parametrize("design", [*DESIGNS, *ADAPTIVE_DESIGNS])
def test_design_is_as_committed(design, compare):
    """Mean and deviations of a filter's states at some instants of an episode."""
    env_id = BISTATIC if design == "lkf" else TRACKING
    history = make_agent(design).filter(
        *scenario_and_options(env_id, short(env_id)), draw(env_id, [0])
    )
    variance = np.diagonal(history.covariance[0], axis1=1, axis2=2)
    compare(design, np.hstack([history.mean[0], np.sqrt(variance)])[::EVERY])


def check_version(name, drawn, path, renew):
    """Complain if a version draws other recordings than it ever did; a new one is written down."""
    known = json.loads(path.read_text())
    if renew:
        known = {name: drawn} | known
        path.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")
    assert known.get(name) == drawn, (
        f"{name} draws {drawn}, and what it has always drawn is {known.get(name)}: a changed "
        "simulation needs another version, of the environment's id or of the suite"
    )


@every_environment
def test_the_simulation_is_that_of_the_environments_version(env_id, request):
    drawn = recording_hash([draw(env_id, [0, 1]), draw(env_id, [2], faults="random")])
    check_version(env_id, drawn, VERSIONS, request.config.getoption("--renew-golden"))


@pytest.mark.parametrize("name", SUITES)
def test_recordings_are_those_of_the_suites_version(name, request):
    suite = SUITES[name]
    versioned = f"suite {name}, version {suite.version}"
    check_version(versioned, suite.recordings, VERSIONS, request.config.getoption("--renew-golden"))


def test_a_changed_simulation_fails_until_its_version_rises(tmp_path):
    path = tmp_path / "versions.json"
    path.write_text('{"A-v0": "1"}')
    check_version("A-v0", "1", path, False)
    for renew in (False, True):
        with pytest.raises(AssertionError, match="needs another version"):
            check_version("A-v0", "2", path, renew)
    with pytest.raises(AssertionError):
        check_version("A-v1", "2", path, False)
    check_version("A-v1", "2", path, True)
    check_version("A-v1", "2", path, False)
    assert json.loads(path.read_text()) == {"A-v0": "1", "A-v1": "2"}
