"""A filter that fails is named with its time and reason, and the others never notice."""

import numpy as np
import pytest
from pairs import radar_case

from kfenv.filters.engine import Engine
from kfenv.filters.matrices import cholesky, downdate, solve
from kfenv.filters.protocol import measured
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.results import FAILURES, Prediction, describe_failures
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

VICTIM, OTHERS, WHEN = 2, [0, 1, 3, 4], 7
TIERS = ["engine", "srukf-joseph-exact", "srukf-classical", "ukf-classical", "ekf-joseph"]


def make(tier):
    pair = variable_turn(), radar()
    return Engine(*pair) if tier == "engine" else ReferenceFilter(*pair, tier)


def case_with(field, value, at=WHEN):
    """A recording in which one filter's entry (a time, or a state) is spoilt."""
    case = radar_case(batch=5, steps=20, missing=0.0)
    spoilt = getattr(case, field).copy()
    spoilt[VICTIM, at] = value
    return case._replace(**{field: spoilt})


# what: (recording, time of the failure, status)
SPOILT = {
    "infinite measurement": (case_with("measurement", [np.inf, 0.1, 0.1]), WHEN, 2),
    "noise not told": (case_with("noise", np.nan), WHEN, 2),
    "initial state infinite": (case_with("mean", np.inf, at=1), 0, 1),
    "initial factor not a number": (case_with("factor", np.nan, at=1), 0, 1),
    "position beyond the numbers": (case_with("mean", 1e200, at=0), 0, 2),
    "speed beyond the numbers": (case_with("mean", 1e200, at=1), 1, 2),
}


@pytest.mark.parametrize("tier", TIERS)
@pytest.mark.parametrize("what", SPOILT)
def test_only_the_victim_fails(tier, what):
    case, when, code = SPOILT[what]
    filters = make(tier)
    run = filters.run(case, case.knobs)
    assert list(np.flatnonzero(run.status)) == [VICTIM]
    assert run.failed_at[VICTIM] == when and (run.failed_at[OTHERS] == -1).all()
    assert run.status[VICTIM] == code
    assert np.isnan(run.mean[VICTIM, when:]).all() and np.isfinite(run.mean[VICTIM, :when]).all()
    assert describe_failures(run.status, run.failed_at) == [
        f"Filter {VICTIM} failed at time index {when}: {FAILURES[run.status[VICTIM]]}."
    ]
    # the others: as in a run without it, by the same object (whose scratch the victim used) and
    # by a fresh one
    others = case.only(OTHERS)
    for again in (filters, make(tier)):
        alone = again.run(others, others.knobs)
        np.testing.assert_array_equal(run.mean[OTHERS], alone.mean)
        np.testing.assert_array_equal(run.nis[OTHERS], alone.nis)


@pytest.mark.parametrize("tier", TIERS[:3])
def test_stepwise_failures_are_isolated_too(tier):
    case, _, _ = SPOILT["infinite measurement"]
    filters, status = make(tier), np.zeros(5, np.int64)
    start = Prediction(case.mean, case.factor, np.zeros_like(case.factor))
    seen = measured(case, WHEN)
    updated = filters.update(start, case.knobs, seen, status)
    assert list(status) == [0, 0, 2, 0, 0]
    dt = np.full(5, 0.1)
    predicted = filters.predict(updated.mean, updated.factor, case.motion_inputs[:, 0], dt, status)
    assert list(status) == [0, 0, 2, 0, 0]  # the first failure stays the reason
    sound = (type(part)(*(a[OTHERS] for a in part)) for part in (start, case.knobs, seen))
    alone = make(tier).update(*sound, np.zeros(4, np.int64))
    np.testing.assert_array_equal(updated.mean[OTHERS], alone.mean)
    np.testing.assert_array_equal(updated.factor[OTHERS], alone.factor)
    assert np.isfinite(predicted.mean[OTHERS]).all()


@pytest.mark.parametrize("tier", ["srukf-classical", "ukf-classical"])
def test_a_lost_root_says_that_the_covariance_is_not_positive_definite(tier):
    """A perfect sensor leaves a singular covariance: P - K Pzz K^T loses it to rounding."""
    case = case_with("noise", 0.0, at=slice(None))
    run = make(tier).run(case, case.knobs)
    assert list(run.status) == [0, 0, 4, 0, 0]
    assert "no longer positive definite" in describe_failures(run.status, run.failed_at)[0]
    others = case.only(OTHERS)
    alone = make(tier).run(others, others.knobs)
    np.testing.assert_array_equal(run.mean[OTHERS], alone.mean)


@pytest.mark.parametrize("tier", ["engine", "srukf-joseph-exact", "srukf-joseph"])
def test_the_joseph_factor_survives_a_perfect_sensor(tier):
    case = case_with("noise", 0.0, at=slice(None))
    assert not make(tier).run(case, case.knobs).status.any()


def test_batched_roots_fail_alone():
    """Cholesky, downdate and solve give NaN where there is no answer, and raise nothing."""
    eye = np.broadcast_to(np.eye(3), (4, 3, 3))
    P = eye * np.array([1.0, -1.0, np.nan, 4.0])[:, None, None]
    vector = np.array([0.6, 0.0, 0.0]) * np.array([1.0, 2.0, np.nan, 0.0])[:, None]
    A = eye * np.array([2.0, 0.0, np.nan, 4.0])[:, None, None]
    for found, expected in (
        (cholesky(P), [1.0, np.nan, np.nan, 2.0]),
        (downdate(eye, vector), [0.8, np.nan, np.nan, 1.0]),
        (solve(A, eye), [0.5, np.nan, np.nan, 0.25]),
    ):
        np.testing.assert_allclose(found[:, 0, 0], expected)


@pytest.mark.parametrize("tier", TIERS)
def test_nothing_is_raised_when_every_filter_fails(tier):
    case = radar_case(batch=2, steps=5)
    run = make(tier).run(case._replace(measurement=np.full_like(case.measurement, np.inf)))
    assert run.status.all() and (run.failed_at == 0).all()
