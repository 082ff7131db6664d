"""Angles have no cut: a flight behind the radar is filtered like the same flight beside it."""

import numpy as np
import pytest
from pairs import PAIRS, radar_case, robot_case, wrap

from kfenv.filters.engine import Engine
from kfenv.filters.matrices import tria
from kfenv.filters.reference import ReferenceFilter
from kfenv.models.radar import radar
from kfenv.models.variable_turn import variable_turn

# Clockwise by 90 degrees about the radar: (east, north) -> (north, -east).
TURN = np.eye(9)
TURN[:6, :6] = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
SETTLED = 30  # steps after which the initial spread, the one that differs, has no say


# Sigma points are drawn along the columns of a factor, which has no meaning in space, so that
# their filters differ by far less than a deviation; the extended filter by rounding only.
@pytest.mark.parametrize(
    ("design", "tolerance"),
    [("engine", 0.2), ("srukf-joseph-exact", 0.2), ("ukf-classical", 0.2), ("ekf-joseph", 1e-9)],
)
def test_azimuth_crosses_180_degrees_unnoticed(design, tolerance):
    case = radar_case(batch=4, missing=0.0)
    late_jumps = np.abs(np.diff(case.measurement[:, SETTLED:, 1], axis=1))
    assert np.all(late_jumps.max(axis=1) > 6.0)  # it does cross, and after the start
    z = case.measurement.copy()
    z[:, :, 1] = wrap(z[:, :, 1] + 0.5 * np.pi)
    mean, factor = case.mean @ TURN.T, tria(TURN @ case.factor)
    turned = case._replace(mean=mean, factor=factor, measurement=z)
    if design == "engine":
        tier = Engine(variable_turn(), radar())
    else:
        tier = ReferenceFilter(variable_turn(), radar(), design)
    here, there = tier.run(case, case.knobs), tier.run(turned, turned.knobs)
    plain = ReferenceFilter(variable_turn(), radar(), "ekf-joseph").history(turned, turned.knobs)
    deviation = np.sqrt(np.diagonal(plain.covariance, axis1=2, axis2=3))
    difference = np.abs(here.mean @ TURN.T - there.mean) / deviation
    assert difference[:, SETTLED:].max() < tolerance


@pytest.mark.parametrize("missing", [0.0, 1.0])
@pytest.mark.parametrize("design", ["engine", "srukf-joseph-exact", "ukf-classical", "ekf-joseph"])
def test_a_state_angle_stays_wrapped_while_the_robot_circles(design, missing):
    motion, sensor, _ = PAIRS["robot, beacon"]
    case = robot_case(missing=missing)
    if design == "engine":
        tier = Engine(motion, sensor, 3.0)
    else:
        tier = ReferenceFilter(motion, sensor, design)
    run = tier.run(case, case.knobs)
    heading = run.mean[:, 1:, 2]
    assert np.all((heading >= -np.pi) & (heading < np.pi))
    assert np.all(np.abs(np.diff(heading, axis=1)).max(axis=1) > 6.0)  # it does go round
    if missing == 0.0:
        assert np.all(run.nis.mean(axis=1) < 6.0)  # of four channels: the cut is no surprise
