"""Filters know how wrong they are: NEES and NIS within chi-square bounds (about 8 s).

Truth, process noise and measurement noise are drawn from the filter's own models. Then the sum
of the NEES (the squared error in units of the covariance) over N independent flights is chi-square
with N n degrees of freedom at every time, and the sum of the NIS over flights and times with as
many as measurements arrived, since innovations of different times are independent.
"""

import numpy as np
import pytest
from pairs import drawn_case, position_sensor
from scipy.stats import chi2

from kfenv.filters.engine import Engine
from kfenv.filters.matrices import cholesky, solve_lower
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.radar import radar

FLIGHTS, STEPS, DT = 200, 60, 0.5
START = np.array([3e4, -120.0, 1.0, 4e4, 60.0, -1.0, 8e3, 5.0, 0.0])  # 50 km from the radar
FACTOR = np.diag([200.0, 20.0, 2.0] * 3)
CHANCE = 1e-3  # that a consistent filter fails a test, two-sided
SYSTEMS = {
    "linear": (constant_acceleration(2.0), position_sensor(), [30.0, 20.0, 50.0]),
    "radar": (constant_acceleration(1.0), radar(), [20.0, 1.7e-3, 1.7e-3]),
}
LINEAR = ("lkf", "ekf-joseph", "ekf-khp", "ukf-classical", "ukf-joseph", "ckf-joseph-exact",
          "srukf-classical", "srukf-joseph-exact")  # fmt: skip
SIGMA_POINT = ("ukf-classical", "ukf-joseph", "ukf-joseph-exact", "ckf-classical",
               "srukf-classical", "srukf-joseph", "srukf-joseph-exact",
               "srckf-joseph-exact")  # fmt: skip
EVERY = [("linear", n) for n in LINEAR] + [("radar", n) for n in SIGMA_POINT]


@pytest.fixture(scope="module")
def drawn():
    """Truth and recording of each system; a fifth of the channels is missing."""
    found = {}
    for system, (motion, sensor, sd) in SYSTEMS.items():
        noise = np.tile(sd, (FLIGHTS, STEPS, 1))
        noise[np.random.default_rng(1).random(noise.shape) < 0.2] = np.nan
        found[system] = drawn_case(motion, sensor, START, FACTOR, noise, DT, seed=2)
    return found


def bounds(freedom, chance=CHANCE):
    """Of a chi-square sum over its expectation."""
    return chi2.ppf([0.5 * chance, 1.0 - 0.5 * chance], freedom) / freedom


def mean_nees(history, truth):
    """(T,) per degree of freedom."""
    batch, steps, n = truth.shape
    root = cholesky(history.covariance.reshape(-1, n, n))
    error = (history.mean - truth).reshape(-1, n, 1)
    return np.sum(solve_lower(root, error) ** 2, axis=(1, 2)).reshape(batch, steps).mean(0) / n


def mean_nis(nis, case):
    """Per degree of freedom, with that number."""
    freedom = np.count_nonzero(~np.isnan(case.measurement))
    return np.nansum(nis) / freedom, freedom


@pytest.mark.parametrize(("system", "name"), EVERY)
def test_a_filter_of_the_right_model_is_consistent(system, name, drawn):
    truth, case = drawn[system]
    history = ReferenceFilter(*SYSTEMS[system][:2], name).history(case, case.knobs)
    assert not history.status.any()
    low, high = bounds(FLIGHTS * 9, CHANCE / STEPS)
    nees = mean_nees(history, truth)
    assert low < nees.min() and nees.max() < high
    nis, freedom = mean_nis(history.nis, case)
    low, high = bounds(freedom)
    assert low < nis < high


def test_the_engine_is_consistent(drawn):
    case = drawn["radar"][1]
    nis, freedom = mean_nis(Engine(*SYSTEMS["radar"][:2]).run(case, case.knobs).nis, case)
    low, high = bounds(freedom)
    assert low < nis < high


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize(
    ("told_noise", "told_process"), [(0.8, 1.0), (1.25, 1.0), (1.0, 0.25), (1.0, 4.0)]
)
def test_a_filter_that_is_told_wrong_is_not(system, told_noise, told_process, drawn):
    """The test has teeth: measurement noise told a quarter wrong, or process noise two-fold."""
    truth, case = drawn[system]
    told = case._replace(noise=told_noise * case.noise)
    knobs = case.knobs._replace(process_scale=told_process * case.knobs.process_scale)
    history = ReferenceFilter(*SYSTEMS[system][:2], "srukf-joseph-exact").history(told, knobs)
    nis, freedom = mean_nis(history.nis, case)
    low, high = bounds(freedom)
    assert not low < nis < high
    nees, (low, high) = mean_nees(history, truth)[-1], bounds(FLIGHTS * 9)
    assert not low < nees < high
