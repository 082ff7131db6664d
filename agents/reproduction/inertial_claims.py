"""Verdicts on the claims of E6: RMSE per axis and in 3-D, angle by angle (SPEC 7.2 C11, C12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import log, sqrt

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.results import NOT_POSITIVE_DEFINITE

from .claims import Claim, digits, judge, mean_and_interval, with_interval
from .inertial_case import (
    AS_PRINTED,
    CAUTIOUS,
    EIGHT,
    PRINTED_V,
    SHIFT,
    SWING,
    UNIT_FAULT_SPAN,
    WINDOW,
    fix_errors,
)
from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]
Outcomes = Mapping[str, Outcome]
Span = tuple[float, float]
Channels = slice | int

POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
PARTS = {"m": POSITION, "m/s": VELOCITY, "deg": ATTITUDE}
ANGLES = {"yaw": 8, "pitch": 7, "roll": 6}
FOUR = ("CKF", "ACKF", "GSCKF", "GSACKF")
APART = 2.0  # times another's error: a filter that diverges beside one that does not
SAME = 0.01  # share of the error below which two filters are one
FAR = 1000.0  # m, an error that is no navigation any more


def of_the_case(study: Study, outcomes: Outcomes) -> list[Claim]:
    """The claims on the paper's own case."""
    return [
        _robust(study, outcomes),
        _fades(study, outcomes),
        _best(study, outcomes),
        *(_diverges(study, outcomes, "C12", angle, "EKF", "CKF") for angle in ANGLES),
        _more_accurate(study, outcomes),
        *(_diverges(study, outcomes, "C12c", angle, "AEKF", "ACKF") for angle in ANGLES),
        _as_printed(study, outcomes),
    ]


def rmse_of_runs(study: Study, outcome: Outcome, channels: Channels, span: Span = WINDOW) -> Array:
    """(N,) per axis within a span of time, m, m/s or deg; infinite where the filter failed."""
    when = (study.time >= span[0]) & (study.time < span[1])
    error = outcome.channel_error[:, when, channels].reshape(study.runs, -1)
    value = _unit(channels) * np.sqrt(np.mean(error**2, axis=1))
    return np.where(np.isfinite(value), value, np.inf)


def pooled(study: Study, outcome: Outcome, channels: Channels, span: Span = WINDOW) -> float:
    """`rmse_of_runs` over all runs."""
    return float(np.sqrt(np.mean(rmse_of_runs(study, outcome, channels, span) ** 2)))


def suspected_at(channels: int, share: float, ratio: float) -> float:
    """Deviations of one channel, with no others off, at which an outlier is as likely as not.

    For a filter that is sure of its prediction: (1 - share) N(0, R) = share N(0, ratio R).
    """
    odds = log((1.0 - share) / share) + 0.5 * channels * log(ratio)
    return sqrt(2.0 * odds / (1.0 - 1.0 / ratio))


def _unit(channels: Channels) -> float:
    first = channels.start if isinstance(channels, slice) else channels
    return float(np.degrees(1.0)) if first >= ATTITUDE.start else 1.0


def _told(study: Study, outcomes: Outcomes, labels: Sequence[str]) -> str:
    """RMSE per axis, and in 3-D in brackets, of each part of the state, and lost runs."""
    rows = []
    for label in labels:
        outcome = outcomes[label]
        values = {unit: pooled(study, outcome, part) for unit, part in PARTS.items()}
        told = ", ".join(
            f"{digits(v)} ({digits(sqrt(3.0) * v)}) {unit}" for unit, v in values.items()
        )
        lost = int(outcome.lost.sum())
        rows.append(f"{label} {told}" + (f", {lost} of {study.runs} lost" if lost else ""))
    return "; ".join(rows)


def _gain(study: Study, outcomes: Outcomes, worse: str, better: str, part: Channels) -> Array:
    """(N,) RMSE per axis of the one less the other's, on the same noise.

    Infinite where the worse failed, minus infinity where the better did, NaN where both.
    """
    more, less = (rmse_of_runs(study, outcomes[label], part) for label in (worse, better))
    with np.errstate(invalid="ignore"):
        return more - less


def _surely_positive(values: Array) -> bool:
    """Whether a gain is; not if the better filter failed in any run."""
    return bool(np.all(values > -np.inf)) and mean_and_interval(values)[1] > 0.0


def _below(study: Study, outcomes: Outcomes, label: str, rivals: Sequence[str]) -> bool:
    """Whether a filter's position is surely better than each rival's."""
    gains = (_gain(study, outcomes, rival, label, POSITION) for rival in rivals)
    return all(_surely_positive(gain) for gain in gains)


