"""What may happen to one particle at one instant, weighed by the measurement; compiled."""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRATA = 8  # factors of a burst that may start now


class Situation(NamedTuple):
    """What each of R particles holds of the faults; changed in place."""

    factor: Array  # (R,) of the noise now; 1 without a burst
    age: Array  # (R,) of the burst, s
    bursts: NDArray[np.int64]  # (R,) that have started
    glints: NDArray[np.int64]  # (R,)
    arrivals: NDArray[np.int64]  # (R,)
    misreport: Array  # (R, m) log of actual over told deviation
    motion: NDArray[np.int64]  # (R,) index of the process noise


@njit(cache=True, error_model="numpy")
def choose(innovation, root, noise, told, dt, process_noise, switching, start, ending, factor,
           glint, uniform, situation, deviation, log_weight):  # fmt: skip
    """Draw each particle's next situation from its posterior given the pending measurement.

    Hypotheses: every process noise, times the burst that stays, ends or starts with one of
    `STRATA` factors, times glint; each with its prior and N(nu; 0, S), S in full.

    Args:
        innovation: (R, m), NaN where nothing arrived.
        root, noise: H times the factors of the propagated covariance and of the process noise,
            (R, m, n).
        told: (R, m) deviations.
        process_noise: (Q,) factors; `switching` is the chance of leaving one in this step.
        start: (N + 1,) of `NoisePriors` at this instant; ending, factor: as there.
        glint: chance, share and factor.
        uniform: (R, 2) random numbers.
        deviation: (R, m) of the noise that was chosen, an output.
        log_weight: (R,) log-likelihood of the measurement, added to.
    """
    rows, m = innovation.shape
    count = len(process_noise)
    factors, chances = np.empty(STRATA + 2), np.empty(STRATA + 2)
    joint = np.empty((count, STRATA + 2, 2))
    plain, driven, S = np.empty((m, m)), np.empty((m, m)), np.empty((m, m))
    for r in range(rows):
        _square(root[r], plain)
        _square(noise[r], driven)
        _bursts(r, dt, start, ending, factor, uniform[r, 1], situation, factors, chances)
        glinting = _glint_chance(situation.glints[r], situation.arrivals[r], glint)
        most = -np.inf
        for q in range(count):
            here = q == situation.motion[r]
            moving = 1.0 - switching if here else switching / max(count - 1, 1)
            for k in range(STRATA + 2):
                for g in range(2):
                    prior = moving * chances[k] * (glinting if g else 1.0 - glinting)
                    joint[q, k, g] = -np.inf
                    if prior > 0.0:
                        scale = factors[k] * (glint[2] if g else 1.0)
                        joint[q, k, g] = log(prior) + _log_likelihood(
                            innovation[r], plain, driven, process_noise[q], told[r],
                            situation.misreport[r], scale, S,
                        )  # fmt: skip
                    most = max(most, joint[q, k, g])
        total = 0.0
        for q in range(count):
            for k in range(STRATA + 2):
                for g in range(2):
                    joint[q, k, g] = exp(joint[q, k, g] - most)
                    total += joint[q, k, g]
        log_weight[r] += most + log(total)
        q, k, g = _draw(joint, uniform[r, 0] * total)
        _take(r, q, k, g, dt, factors, innovation[r], situation)
        scale = factors[k] * (glint[2] if g else 1.0)
        for c in range(m):
            deviation[r, c] = told[r, c] * scale * exp(situation.misreport[r, c])


@njit(cache=True, error_model="numpy")
def _square(A, P):
    for i in range(A.shape[0]):
        for j in range(i + 1):
            P[i, j] = np.sum(A[i] * A[j])


@njit(cache=True, error_model="numpy")
def _bursts(r, dt, start, ending, factor, uniform, situation, factors, chances):
    """First the noise as it is, then without a burst, then bursts that start now."""
    now, age = situation.factor[r], situation.age[r]
    begins = start[min(situation.bursts[r], len(start) - 1)]
    ends = 0.0
    if now > 1.0:
        over = min(max((age + dt - ending[0]) / max(ending[1] - ending[0], 1e-9), 0.0), 1.0)
        gone = min(max((age - ending[0]) / max(ending[1] - ending[0], 1e-9), 0.0), 1.0)
        ends = 1.0 if gone >= 1.0 else (over - gone) / (1.0 - gone)
    factors[0], chances[0] = now, (1.0 - begins) * (1.0 - ends)
    factors[1], chances[1] = 1.0, (1.0 - begins) * ends
    low, span = log(factor[0]), log(factor[1] / factor[0])
    for k in range(STRATA):
        drawn = exp(low + span * (k + uniform) / STRATA)
        factors[2 + k], chances[2 + k] = max(drawn, now), begins / STRATA


@njit(cache=True, error_model="numpy")
def _glint_chance(glints, arrivals, glint):
    """Of one at the next arrival, from those that there were."""
    chance, share = glint[0], glint[1]
    if chance == 0.0 or share == 0.0:
        return 0.0
    if glints > 0:
        return share
    quiet = chance * (1.0 - share) ** arrivals
    return share * quiet / (quiet + 1.0 - chance)


@njit(cache=True, error_model="numpy")
def _log_likelihood(innovation, plain, driven, q, told, misreport, scale, S):
    """Of the channels that arrived, up to a constant; S is for the factor of their covariance.

    The row of a missing channel is left out of the factor, and its whitened innovation zero.
    """
    result = 0.0
    whitened = np.zeros(len(innovation))
    for c in range(len(innovation)):
        if np.isnan(innovation[c]):
            continue
        residual = innovation[c]
        for d in range(c):
            if np.isnan(innovation[d]):
                S[c, d] = 0.0
                continue
            value = plain[c, d] + q * driven[c, d]
            for k in range(d):
                value -= S[c, k] * S[d, k]
            S[c, d] = value / S[d, d]
            residual -= S[c, d] * whitened[d]
        value = plain[c, c] + q * driven[c, c] + (told[c] * scale * exp(misreport[c])) ** 2
        for k in range(c):
            value -= S[c, k] * S[c, k]
        S[c, c] = sqrt(value)
        whitened[c] = residual / S[c, c]
        result -= log(S[c, c]) + 0.5 * whitened[c] ** 2
    return result


@njit(cache=True, error_model="numpy")
def _draw(joint, target):
    """The hypothesis at which the sum of their weights passes the target."""
    total = 0.0
    q, k, g = 0, 0, 0
    for i in range(joint.shape[0]):
        for j in range(joint.shape[1]):
            for h in range(joint.shape[2]):
                if joint[i, j, h] > 0.0:
                    q, k, g = i, j, h
                    total += joint[i, j, h]
                    if total >= target:
                        return q, k, g
    return q, k, g


@njit(cache=True, error_model="numpy")
def _take(r, q, k, g, dt, factors, innovation, situation):
    """Make the hypothesis the particle's situation."""
    situation.motion[r] = q
    situation.age[r] = situation.age[r] + dt if k == 0 else 0.0
    situation.factor[r] = factors[k]
    if k >= 2:
        situation.bursts[r] += 1
    for c in range(len(innovation)):
        if not np.isnan(innovation[c]):
            situation.glints[r] += g
            situation.arrivals[r] += 1
            break
