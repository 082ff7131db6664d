"""From the last step of a batch of filters to the first: how what was turned moves a loss.

This is reverse differentiation of the sigma-point filter of SPEC section 9 in covariances, step by
step, from what the engine left of each. With the optimal gain K = C S^-1 the exact Joseph form is
P - C S^-1 C^T, where C is the covariance between state and measurement and S the innovation's, so

    dP+ = dP - dC K^T - K dC^T + K dS K^T.

What is here knows sizes from its arguments alone, so that Numba compiles it once for all models;
what depends on the model goes between (see `pullback`). ``w`` has a block of rows for every eight
filters, one in each lane of a vector, and ``at``, a `Layout`, tells where in it what begins;
matrices lie there row by row, and the upper triangle of a factor is never read. A channel that a
lane did not hear has deviations of zero and unit noise; one that no lane of a block heard has no
row in C, S and K.
"""

from numba import njit

from kfenv.kernel_cache import KERNEL
from kfenv.models.namespaces.lanes import LANES, load, spread, store

from .blocks import add, cut, gather, hear, scatter
from .gain import pull_gain, pull_knobs, solve
from .points import (
    deviate,
    draw,
    draw_predicted,
    pull_deviations,
    pull_factor,
    pull_points,
    square,
)


@njit(**KERNEL)
def begin(at, w, t, given, heard):
    """Take up step t: the slopes of its posteriors, what the filters had, and which channels.

    Args:
        given: `filtering.Tape`'s arrays and the posteriors' slopes, (T, B, ...) with matrices flat.
        heard: (blocks,) how many channels any lane heard, is written.
    """
    for b in range(w.shape[0]):
        v, first = w[b], b * LANES
        add(given.of_posterior[t], first, v, at.of_mean)
        add(given.of_covariance[t], first, v, at.of_covariance)
        gather(given.mean[t], first, v, at.mean)
        gather(given.root[t], first, v, at.factor)
        gather(given.noise[t], first, v, at.noise)
        gather(given.innovation[t], first, v, at.innovation)
        gather(given.knobs[t], first, v, at.knobs)
        gather(given.told[t], first, v, at.told)
        gather(given.sensor_inputs[t], first, v, at.sensor_inputs)
        square(v, at.factor, at.propagated, at.n)
        square(v, at.noise, at.added, at.n)
        heard[b] = hear(at, v)
        if heard[b]:
            draw_predicted(at, v)


@njit(**KERNEL)
def pull_update(at, w, heard, is_angle):
    """From the slopes of the posteriors to those of the measured points and of the noise told."""
    for b in range(w.shape[0]):
        if heard[b]:
            solve(at, w[b], heard[b], is_angle)
            pull_gain(at, w[b], heard[b])


@njit(**KERNEL)
def end(at, w, t, heard, sound, of_knobs, of_told):
    """From the slopes of the points to those of the predicted states, knobs and parts.

    Args:
        sound: (B,) how many steps a filter made before it failed.
        of_knobs, of_told: (T, B, ...) are written.
    """
    for b in range(w.shape[0]):
        v, first = w[b], b * LANES
        if heard[b]:
            pull_points(at, v)
            pull_factor(at, v)
        pull_knobs(at, v)
        for lane in range(min(LANES, sound.shape[0] - first)):
            cut(at, v, lane, t < sound[first + lane])
        scatter(v, at.of_knobs, first, of_knobs[t])
        scatter(v, at.of_told, first, of_told[t])


@njit(**KERNEL)
def begin_prediction(at, w, t, given, rows, columns):
    """Take up the prediction of step t: points of the posteriors before, slopes of the noise.

    Args:
        rows, columns: places of the process noise's entries.
    """
    for b in range(w.shape[0]):
        v, first = w[b], b * LANES
        gather(given.posterior[t - 1], first, v, at.mean)
        gather(given.factor[t - 1], first, v, at.factor)
        gather(given.motion_inputs[t], first, v, at.motion_inputs)
        draw(at, v)
        for k in range(rows.shape[0]):
            store(v, at.of_entries + k, load(v, at.of_noise + rows[k] * at.n + columns[k]))


@njit(**KERNEL)
def pull_prediction(at, w, is_angle):
    """From the slopes of the predicted states to those of the predicted points."""
    for b in range(w.shape[0]):
        v = w[b]
        for i in range(at.n):
            deviate(at, v, at.values + i * at.p, is_angle[i])
        for i in range(at.n):
            row = at.of_values + i * at.p
            for j in range(at.p):
                total = spread(0.0)
                for k in range(at.n):
                    slope = load(v, at.of_covariance + i * at.n + k)
                    total = total + slope * load(v, at.values + k * at.p + j)
                store(v, row + j, 2.0 * total)
            pull_deviations(at, v, row, load(v, at.of_mean + i))


@njit(**KERNEL)
def end_prediction(at, w):
    """From the slopes of the points to those of the posteriors before."""
    for b in range(w.shape[0]):
        v = w[b]
        for i in range(at.n):
            store(v, at.of_mean + i, load(v, at.of_state + i))
        for k in range(at.n * at.n):
            store(v, at.of_factor + k, spread(0.0))
            store(v, at.of_covariance + k, spread(0.0))
        pull_points(at, v)
        pull_factor(at, v)
