"""What S0 claims of E4, and what was measured (SPEC 7.2, C10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.models.gnss.pseudorange import BIAS

from .claims import Claim, judge, mean_and_interval, too_few, with_interval
from .gnss_errors import (
    ACCELERATION,
    CLOCK,
    FAULT,
    LOSS,
    POSITION,
    SETTLED,
    inside,
    outside,
    rms,
    run_rms,
)
from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]
Outcomes = dict[str, Outcome]

BROKEN = 1e6  # times the condition number of a sound covariance: this one has come apart
ROUNDING = 1e-3  # m, m/s or m/s^2: of states of 6e6 m, over 2500 steps
JOSEPH = ("EKF-J", "UKF-J", "SRUKF-J")
ROOT_FIRST = JOSEPH[::-1]
OUR_FAULT = f"our clock fault of {CLOCK.range_error[0]:g} m, {FAULT[0]:g} to {FAULT[1]:g} s"


def clock_fault(
    study: Study, outcomes: Outcomes, printed: str, alone: Outcome, satellites: NDArray[np.int64]
) -> Claim:
    """Who is lost in the clock fault; `printed` is the label of the filter as printed.

    Args:
        alone: fixes of single epochs.
        satellites: (K,) received.
    """
    lost = {label: _lost(outcome, 0.0, LOSS[0]) for label, outcome in outcomes.items()}
    early = _lost(outcomes[printed], 0.0, FAULT[0])
    sound = {label: outcome for label, outcome in outcomes.items() if label != printed}
    told = "; ".join(
        f"{label} {_three(rms(outcome, POSITION, inside(study)))} "
        f"({_three(rms(outcome, POSITION, outside(study)))})"
        for label, outcome in (sound | {"GNSS alone, epoch by epoch": alone}).items()
    )
    seen = np.unique(satellites[satellites > 0])
    many = f"{seen[0]}" if len(seen) == 1 else f"{seen[0]} to {seen[-1]}"
    only_rivals = lost["EKF-J"] > 0 and lost["UKF-J"] > 0 and lost["SRUKF-J"] == 0
    return Claim(
        "C10 (E4)",
        "the clock fault makes EKF and UKF diverge even with Joseph, the SRUKF not",
        "S0 sec. 5.2",
        f"of {study.runs} runs lost until our loss of lock at {LOSS[0]:g} s: {_listed(lost)} "
        f"({printed} {_breaking(study, outcomes[printed], outcomes['EKF-J'])}, {early} lost before "
        f"the fault). RMSE east/north/up in {OUR_FAULT} (outside), m, with {many} satellites: "
        f"{told}",
        judge(only_rivals),
    )


def _breaking(study: Study, printed: Outcome, sound: Outcome) -> str:
    """When the covariance of the EKF as printed comes apart."""
    usual = np.nanmedian(sound.condition, axis=0)
    apart = ~(printed.condition <= BROKEN * usual)
    onset = study.time[np.argmax(apart, axis=1)][apart.any(axis=1)]
    if not len(onset):
        return "keeps its conditioning"
    return (
        f"has κ(P) {BROKEN:.0e} times too large in {len(onset)} runs, from {onset.min():.0f}, "
        f"median {np.median(onset):.0f} s"
    )


def one_estimator(outcomes: Outcomes) -> Claim:
    """Whether the square root changes the estimate."""
    apart = {}
    for one, other in (("UKF-J", "SRUKF-J"), ("UKF", "SRUKF-J exact"), ("EKF-J", "UKF-J")):
        both = ~(outcomes[one].lost | outcomes[other].lost)
        difference = np.abs(outcomes[one].error - outcomes[other].error)[both]
        apart[f"{one} and {other}"] = float(np.max(difference, initial=0.0))
    told = ", ".join(f"{pair} {distance:.1e}" for pair, distance in apart.items())
    return Claim(
        "C10 same (E4)",
        "the square root makes another estimator of the UKF",
        "S0 sec. 5.2",
        f"largest difference in any state at any kept instant, m, m/s or m/s²: {told}",
        judge(apart["UKF-J and SRUKF-J"] > ROUNDING),
    )


def loss_of_lock(study: Study, outcomes: Outcomes, printed: str, least: Array) -> Claim:
    """Who is lost without satellites, and how far off the others are in the end."""
    sound = {label: outcome for label, outcome in outcomes.items() if label != printed}
    lost = {label: _lost(outcome, LOSS[0], np.inf) for label, outcome in sound.items()}
    end = np.argmax(study.time >= LOSS[1]) - 1
    last = study.time == study.time[end]
    peaks = {k: np.linalg.norm(rms(outcome, POSITION, last)) for k, outcome in sound.items()}
    told = ", ".join(f"{label} {peak:.1f}" for label, peak in peaks.items())
    return Claim(
        "C10 PLL (E4)",
        f"{LOSS[1] - LOSS[0]:g} s (ours) without any satellite are survived",
        "S0 sec. 5.2",
        f"of {study.runs} runs lost from {LOSS[0]:g} s on: {_listed(lost)}; RMS position error "
        f"at {study.time[end]:g} s, m: {told}. Over flights drawn from the motion model no filter "
        f"can have less than {np.linalg.norm(least[end]):.0f} m there",
        judge(not any(lost.values())),
    )


def noisier(study: Study, outcomes: Outcomes) -> Claim:
    """What the clock fault does to the height."""
    up = slice(6, 7)
    told, holds = [], True
    for label in JOSEPH:
        calm, fault = (run_rms(outcomes[label], up, w(study)) for w in (outside, inside))
        told.append(
            f"{label} {np.nanmean(calm):.2f} → {np.nanmean(fault):.2f} m, "
            f"{with_interval(fault - calm)} more{too_few(fault - calm, 0.0)}"
        )
        holds &= mean_and_interval(fault - calm)[1] > 0.0
    clock = (rms(outcomes["SRUKF-J"], BIAS, when(study)) for when in (outside, inside))
    return Claim(
        "C10b (E4)",
        "the vertical error is noisier during the clock fault",
        "S0 sec. 5.2",
        f"mean RMSE of a run outside → in {OUR_FAULT}: {'; '.join(told)}. RMSE of SRUKF-J's clock "
        f"bias {' → '.join(f'{number:.1f}' for number in clock)} m",
        judge(holds),
    )


def acceleration(study: Study, outcomes: Outcomes) -> Claim:
    """Of the runs that were not lost, whose number `clock_fault` and `loss_of_lock` tell."""
    own, *others = (
        run_rms(outcomes[label], ACCELERATION, study.time > SETTLED) for label in ROOT_FIRST
    )
    gains = {label: other - own for label, other in zip(ROOT_FIRST[1:], others, strict=True)}
    told = "; ".join(
        f"{label}'s {with_interval(gain, 'm/s²')}{too_few(gain, ROUNDING)}"
        for label, gain in gains.items()
    )
    axes = {
        label: " → ".join(_three(rms(outcomes[label], ACCELERATION, when(study)), 2)
                          for when in (outside, inside))
        for label in ROOT_FIRST
    }  # fmt: skip
    return Claim(
        "C10c (E4)",
        "the square root improves the estimated acceleration",
        "S0 Fig. 16",
        f"RMSE of a run after {SETTLED:g} s less that of SRUKF-J: {told}. RMSE east/north/up "
        f"outside → in {OUR_FAULT}, m/s²: {_listed(axes)}",
        judge(all(mean_and_interval(gain)[1] > ROUNDING for gain in gains.values())),
    )


def appendix(study: Study, right: Outcome, printed: dict[float, Outcome]) -> Claim:
    """What Appendix B's Jacobian costs, by the time step in it."""
    told = []
    for step, outcome in printed.items():
        axes = (_three(rms(outcome, POSITION, when(study))) for when in (outside, inside))
        told.append(
            f"dt = {step:g} s: {' → '.join(axes)} m, {int(outcome.lost.sum())} of {study.runs} lost"
        )
    axes = (_three(rms(right, POSITION, when(study))) for when in (outside, inside))
    worst = max(rms(o, POSITION, inside(study))[2] for o in printed.values())
    return Claim(
        "C10d (E4)",
        "Appendix B's Jacobian serves the Joseph form",
        "S0 App. B",
        f"RMSE east/north/up outside → in {OUR_FAULT}, of SRUKF-J with it, {'; '.join(told)}; "
        f"with the Jacobian at the measurement's time {' → '.join(axes)} m",
        judge(worst < 1.1 * rms(right, POSITION, inside(study))[2]),
    )


def _lost(outcome: Outcome, start: float, stop: float) -> int:
    """How many tracks were lost in an interval."""
    return int(np.sum((outcome.lost_at >= start) & (outcome.lost_at < stop)))


def _listed(numbers: dict[str, int] | dict[str, str]) -> str:
    return ", ".join(f"{label} {number}" for label, number in numbers.items())


def _three(numbers: Array, decimals: int = 1) -> str:
    return "/".join(f"{number:.{decimals}f}" for number in numbers)
