"""What a log itself tells of its receiver: biases between systems, and noise at a given C/N0.

The delays of a receiver's filters differ from system to system by metres and hardly change
in a day: one number for each system is estimated, against GPS. The noise of code and Doppler
goes as the inverse root of the signal's strength; how much it is at 45 dB-Hz is measured on
the residuals of single-epoch fixes, as much of a phone as of a geodetic receiver.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.receiver import noise_at
from kfenv.scenarios.gnss.fix import Fixes, Signals, fix, range_slopes, view

Array = NDArray[np.float64]

UNKNOWNS = 4  # of a fix: position and clock, or their rates
FEW = 30  # residuals that tell nothing yet
CODE_BOUNDS = (0.3, 30.0)  # m, of noise at 45 dB-Hz
RATE_BOUNDS = (0.01, 3.0)  # m/s
HALVINGS = 20
MEDIAN = 0.6745  # of the absolute value of a normal variable of deviation 1


def calibrated(signals: Signals, epochs: slice) -> Signals:
    """Take off the biases between systems and tell the noise that C/N0 suggests.

    Args:
        signals: of a log.
        epochs: those that noise may be measured on (no agent may profit from later ones).
    """
    signals = _without_biases(signals)
    if not np.isfinite(signals.strength).any():
        return signals
    heard = np.where(np.isfinite(signals.strength), signals.strength, np.nanmin(signals.strength))
    for _ in range(2):  # the fixes themselves weigh by it
        fixes = fix(signals)
        ranges, rates = (residual[epochs] for residual in _residuals(signals, fixes))

        def code(noise, signals=signals, fixes=fixes):
            told = replace(signals, code_noise=noise_at(heard, noise))
            return view(told, fixes.position).deviation[epochs]

        def rate(noise):
            return noise_at(heard, noise)[epochs]

        signals = replace(
            signals,
            code_noise=_fitted(ranges, code, heard, CODE_BOUNDS, signals.code_noise),
            rate_noise=_fitted(rates, rate, heard, RATE_BOUNDS, signals.rate_noise),
        )
    return signals


def _without_biases(signals: Signals) -> Signals:
    """With the median residual of each other system against fixes by GPS alone taken off."""
    others = np.unique(signals.system[signals.system > 0])
    if not others.size:
        return signals
    alone = np.where(signals.system > 0, np.nan, signals.pseudorange)
    fixes = fix(replace(signals, pseudorange=alone))
    residual, _ = _residuals(signals, fixes)
    pseudorange = signals.pseudorange.copy()
    for system in others:
        those = signals.system == system
        known = residual[:, those][np.isfinite(residual[:, those])]
        # Of a system that GPS cannot vouch for nothing is used
        pseudorange[:, those] -= np.median(known) if known.size >= FEW else np.nan
    return replace(signals, pseudorange=pseudorange)


def _residuals(signals: Signals, fixes: Fixes) -> tuple[Array, Array]:
    """Of pseudoranges, m, and of rates, m/s: (T, S) each, NaN where there is none."""
    seen = view(signals, fixes.position)
    distance = np.linalg.norm(seen.position - fixes.position[:, None], axis=-1)
    ranges = seen.pseudorange - distance - fixes.bias[:, None]
    slopes = range_slopes(seen.position, fixes.position)[..., :3]
    relative = fixes.velocity[:, None] - seen.velocity
    rates = signals.rate - np.sum(slopes * relative, axis=-1) - fixes.drift[:, None]
    return ranges, rates


def _fitted(residual: Array, deviation, strength: Array, bounds, before: Array) -> Array:
    """The noise (T, S) whose deviations make the median of what remains that of a normal."""
    used = np.isfinite(residual)
    count = used.sum(axis=1, keepdims=True)
    used &= count > UNKNOWNS
    if used.sum() < FEW:
        return before
    # A fix takes up a share of the noise
    residual = residual / np.sqrt(np.maximum(count - UNKNOWNS, 1) / np.maximum(count, 1))
    low, high = np.log(bounds)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        spread = np.median(np.abs(residual / deviation(np.exp(middle)))[used])
        low, high = (middle, high) if spread > MEDIAN else (low, middle)
    return noise_at(strength, float(np.exp(middle)))
