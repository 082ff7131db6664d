"""E6: inertial navigation with outlying fixes (SPEC 7.1; claims C11, C12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, AdaptiveDesign
from kfenv.filters.results import NOT_POSITIVE_DEFINITE, OK
from kfenv.scenarios.faults import Draft, Fault
from kfenv.scenarios.inertial.faults import AccelerationStep, Outliers, RateStep
from kfenv.scenarios.inertial.ins_gnss import InsGnss

from . import inertial_figures
from .claims import Claim, judge, mean_and_interval, with_interval
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

Array = NDArray[np.float64]
Outcomes = dict[str, Outcome]

OUTLIERS = Outliers()
WINDOW = (OUTLIERS.start, OUTLIERS.start + OUTLIERS.duration)  # s, of the errors told
UNIT_FAULT: tuple[Fault, ...] = (  # 5 m/s^2 forward and right, 3 deg/s in yaw
    AccelerationStep(1.0, (5.0, 5.0), (10.0, 10.0), 10.0, (0, 1)),
    RateStep(1.0, (3.0, 3.0), (10.0, 10.0), 10.0, (2,)),
)
UNIT_FAULT_END = 20.0  # s
SMALL_Q = 0.01  # factor of Q: deviations a tenth of the default
POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
PARTS = {"position, m": POSITION, "velocity, m/s": VELOCITY, "attitude, deg": ATTITUDE}
SAME = 0.01  # share of the error below which two filters are one
FAR = 1000.0  # m, an error that is no navigation any more

EIGHT = tuple(Method(name.upper(), design) for name, design in ADAPTIVE_DESIGNS.items())


def _fading(name: str, **choices: object) -> AdaptiveDesign:
    design = ADAPTIVE_DESIGNS[name]
    return replace(design, fading=replace(design.fading, **choices))


PRINTED_V = Method("GSACKF, printed V", _fading("gsackf", v_mode="printed"))
CAUTIOUS = Method("GSACKF, β = 3", _fading("gsackf", beta=3.0))
AS_PRINTED = (
    Method("ACKF, eq 40 as printed", _fading("ackf", applied="raw-moment")),
    Method("ACKF, eq 41, 42 as printed", _fading("ackf", applied="twice")),
)
PUBLISHED = (*EIGHT, PRINTED_V, CAUTIOUS, *AS_PRINTED)
FAULTY = tuple(
    replace(method, process_scale=SMALL_Q)
    for method in (*EIGHT, CAUTIOUS)
    if method.label in ("CKF", "ACKF", "GSCKF", "GSACKF", CAUTIOUS.label)
)
DRAWN = ("CKF", "ACKF", "GSCKF", "GSACKF")
ZOOM = (14.0, 18.0)  # s


@dataclass(frozen=True)
class PublishedFlight(InsGnss):
    """The published flight and unit, with outlying fixes.

    Attributes:
        unit_fault: whether the inertial unit goes wrong as well, from 10 to 20 s.
        by: what an outlier hits, see `Outliers`.
    """

    faults: str = "paper"
    unit_fault: bool = False
    by: str = "vector"

    def spoil(self, draft: Draft, rng: Generator) -> None:
        """See `TrackingScenario.spoil`."""
        for fault in (replace(OUTLIERS, by=self.by), *(UNIT_FAULT if self.unit_fault else ())):
            fault.apply(draft, rng)


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E6."""
    study, outcomes = laboratory.study("published", PublishedFlight(), PUBLISHED, spacing=0.1)
    faulty, struck = laboratory.study(
        "unit fault", PublishedFlight(unit_fault=True), FAULTY, spacing=0.1
    )
    few = tuple(replace(method, process_scale=1.0) for method in FAULTY)
    relaxed = laboratory.study(
        "unit fault, default Q", PublishedFlight(unit_fault=True), few, spacing=0.1
    )[1]
    by_channel, single = laboratory.study(
        "outliers by channel", PublishedFlight(by="channel"), few, spacing=0.1
    )
    _draw(laboratory, study, outcomes, struck)
    return [
        _robust(study, outcomes),
        _fades(study, outcomes),
        _best(study, outcomes),
        _best_when_struck(faulty, struck, relaxed),
        _mismatched(by_channel, single),
        _diverges(study, outcomes),
        _more_accurate(study, outcomes),
        _as_printed(study, outcomes),
    ]


