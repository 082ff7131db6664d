"""The static noise of least cost, with intervals from blocks of the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import t as student

from .criteria import Criterion
from .noise import NoiseShape

Array = NDArray[np.float64]

SPREAD = 48  # settings drawn over the whole range before the descent
STEP = 1e-2  # of finite differences in the descent, in parameters
WIDE = 0.1  # of those that curvature and intervals are from: errors have kinks
MOVED = 1e-3  # curvature below which no data moved a parameter, relative to the largest
ROUNDS = 60  # of the descent, at most


@dataclass(frozen=True)
class Estimate:
    """Static noise as parameters theta (p,), with 95 % intervals.

    Attributes:
        theta: of least cost.
        low, high: (p,) ends of the interval, infinite where the data do not tell.
        moved: (p,) whether the cost changes with the parameter.
        at_edge: (p,) whether it lies at an end of its range.
        cost, nominal_cost: at theta, and at zero.
        blocks: that the interval is from.
    """

    theta: Array
    low: Array
    high: Array
    moved: NDArray[np.bool_]
    at_edge: NDArray[np.bool_]
    cost: float
    nominal_cost: float
    blocks: int


def estimate(
    shape: NoiseShape, criterion: Criterion, seed: int,
    advance: Callable[[], None] = lambda: None,
) -> Estimate:  # fmt: skip
    """Minimise the cost: settings spread over the range, then L-BFGS-B from the best of them.

    The intervals are those of the delete-one-block jackknife with one Newton step each from
    the optimum (Shao and Tu 1995, sec 2.1): they need no distribution of the innovations,
    but blocks that know little of each other.

    Args:
        advance: called after each round of the descent.
    """
    all_blocks = np.ones(criterion.count)

    def costs(theta: Array) -> Array:
        return criterion.cost(criterion.sums(*shape.factors(theta)), all_blocks)

    start, nominal = _start(shape, costs, seed)
    steps = STEP * np.eye(len(start))

    def slope(theta: Array) -> tuple[float, Array]:
        around = np.vstack([theta, theta + steps, theta - steps])
        value, *rest = costs(around)
        ahead, behind = np.split(np.array(rest), 2)
        advance()
        return value, (ahead - behind) / (2.0 * STEP)

    found = minimize(
        slope, start, jac=True, method="L-BFGS-B",
        bounds=list(zip(shape.low, shape.high, strict=True)), options={"maxiter": ROUNDS},
    )  # fmt: skip
    return _with_interval(shape, criterion, found.x, float(found.fun), nominal)


def _start(shape: NoiseShape, costs: Callable, seed: int) -> tuple[Array, float]:
    """The best of some settings, and what the nominal one costs."""
    rng = np.random.default_rng(seed)
    low, high = (np.where(shape.logarithmic, edge, 0.0) for edge in (shape.low, shape.high))
    spread = rng.uniform(low, high, (SPREAD, len(low)))
    near = 0.5 * spread[: SPREAD // 2]
    tried = np.vstack([np.zeros(len(low)), near, spread[SPREAD // 2 :]])
    cost = costs(tried)
    return tried[np.nanargmin(cost)], float(cost[0])


def _with_interval(
    shape: NoiseShape, criterion: Criterion, theta: Array, cost: float, nominal: float
) -> Estimate:
    p, blocks = len(theta), criterion.count
    at_edge = (theta < shape.low + 1e-3) | (theta > shape.high - 1e-3)
    sums = criterion.sums(*shape.factors(theta + _around(p)))
    hessian = _hessian(criterion.cost(sums, np.ones(blocks)), p)
    without = 1.0 - np.eye(blocks)
    left_out = criterion.cost(sums, without)  # (K, settings)
    slopes = (left_out[:, 1 : p + 1] - left_out[:, p + 1 : 2 * p + 1]) / (2.0 * WIDE)
    inside = ~at_edge
    curvature = np.diag(hessian)
    moved = curvature > MOVED * max(np.max(curvature), 1e-12)
    free = inside & moved
    half = np.full(p, np.inf)
    if free.any():
        shifts = -slopes[:, free] @ _inverse(hessian[np.ix_(free, free)])
        spread = np.sum((shifts - shifts.mean(axis=0)) ** 2, axis=0) * (blocks - 1) / blocks
        half[free] = student.ppf(0.975, blocks - 1) * np.sqrt(spread)
    half[~free & at_edge] = np.inf
    return Estimate(theta, theta - half, theta + half, moved, at_edge, cost, nominal, blocks)


def _around(p: int) -> Array:
    """Settings about an optimum: itself, a step ahead and back along each axis, each pair."""
    steps = WIDE * np.eye(p)
    pairs = [steps[i] + steps[j] for i in range(p) for j in range(i)]
    return np.vstack([np.zeros(p), steps, -steps, *pairs])


def _hessian(cost: Array, p: int) -> Array:
    """Second derivatives (p, p) from the costs of `_around`."""
    here, ahead, back, pairs = cost[0], cost[1 : p + 1], cost[p + 1 : 2 * p + 1], cost[2 * p + 1 :]
    hessian = np.diag((ahead - 2.0 * here + back) / WIDE**2)
    rows = [(i, j) for i in range(p) for j in range(i)]
    for (i, j), both in zip(rows, pairs, strict=True):
        hessian[i, j] = hessian[j, i] = (both - ahead[i] - ahead[j] + here) / WIDE**2
    return hessian


def _inverse(hessian: Array) -> Array:
    """Of a Hessian whose eigenvalues are taken as at least a thousandth of the largest."""
    values, vectors = np.linalg.eigh(hessian)
    values = np.maximum(values, MOVED * np.max(np.abs(values)))
    return vectors / values @ vectors.T
