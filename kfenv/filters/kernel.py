# ruff: noqa: F821
"""The fused kernel: batches of filters through the cycle, eight at a time (SPEC section 9).

This file is the second of two templates; see ``cycle.py``, whose functions it calls. Its
entry points are what the engine calls and what Numba keeps on disk.
"""

from kfenv.filters.batch_and_lanes import (
    BAD_INNOVATION,
    BAD_PREDICTION,
    BAD_UPDATE,
    LARGEST,
    OK,
    anyone_runs,
    assess,
    gather,
    gather_measurement,
    gather_scales,
    is_finite,
    mark_missing,
    rows,
    scatter,
    scatter_factor,
)
from kfenv.models.namespaces.lanes import LANES, load, spread, store


@entry_point
def predict(mean, factor, u, dt, scratch, new_mean, root, noise, status):
    """Time update of a batch. Filters whose status is not zero are left alone."""
    w = scratch_of(scratch)
    steps = dt.reshape((dt.shape[0], 1))
    for first in range(0, mean.shape[0], LANES):
        if not anyone_runs(status, first):
            continue
        gather(mean, first, w.posterior)
        gather(rows(factor), first, w.S)
        gather(u, first, w.u)
        gather(steps, first, w.dt)
        _predict_lanes(w.posterior, w.S, w.u, load(w.dt, 0), w.predicted, w.L, w.Q, w.X)
        scatter(w.predicted, first, status, new_mean)
        scatter_factor(w.L, first, status, rows(root), _plain(N))
        scatter_factor(w.Q, first, status, rows(noise), _plain(N))
        for lane in range(min(LANES, mean.shape[0] - first)):
            if status[first + lane] == OK and not is_finite(w.predicted, w.L, lane):
                status[first + lane] = BAD_PREDICTION


@entry_point
def update(mean, root, noise, fading, process_scale, s, measurement, deviation, scratch, correct,
           new_mean, new_factor, innovation, variance, whitened, nis, log_likelihood,
           status):  # fmt: skip
    """Measurement update of a batch. Filters whose status is not zero are left alone.

    Unless ``correct``, the innovation alone is formed and the predicted state returned.
    """
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], LANES):
        if not anyone_runs(status, first):
            continue
        gather(mean, first, w.predicted)
        gather(rows(root), first, w.S)
        gather(rows(noise), first, w.Q)
        gather_scales(fading, process_scale, first, w)
        gather(s, first, w.s)
        heard = gather_measurement(measurement, deviation, first, w)
        _add_noise(w.S, load(w.scales, 0), w.Q, load(w.scales, 1), w.L, w.A)
        if heard:
            _innovate_lanes(w, heard)
        if correct:
            if heard:
                _correct_lanes(w, heard)
            else:
                _keep_lanes(w)
            scatter(w.posterior, first, status, new_mean)
            scatter_factor(w.S, first, status, rows(new_factor), _plain(N))
        else:
            scatter(w.predicted, first, status, new_mean)
            scatter_factor(w.L, first, status, rows(new_factor), _plain(N))
        scatter(w.innovation, first, status, innovation)
        scatter(w.variance, first, status, variance)
        scatter(w.whitened, first, status, whitened)
        for lane in range(min(LANES, mean.shape[0] - first)):
            b = first + lane
            if status[b] != OK:
                continue
            mark_missing(w.arrived, lane, b, innovation, variance, whitened)
            nis[b], log_likelihood[b] = assess(w, SKIPS, heard, lane)
            if w.count[0, lane] > 0.5 and not abs(nis[b]) <= LARGEST:
                status[b] = BAD_INNOVATION
            elif correct and not is_finite(w.posterior, w.S, lane):
                status[b] = BAD_UPDATE
            elif not correct and not is_finite(w.predicted, w.L, lane):
                status[b] = BAD_PREDICTION


@entry_point
def run(mean, factor, dt, u, s, measurement, deviation, fading, process_scale, scratch, means, nis,
        status, failed_at):  # fmt: skip
    """Filter whole recordings with constant knobs; posterior means (B, T, n)."""
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], LANES):
        lanes = min(LANES, mean.shape[0] - first)
        gather(mean, first, w.posterior)
        gather(rows(factor), first, w.S)
        gather_scales(fading, process_scale, first, w)
        for t in range(measurement.shape[1]):
            if t > 0:
                gather(u[:, t], first, w.u)
                gather(dt[:, t], first, w.dt)
                _predict_lanes(w.posterior, w.S, w.u, load(w.dt, 0), w.predicted, w.L, w.Q, w.X)
            else:
                for k in range(N * N):
                    store(w.Q, k, spread(0.0))
                    store(w.L, k, load(w.S, k))
                for i in range(N):
                    store(w.predicted, i, load(w.posterior, i))
            for lane in range(lanes):
                if status[first + lane] == OK and not is_finite(w.predicted, w.L, lane):
                    status[first + lane] = BAD_PREDICTION
                    failed_at[first + lane] = t
            for k in range(N * N):
                store(w.S, k, load(w.L, k))
            gather(s[:, t], first, w.s)
            heard = gather_measurement(measurement[:, t], deviation[:, t], first, w)
            _add_noise(w.S, load(w.scales, 0), w.Q, load(w.scales, 1), w.L, w.A)
            if heard:
                _innovate_lanes(w, heard)
                _correct_lanes(w, heard)
            else:
                _keep_lanes(w)
            for lane in range(lanes):
                b = first + lane
                if status[b] != OK:
                    continue
                nis[b, t] = assess(w, SKIPS, heard, lane)[0]
                if w.count[0, lane] > 0.5 and not abs(nis[b, t]) <= LARGEST:
                    status[b], failed_at[b] = BAD_INNOVATION, t
                elif not is_finite(w.posterior, w.S, lane):
                    status[b], failed_at[b] = BAD_UPDATE, t
                else:
                    for i in range(N):
                        means[b, t, i] = w.posterior[i, lane]