def _draw(laboratory: Laboratory, study: Study, outcomes: Outcomes, struck: Outcomes) -> None:
    recording = study.sample(0, 1)
    methods = [method for method in EIGHT if method.label in DRAWN]
    paths = {m.label: filter_recording(study.scenario, m, recording).mean[0] for m in methods}
    time, truth, fixes = recording.time, recording.truth[0], recording.measurement[0]
    for name, part in (("velocity", VELOCITY), ("attitude", ATTITUDE)):
        shown = {label: path[:, part] for label, path in paths.items()}
        drawn = inertial_figures.estimates(
            name, time, truth[:, part], fixes[:, part], shown, WINDOW, ZOOM
        )
        laboratory.save(drawn, name)
        errors = {label: outcomes[label].channel_error[0, :, part] for label in DRAWN}
        drawn = inertial_figures.errors(name, study.time, errors, WINDOW)
        laboratory.save(drawn, f"{name}_error")
    eight = {method.label: outcomes[method.label].channel_error for method in EIGHT}
    laboratory.save(inertial_figures.rmse(study.time, eight, {"outliers": WINDOW}), "rmse")
    both = {"outliers": WINDOW, "unit fault": (UNIT_FAULT[0].start, UNIT_FAULT_END)}
    errors = {label: outcome.channel_error for label, outcome in struck.items()}
    laboratory.save(inertial_figures.rmse(study.time, errors, both), "rmse_unit_fault")


def _window(study: Study) -> NDArray[np.bool_]:
    return (study.time >= WINDOW[0]) & (study.time < WINDOW[1])


def rmse_of_runs(study: Study, outcome: Outcome, part: slice) -> Array:
    """(N,) of one part of the state while outliers come; infinite where the filter failed."""
    error = outcome.channel_error[:, _window(study), part]
    if part == ATTITUDE:
        error = np.degrees(error)
    value = np.sqrt(np.mean(np.sum(error**2, axis=2), axis=1))
    return np.where(np.isfinite(value), value, np.inf)


def _pooled(study: Study, outcome: Outcome, part: slice) -> float:
    return float(np.sqrt(np.mean(rmse_of_runs(study, outcome, part) ** 2)))


def _told(study: Study, outcomes: Mapping[str, Outcome], labels: Sequence[str]) -> str:
    """RMSE over all runs of position, velocity and attitude, and failures, of each filter."""
    rows = []
    for label in labels:
        position, velocity, attitude = (
            _pooled(study, outcomes[label], part) for part in PARTS.values()
        )
        failed = int(np.sum(outcomes[label].failure != OK))
        rows.append(
            f"{label} {position:.4g} m, {velocity:.3g} m/s, {attitude:.2f} deg"
            + (f" ({failed} of {study.runs} failed)" if failed else "")
        )
    return "; ".join(rows)


def _gain(study: Study, outcomes: Outcomes, worse: str, better: str) -> Array:
    """(N,) position RMSE of the one less the other's, on the same noise, m.

    Infinite where the worse failed, minus infinity where the better did, NaN where both.
    """
    more, less = (rmse_of_runs(study, outcomes[label], POSITION) for label in (worse, better))
    with np.errstate(invalid="ignore"):
        return more - less


def _surely_positive(values: Array) -> bool:
    """Whether a gain is; not if the better filter failed in any run."""
    return bool(np.all(values > -np.inf)) and mean_and_interval(values)[1] > 0.0


