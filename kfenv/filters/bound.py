"""The posterior Cramer-Rao bound: what no filter can do better than (SPEC 10, Tichavsky 1998).

The recursion of the information, J+ = D22 - D21 (J + D11)^-1 D12 with D11 = E[F^T Q^-1 F],
D21 = -E[Q^-1 F] and D22 = E[Q^-1] + E[H^T R^-1 H], subtracts numbers of the size of Q^-1:
it keeps few digits at 10 Hz and none at 100 Hz. The matrix inversion lemma turns it into a
Kalman filter without data. With Q' = E[Q^-1]^-1, F' = Q' E[Q^-1 F] and the information
D = E[(F - F')^T Q^-1 (F - F')] that lies in how the slopes differ over the ensemble,

    P- = F' (P^-1 + D)^-1 F'^T + Q',        P+ = (P-^-1 + E[H^T R^-1 H])^-1,

here on roots, P = S S^T, by orthogonal transformations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.matrices import solve_lower, transpose, tria
from kfenv.filters.transforms import StateFunction
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch, dual

Array = NDArray[np.float64]
BLOCK = 8  # rows per column in a decomposition
ROUNDING = 1e-12  # of correlations: no eigenvalue of a covariance lies further below zero
NO_ANGLES = np.array([], np.intp)  # slopes know no cut


def cramer_rao_bound(
    motion: Motion,
    sensor: Sensor,
    truth: Array,
    time: Array,
    noise: Array,
    covariance: Array,
    motion_inputs: Array | None = None,
    sensor_inputs: Array | None = None,
) -> Array:
    """Lower bound (T, n, n) of the covariance of any estimate of the state from the past.

    It bounds the mean square over an ensemble: of initial states with the given
    covariance, and of flights drawn from the motion model, its noise included. On one
    given flight, or on flights not drawn from the model, a filter may lie below it: it
    gains wherever less happens than its model allows. (On trajectory A the
    filters' RMSE is 4 to 8 % below it.) What a process noise that depends on the state
    tells of the state is left out.

    Args:
        motion, sensor: the models.
        truth: (B, T, n) states of the ensemble.
        time: (T,) s; at the first time there is an update and no prediction.
        noise: (B, T, m) standard deviations of the measurements, NaN where nothing
            arrives, which adds no information.
        covariance: (n, n) of the initial state; zeros where it is known exactly.
        motion_inputs, sensor_inputs: known inputs (B, T, p) and (B, T, k), if any.

    Raises:
        ValueError: if shapes do not fit, an argument holds what it must not, or the
            bound does not exist because a process noise is singular.
    """
    size, steps, n = _check(motion, sensor, truth, time, noise, covariance)
    nothing = np.zeros((size, steps, 0))
    u = nothing if motion_inputs is None else motion_inputs
    s = nothing if sensor_inputs is None else sensor_inputs
    bound = np.empty((steps, n, n))
    S = _root(covariance)
    with np.errstate(all="ignore"):  # what has no slope is told below
        for t in range(steps):
            if t > 0:
                dt, x = np.full(size, time[t] - time[t - 1]), truth[:, t - 1]
                S = _predict(S, *_step(motion, x, u[:, t], dt))
            S = _inform(S, _whitened_slopes(sensor, truth[:, t], s[:, t], noise[:, t]))
            bound[t] = S[0] @ S[0].T
    if not np.isfinite(bound).all():
        first = int(np.flatnonzero(~np.isfinite(bound).all(axis=(1, 2)))[0])
        raise ValueError(
            f"The bound does not exist from time index {first} on: the process noise is "
            "singular, or a model has no slope at the truth there."
        )
    return bound


def _root(covariance: Array) -> Array:
    """A root (1, n, n), of a singular covariance too."""
    eigenvalues, axes = np.linalg.eigh(_correlations(covariance))
    deviations = np.sqrt(np.diagonal(covariance))
    return tria((deviations[:, None] * axes * np.sqrt(np.maximum(eigenvalues, 0.0)))[None])


def _predict(S: Array, F: Array, L: Array) -> Array:
    """Root (1, n, n) of the bound one step on, for slopes F and noise factors L (B, n, n)."""
    first, middle = L[:1], F.mean(axis=0)
    W = solve_lower(L, np.broadcast_to(first, L.shape))  # the identity if Q is constant
    C = tria(transpose(_rows(W)))  # C C^T = E[W^T W]
    root = transpose(solve_lower(C, transpose(first)))  # of Q'
    pull = np.mean(transpose(W) @ solve_lower(L, F - middle), axis=0, keepdims=True)
    slope = middle + root @ solve_lower(C, pull)  # F'
    return tria(slope @ _inform(S, solve_lower(L, F - slope)), root)


def _inform(S: Array, G: Array) -> Array:
    """A root of (P^-1 + E[G^T G])^-1, where P = S S^T and G is (B, k, n)."""
    whitened = transpose(_rows(G) @ S)
    C = tria(np.broadcast_to(np.eye(S.shape[-1]), S.shape), whitened)
    return transpose(solve_lower(C, transpose(S)))


def _rows(G: Array) -> Array:
    """Rows (1, k', n) whose sum of squares is the mean of G^T G: few, whatever the ensemble.

    Many small decompositions instead of one tall one, on which threads would fall over
    each other.
    """
    n = G.shape[-1]
    rows = G.reshape(-1, n) / np.sqrt(len(G))
    while len(rows) > BLOCK * n:
        rows = np.concatenate([rows, np.zeros((-len(rows) % (BLOCK * n), n))])
        rows = np.linalg.qr(rows.reshape(-1, BLOCK * n, n), mode="r").reshape(-1, n)
    return rows[None]


def _step(motion: Motion, x: Array, u: Array, dt: Array) -> tuple[Array, Array]:
    """Slopes and noise factors (B, n, n) of the motion from the states x (B, n)."""
    plain = motion.build(batch)
    step = StateFunction(plain.step, motion.build(dual).step, NO_ANGLES, u, dt)
    L = np.zeros((*x.shape, x.shape[1]))
    entries = plain.noise_factor(tuple(x.T), tuple(u.T), dt)
    for (row, column), entry in zip(motion.noise_pattern, entries, strict=True):
        L[:, row, column] = entry
    return step.jacobian(x), L


def _whitened_slopes(sensor: Sensor, x: Array, s: Array, noise: Array) -> Array:
    """Slopes of the measurements (B, m, n) in deviations of their noise; zero if missing."""
    present = ~np.isnan(noise)
    measure = StateFunction(sensor.build(batch), sensor.build(dual), NO_ANGLES, s, present=present)
    return measure.jacobian(x) / np.where(present, noise, 1.0)[:, :, None]


def _check(
    motion: Motion, sensor: Sensor, truth: Array, time: Array, noise: Array, covariance: Array
) -> tuple[int, int, int]:
    """The sizes (B, T, n); complains of what does not fit."""
    n, m = len(motion.states), len(sensor.channels)
    if truth.ndim != 3 or truth.shape[2] != n or 0 in truth.shape:
        raise ValueError(f"truth must have shape (flights, times, {n}), got {truth.shape}.")
    size, steps = truth.shape[:2]
    shapes = (("time", time, (steps,)), ("noise", noise, (size, steps, m)),
              ("covariance", covariance, (n, n)))  # fmt: skip
    for name, value, shape in shapes:
        if value.shape != shape:
            raise ValueError(f"{name} must have shape {shape} as truth has, got {value.shape}.")
    if not (np.isfinite(truth).all() and np.isfinite(time).all() and np.all(np.diff(time) > 0.0)):
        raise ValueError("truth and time must be finite, and time must increase strictly.")
    if np.any(noise <= 0.0) or np.isinf(noise).any():
        raise ValueError("noise must hold positive deviations, or NaN where nothing arrives.")
    sound = np.isfinite(covariance).all() and np.allclose(covariance, covariance.T, rtol=1e-9)
    if not sound or np.linalg.eigvalsh(_correlations(covariance)).min() < -ROUNDING:
        raise ValueError("covariance must be symmetric and positive semidefinite.")
    return size, steps, n


def _correlations(covariance: Array) -> Array:
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    return covariance / np.outer(sd, sd)
