"""kfenv beside other libraries' filters: one problem for all, and a word for what is missing."""

import sys
from pathlib import Path

import numpy as np
import pytest
from kfenv.agents import libraries
from kfenv.agents.libraries import Rival, compare, radar_problem
from kfenv.agents.library_filters import POSITION, Problem, filterpy

from kfenv.filters.reference import ReferenceFilter
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.own import recording_of


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(libraries, "EPISODES", 2)
    monkeypatch.setattr(libraries, "DURATION", 3.0)


def test_another_library_solves_the_same_problem():
    pytest.importorskip("filterpy")
    given = radar_problem()
    problem = Problem(**given)._replace(dt=float(given["dt"]))
    theirs = filterpy(problem).run()
    time = problem.dt * np.arange(problem.z.shape[1])
    ours = ReferenceFilter(variable_turn(1.0), radar(), "ukf-classical", kappa=1.0).run(
        recording_of(time, problem.z[:1], np.diag(problem.R), problem.mean[:1], np.diag(problem.P))
    )
    apart = np.linalg.norm((ours.mean[0] - theirs)[10:, POSITION], axis=1)
    error = np.linalg.norm((ours.mean[0] - problem.truth[0])[10:, POSITION], axis=1)
    assert apart.max() < 0.5 * error.max()  # theirs holds Q and predicts before the first update
    assert error.max() < 50.0


def test_what_cannot_be_installed_is_told(monkeypatch, tmp_path):
    pytest.importorskip("filterpy")
    monkeypatch.setattr(libraries, "environment", lambda folder: Path(sys.executable))
    monkeypatch.setattr(libraries, "ROUNDS", 1)
    bare = Rival("turbo_ckf", (), "one without its library")
    missing = Rival("filterpy", (str(tmp_path / "nowhere"),), "one that is nowhere")
    there, nowhere = compare(rivals=[bare, missing])
    assert "does not run" in there.speed and "turbo_ckf" in there.speed
    assert "not installed" in nowhere.speed and not nowhere.ratio