def _slashed(numbers: Sequence[float]) -> str:
    return "/".join(f"{number:g}" for number in numbers)


def _robust(study: Study, outcomes: Outcomes) -> Claim:
    gains = [_gain(study, outcomes, kind, f"GS{kind}") for kind in ("EKF", "CKF")]
    return Claim(
        "C11 (E6)",
        "Gaussian sums withstand the outliers",
        "S4 sec. 5",
        f"deviations of fixes, {_slashed(study.scenario.gnss_noise)} m, m/s, deg, and of Q after "
        f"a second, {_slashed(study.scenario.process_noise)}, are not the paper's tables but "
        f"chosen so that errors are as large as in SPEC 7.2. RMSE {WINDOW[0]:g} to "
        f"{WINDOW[1]:g} s, {study.runs} runs: "
        f"{_told(study, outcomes, ('EKF', 'CKF', 'GSEKF', 'GSCKF'))}. "
        f"Position of CKF less GSCKF: {with_interval(gains[1])}",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _fades(study: Study, outcomes: Outcomes) -> Claim:
    gains = [_gain(study, outcomes, kind, f"A{kind}") for kind in ("EKF", "CKF")]
    return Claim(
        "C11b (E6)",
        "adaptive fading improves the EKF and the CKF",
        "S4 sec. 5",
        f"{_told(study, outcomes, ('AEKF', 'ACKF'))}. Position of ACKF less CKF: "
        f"{with_interval(-gains[1])}"
        + (": an outlier raises the gain" if _surely_positive(-gains[1]) else ""),
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _best(study: Study, outcomes: Outcomes) -> Claim:
    labels = (PRINTED_V.label, "GSAEKF", "GSACKF", CAUTIOUS.label)
    others = [method.label for method in EIGHT if method.label != "GSACKF"]

    def below(label: str, rivals: Sequence[str]) -> bool:
        return all(_surely_positive(_gain(study, outcomes, rival, label)) for rival in rivals)

    best = any(below(label, others) for label in (PRINTED_V.label, "GSACKF", CAUTIOUS.label))
    order = ("GSCKF", "CKF", PRINTED_V.label, "ACKF")
    rising = all(below(better, (worse,)) for better, worse in pairwise(order))
    excess = _gain(study, outcomes, "GSACKF", "GSCKF")
    robust, sums = (_pooled(study, outcomes[label], POSITION) for label in ("GSACKF", "GSCKF"))
    return Claim(
        "C11c (E6)",
        "GSACKF is the most accurate, GSCKF the next",
        "S4 sec. 5",
        f"{_told(study, outcomes, labels)}; GSCKF as above. GSACKF less GSCKF: "
        f"{with_interval(excess)}, {robust / sums:.2f} times it (SPEC 7.3: at most 1.35). The "
        f"order GSCKF < CKF < GSACKF (printed V) < ACKF is {'sure' if rising else 'not sure'}",
        judge(best and below("GSCKF", ("EKF", "CKF", "AEKF", "ACKF"))),
    )


def _best_when_struck(study: Study, struck: Outcomes, relaxed: Outcomes) -> Claim:
    labels = ("CKF", "ACKF", "GSCKF", "GSACKF")
    speed = {label: rmse_of_runs(study, struck[label], VELOCITY) for label in labels}
    gains = {label: speed[label] - speed["GSACKF"] for label in labels if label != "GSACKF"}
    farthest = np.max(np.linalg.norm(struck["GSCKF"].error[..., POSITION], axis=2), axis=1)
    astray = int(np.sum(~(farthest <= FAR)))
    taken = "takes the fault for outliers and " if astray else ""
    return Claim(
        "C11d (E6)",
        "GSACKF is the best where the inertial unit goes wrong as well",
        "not in S4; SPEC 7.2",
        f"+5 m/s² forward and right and +3 deg/s in yaw from 10 to 20 s, deviations of Q a tenth: "
        f"{_told(study, struck, (*labels, CAUTIOUS.label))}. CKF less GSACKF: "
        f"{with_interval(gains['CKF'], 'm/s')}. GSCKF {taken}is more than {FAR / 1e3:g} km off in "
        f"{astray} of {study.runs} runs. With the default Q: "
        f"{_told(study, relaxed, ('GSCKF', 'GSACKF'))}",
        judge(all(_surely_positive(gain) for gain in gains.values())),
    )


def _mismatched(study: Study, single: Outcomes) -> Claim:
    gains = [_gain(study, single, "CKF", label) for label in ("GSCKF", "GSACKF")]
    return Claim(
        "C11e (E6)",
        "the sums withstand outliers in single channels, for which they are not made",
        "not in S4; SPEC 4.4",
        f"{_told(study, single, ('CKF', 'ACKF', 'GSCKF', 'GSACKF', CAUTIOUS.label))}. A single "
        "channel must be 7 to 8 deviations off before the whole fix counts as an outlier; until "
        "then the fading sum takes it for nominal, and fades",
        judge(all(_surely_positive(gain) for gain in gains)),
    )


def _apart(outcomes: Outcomes, one: str, other: str, part: slice) -> float:
    """Largest difference of two filters' errors as long as both work, in the part's unit."""
    difference = outcomes[one].channel_error[..., part] - outcomes[other].channel_error[..., part]
    return float(np.max(np.abs(difference[np.isfinite(difference)]), initial=0.0))


def _diverges(study: Study, outcomes: Outcomes) -> Claim:
    apart = _apart(outcomes, "CKF", "EKF", ATTITUDE)
    typical = _pooled(study, outcomes["EKF"], ATTITUDE)
    lost = {label: int(outcomes[label].lost.sum()) for label in ("EKF", "CKF")}
    ckf = _pooled(study, outcomes["CKF"], ATTITUDE)
    return Claim(
        "C12 (E6)",
        "in attitude the CKF diverges, the EKF converges",
        "S4 Fig. 5, 6",
        f"attitude RMSE EKF {typical:.3g}, CKF {ckf:.3g} deg; estimates at most "
        f"{np.degrees(apart):.1e} deg apart; lost {lost['EKF']} and {lost['CKF']} of {study.runs}",
        judge(ckf > 2.0 * typical or lost["CKF"] > lost["EKF"]),
    )


def _more_accurate(study: Study, outcomes: Outcomes) -> Claim:
    gain = rmse_of_runs(study, outcomes["EKF"], VELOCITY) - rmse_of_runs(
        study, outcomes["CKF"], VELOCITY
    )
    typical = _pooled(study, outcomes["EKF"], VELOCITY)
    apart = _apart(outcomes, "GSCKF", "GSEKF", VELOCITY)
    return Claim(
        "C12b (E6)",
        "in velocity the CKF beats the EKF",
        "S4 sec. 5",
        f"EKF less CKF: {with_interval(gain, 'm/s')} of {typical:.3g}; GSEKF and GSCKF at most "
        f"{apart:.1e} m/s apart: the measurement is linear and the mechanisation nearly so",
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
    right = outcomes["ACKF"]
    worse = any(
        _surely_positive(rmse_of_runs(study, raw, part) - rmse_of_runs(study, right, part))
        for part in PARTS.values()
    )
    return Claim(
        "S4 eq 40 to 42 (E6)",
        "the fading filter works as printed",
        "S4 eq 40 to 42",
        f"{'; '.join(told)}. Eq 40 fades the raw second moment, which grows with the distance "
        f"from the origin: {_told(study, outcomes, (AS_PRINTED[0].label, 'ACKF'))}. With eq 41 "
        f"and 42 the covariance stops being positive definite in {negative} of {study.runs} runs",
        judge(not worse and not raw.lost.any() and not twice.lost.any()),
    )