def _robust(study: Study, outcomes: Outcomes) -> Claim:
    gains = [_gain(study, outcomes, kind, f"GS{kind}", POSITION) for kind in ("EKF", "CKF")]
    return Claim(
        "C11 (E6)",
        "Gaussian sums withstand the outliers",
        "S4 sec. 5",
        f"RMSE per axis (in 3-D) from {WINDOW[0]:g} to {WINDOW[1]:g} s: "
        f"{_told(study, outcomes, ('EKF', 'CKF', 'GSEKF', 'GSCKF'))}. "
        f"Position of CKF less GSCKF: {with_interval(gains[1])}. {study.runs} runs; start, P, Q "
        "and R of S4 Tables 1, 2, flight and inertial unit ours",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _fades(study: Study, outcomes: Outcomes) -> Claim:
    gains = [_gain(study, outcomes, kind, f"A{kind}", POSITION) for kind in ("EKF", "CKF")]
    fixes = np.sqrt(np.mean(fix_errors(study, study.runs)[..., POSITION] ** 2))
    return Claim(
        "C11b (E6)",
        "adaptive fading improves the EKF and the CKF",
        "S4 sec. 5",
        f"{_told(study, outcomes, ('AEKF', 'ACKF'))}. Position of ACKF less CKF: "
        f"{with_interval(-gains[1])}; the fixes themselves {digits(fixes)} m",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _best(study: Study, outcomes: Outcomes) -> Claim:
    labels = (PRINTED_V.label, "GSAEKF", "GSACKF", CAUTIOUS.label)
    others = [method.label for method in EIGHT if method.label != "GSACKF"]
    candidates = (PRINTED_V.label, "GSACKF", CAUTIOUS.label)
    best = any(_below(study, outcomes, label, others) for label in candidates)
    order = ("GSCKF", "CKF", PRINTED_V.label, "ACKF")
    rising = all(_below(study, outcomes, better, (worse,)) for better, worse in pairwise(order))
    excess = _gain(study, outcomes, "GSACKF", "GSCKF", POSITION)
    robust, sums = (pooled(study, outcomes[label], POSITION) for label in ("GSACKF", "GSCKF"))
    return Claim(
        "C11c (E6)",
        "GSACKF is the most accurate, GSCKF the next",
        "S4 sec. 5",
        f"{_told(study, outcomes, labels)}; GSCKF as above. Position of GSACKF less GSCKF: "
        f"{with_interval(excess)}, {robust / sums:.2f} times it. The order GSCKF < CKF < GSACKF "
        f"(printed V) < ACKF is {'sure' if rising else 'not sure'}",
        judge(best and _below(study, outcomes, "GSCKF", ("EKF", "CKF", "AEKF", "ACKF"))),
    )


def best_when_struck(study: Study, struck: Outcomes, relaxed: Outcomes) -> Claim:
    """C11d, with a fault of the inertial unit as well."""
    gains = {label: _gain(study, struck, label, "GSACKF", VELOCITY) for label in FOUR[:-1]}
    farthest = np.max(np.linalg.norm(struck["GSCKF"].error[..., POSITION], axis=2), axis=1)
    astray = int(np.sum(~(farthest <= FAR)))
    begin, end = UNIT_FAULT_SPAN
    return Claim(
        "C11d (E6)",
        "GSACKF is the best where the inertial unit goes wrong as well",
        "not in S4; SPEC 7.2",
        f"+5 m/s² forward and right and +3 deg/s in yaw from {begin:g} to {end:g} s, deviations "
        f"of Q a tenth: {_told(study, struck, (*FOUR, CAUTIOUS.label))}. Velocity of CKF less "
        f"GSACKF: {with_interval(gains['CKF'], 'm/s')}. GSCKF is more than {FAR / 1e3:g} km off "
        f"in {astray} of {study.runs} runs. With the Q of the table: "
        f"{_told(study, relaxed, ('GSCKF', 'GSACKF'))}",
        judge(all(_surely_positive(gain) for gain in gains.values())),
    )


def mismatched(study: Study, outcomes: Outcomes) -> Claim:
    """C11e, outliers in single channels."""
    gains = [_gain(study, outcomes, "CKF", label, POSITION) for label in ("GSCKF", "GSACKF")]
    suspected = suspected_at(len(study.scenario.fix_deviations), *study.scenario.mixture)
    return Claim(
        "C11e (E6)",
        "the sums withstand outliers in single channels, for which they are not made",
        "not in S4; SPEC 4.4",
        f"{_told(study, outcomes, (*FOUR, CAUTIOUS.label))}. To a filter that is sure of its "
        f"prediction a single channel {suspected:.2g} deviations off is as likely an outlier as "
        "not",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def varies(study: Study, outcomes: Outcomes) -> Claim:
    """C11f, the mixture's covariance varies inside the window."""
    pairs = (("CKF", "ACKF"), ("GSCKF", "GSACKF"), ("GSCKF", CAUTIOUS.label))
    gains = [_gain(study, outcomes, *pair, POSITION) for pair in pairs]
    return Claim(
        "C11f (E6)",
        "fading helps where the mixture's covariance varies",
        "S4 abstract",
        f"{_told(study, outcomes, (*FOUR, CAUTIOUS.label))}. "
        f"Position of ACKF less CKF: {with_interval(-gains[0])}; of GSACKF less GSCKF: "
        f"{with_interval(-gains[1])}, at β = 3: {with_interval(-gains[2])}. How it varies is "
        f"ours: all deviations rise to {SWING:g} times theirs in the middle of the window and "
        "fall again, untold",
        judge(all(_surely_positive(gain) for gain in gains[:2])),
    )


def not_centred(study: Study, outcomes: Outcomes) -> Claim:
    """C11g, outliers with a mean that is not zero."""
    gains = [_gain(study, outcomes, "CKF", label, POSITION) for label in ("GSCKF", "GSACKF")]
    return Claim(
        "C11g (E6)",
        "Gaussian sums withstand outliers whose mean is not zero",
        "S4 eq 37, Fig. 6",
        f"{_told(study, outcomes, (*FOUR, CAUTIOUS.label))}. Position of CKF less GSCKF: "
        f"{with_interval(gains[0])}. The mean is ours: {SHIFT:g} of the outliers' own "
        "deviations in every channel, untold",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _apart(outcomes: Outcomes, one: str, other: str, channels: Channels) -> float:
    """Largest difference of two filters' errors as long as both work."""
    errors = [outcomes[label].channel_error[..., channels] for label in (one, other)]
    difference = errors[0] - errors[1]
    turn = 2.0 * np.pi
    if _unit(channels) != 1.0:
        difference -= turn * np.round(difference / turn)
    kept = np.abs(difference[np.isfinite(difference)])
    return _unit(channels) * float(np.max(kept, initial=0.0))


def _diverges(
    study: Study, outcomes: Outcomes, name: str, angle: str, stable: str, other: str
) -> Claim:
    """Whether an extended filter is stable in an angle while its cubature twin diverges:

    whether its error is surely larger, and more than twice as large while outliers come or after.
    """
    channel, end = ANGLES[angle], float(study.time[-1])
    gain = _gain(study, outcomes, other, stable, channel)
    fixes = np.degrees(np.sqrt(np.mean(fix_errors(study, study.runs)[..., channel] ** 2)))
    told, apart = [], False
    for span in (WINDOW, (WINDOW[1], end)):
        first, second = (pooled(study, outcomes[label], channel, span) for label in (stable, other))
        told.append(f"{span[0]:g} to {span[1]:g} s {stable} {first:.3g}, {other} {second:.3g} deg")
        apart = apart or second > APART * first
    return Claim(
        f"{name} {angle} (E6)",
        f"in {angle} the {other} diverges, the {stable} does not",
        "S4 sec. 5, text",
        f"RMSE {'; '.join(told)}; the fixes themselves {digits(fixes)}. {other} less {stable}: "
        f"{with_interval(gain, 'deg')}; estimates at most "
        f"{_apart(outcomes, stable, other, channel):.1e} deg apart",
        judge(apart and _surely_positive(gain)),
    )


def _more_accurate(study: Study, outcomes: Outcomes) -> Claim:
    gain = _gain(study, outcomes, "EKF", "CKF", VELOCITY)
    typical = pooled(study, outcomes["EKF"], VELOCITY)
    apart = _apart(outcomes, "GSCKF", "GSEKF", VELOCITY)
    return Claim(
        "C12b (E6)",
        "in velocity the CKF beats the EKF",
        "S4 sec. 5, text",
        f"EKF less CKF: {with_interval(gain, 'm/s')} of {typical:.3g} per axis; GSEKF and GSCKF "
        f"at most {apart:.1e} m/s apart",
        judge(_surely_positive(gain) and float(gain.mean()) > SAME * typical),
    )


def _as_printed(study: Study, outcomes: Outcomes) -> Claim:
    told = []
    for method in AS_PRINTED:
        outcome = outcomes[method.label]
        end = outcome.lost_at[outcome.lost]
        when = f", median at {np.median(end):.1f} s" if len(end) else ""
        told.append(f"{method.label}: {len(end)} of {study.runs} lost{when}")
    raw, twice = (outcomes[method.label] for method in AS_PRINTED)
    negative = int(np.sum(twice.failure == NOT_POSITIVE_DEFINITE))
    worse = any(
        _surely_positive(_gain(study, outcomes, AS_PRINTED[0].label, "ACKF", part))
        for part in PARTS.values()
    )
    return Claim(
        "S4 eq 40 to 42 (E6)",
        "the fading filter works as printed",
        "S4 eq 40 to 42",
        f"{'; '.join(told)}. Eq 40 fades the raw second moment: "
        f"{_told(study, outcomes, (AS_PRINTED[0].label, 'ACKF'))}. With eq 41 and 42 the "
        f"covariance stops being positive definite in {negative} of {study.runs} runs",
        judge(not worse and not raw.lost.any() and not twice.lost.any()),
    )
