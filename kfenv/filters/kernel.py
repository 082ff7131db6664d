# ruff: noqa: F821
"""The fused kernel: batches of filters through the cycle, some at a time (SPEC section 9).

This file is the second of two templates; see ``cycle.py``, whose functions it calls. Its
entry points are what the engine calls and what Numba keeps on disk.
"""

from kfenv.addresses import arrays_at
from kfenv.filters.batch_and_lanes import (
    BAD_INNOVATION,
    BAD_PREDICTION,
    BAD_UPDATE,
    LARGEST,
    OK,
    assess,
    find_unsound,
    gather,
    gather_factor,
    gather_measurement,
    gather_posterior,
    gather_prediction,
    gather_scales,
    is_sound,
    scatter_prediction,
    scatter_update,
    who_runs,
)
from kfenv.models.namespaces.lanes import lanes_of, peek


@entry_point
def advance(predicts, innovates, corrects, table, scratch, u, dt, s, measurement, deviation):
    """The parts of a cycle that are asked for, each from where the one before it ended.

    Time update from mean and factor to the prediction; innovation; measurement update. Filters
    whose status is not zero are left alone. Unless it ``corrects``, new mean and factor are the
    predicted ones. The table is that of an engine's `InPlace`.
    """
    (mean, factor, predicted, root, noise, fading, process_scale, new_mean, new_factor, innovation,
     variance, whitened, nis, log_likelihood, status) = arrays_at(
         table, "ff fff ff fff fff f f ff fff ff ff ff f f i")  # fmt: skip
    w = scratch_of(scratch)
    for first in range(0, status.shape[0], lanes_of(w.dt)):
        runs = who_runs(status, first, w)
        if not runs:
            continue
        if predicts:
            gather_posterior(mean, factor, u, dt, first, w)
            _predict_lanes(w)
            runs = scatter_prediction(w, first, runs, status, predicted, root, noise)
            _copy(w.L, w.S, _plain(N * N))
        else:
            gather_prediction(predicted, root, noise, first, w)
        if not innovates:
            continue
        gather_scales(fading, process_scale, first, w)
        gather(s, first, w.s)
        heard = gather_measurement(measurement, deviation, first, w)
        _add_noise(w)
        if heard:
            _innovate_lanes(w, heard)
        if corrects:
            _correct_lanes(w, heard)
        scatter_update(w, first, runs, SKIPS, heard, corrects, status, new_mean, new_factor,
                       innovation, variance, whitened, nis, log_likelihood)  # fmt: skip


@entry_point
def run(mean, factor, dt, u, s, measurement, deviation, fading, process_scale, scratch, means, nis,
        status, failed_at):  # fmt: skip
    """Filter whole recordings with constant knobs; posterior means (B, T, n)."""
    w = scratch_of(scratch)
    for first in range(0, mean.shape[0], lanes_of(w.dt)):
        lanes = min(lanes_of(w.dt), mean.shape[0] - first)
        gather(mean, first, w.posterior)
        gather_factor(factor, first, w.S)
        gather_scales(fading, process_scale, first, w)
        for t in range(measurement.shape[1]):
            if t > 0:
                gather(u[:, t], first, w.u)
                gather(dt[:, t], first, w.dt)
                _predict_lanes(w)
            else:
                _start(w)
            find_unsound(w.predicted, w.L, _plain(N), w)
            for lane in range(lanes):
                if status[first + lane] == OK and not is_sound(w, lane):
                    status[first + lane] = BAD_PREDICTION
                    failed_at[first + lane] = t
            _copy(w.L, w.S, _plain(N * N))
            gather(s[:, t], first, w.s)
            heard = gather_measurement(measurement[:, t], deviation[:, t], first, w)
            _add_noise(w)
            if heard:
                _innovate_lanes(w, heard)
            _correct_lanes(w, heard)
            find_unsound(w.posterior, w.S, _plain(N), w)
            for lane in range(lanes):
                b = first + lane
                if status[b] != OK:
                    continue
                nis[b, t] = assess(w, SKIPS, heard, lane, M)[0]
                if peek(w.count, 0, lane) > 0.5 and not abs(nis[b, t]) <= LARGEST:
                    status[b], failed_at[b] = BAD_INNOVATION, t
                elif not is_sound(w, lane):
                    status[b], failed_at[b] = BAD_UPDATE, t
                else:
                    for i in range(N):
                        means[b, t, i] = peek(w.posterior, i, lane)
