"""Conditioning in E1 and E2: what comes apart, and when (SPEC 7.1; claims C1, C2, C5, C9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .claims import Claim, judge
from .comparisons import BROKEN, ROUNDING, SETTLED, largest_difference
from .monte_carlo import Outcome, Study

Array = NDArray[np.float64]

PRINTED = "EKF as printed"
VAGUE_LIMIT, VAGUE_AFTER = 1000.0, 150.0  # m rms, s: what counts as lost there (SPEC 7.1)


def onsets(study: Study, outcome: Outcome) -> Array:
    """(N,) s, when the condition number first exceeds `BROKEN`; infinite if never."""
    broken = ~(outcome.condition <= BROKEN)
    return np.where(broken.any(axis=1), study.time[np.argmax(broken, axis=1)], np.inf)


def when_broken(onset: Array) -> str:
    """How many broke, and when."""
    broken = onset[np.isfinite(onset)]
    if not len(broken):
        return f"0 of {len(onset)} runs"
    return (
        f"{len(broken)} of {len(onset)} runs, from {broken.min():.0f}, "
        f"median {np.median(broken):.0f} s"
    )


def divergence(
    study: Study, outcomes: dict[str, Outcome], sensitivity: str, name: str
) -> list[Claim]:
    """Whether the classical EKF comes apart, and Joseph does not.

    Args:
        sensitivity: when it does under other settings.
    """
    onset = {label: onsets(study, outcome) for label, outcome in outcomes.items()}
    count = {label: int(np.isfinite(times).sum()) for label, times in onset.items()}
    largest = np.nanmax(outcomes["EKF-J"].condition[:, study.time > SETTLED])
    apart = largest_difference(outcomes["EKF symmetrised"], outcomes["EKF-J"])
    cured = count["EKF symmetrised"] == 0 and count["EKF (I-KH)P"] == 0
    grew = cured and count[PRINTED] > 0
    return [
        Claim(
            f"C1 ({name})",
            "the classical EKF's covariance loses its conditioning",
            "S0, S1 Fig. 6",
            f"κ(P) > 1e6 in {when_broken(onset[PRINTED])}; {outcomes[PRINTED].lost.sum()} "
            f"lost; with P = (P + Pᵀ)/2 in {count['EKF symmetrised']}, with (I-KH)P in "
            f"{count['EKF (I-KH)P']}. EKF-J's κ(P) never exceeds {largest:.1e}"
            + (": what grows is the antisymmetric rounding of P - K S Kᵀ" if grew else "")
            + f". Elsewhere: {sensitivity}",
            judge(count[PRINTED] > 0, reason_holds=not cured),
        ),
        Claim(
            f"C2 ({name})",
            "the Joseph form cures the EKF",
            "S0, S1 sec. 4",
            f"κ(P) > 1e6 in {count['EKF-J']} runs; the states of the EKF symmetrised in one line "
            f"are at most {apart:.1e} apart from its",
            judge(count["EKF-J"] == 0 and not outcomes["EKF-J"].lost.any()),
        ),
    ]


def conditioning(study: Study, outcomes: dict[str, Outcome], name: str) -> Claim:
    """How κ(S) of the square-root filters compares with κ(P)."""
    late = study.time > SETTLED
    full = outcomes["UKF"].condition[:, late]
    joseph = outcomes["UKF-J"].condition[:, late]
    root = outcomes["SRUKF-J"].root_condition[:, late]
    classical = np.nanmedian(outcomes["SRUKF"].root_condition[:, late])
    # of UKF-J: the same estimator, in another arithmetic that never sees S
    mismatch = float(np.nanmax(np.abs(root**2 / joseph - 1.0)))
    same = mismatch < ROUNDING
    ratio = np.nanmedian(full) / np.nanmedian(root)
    return Claim(
        f"C5 ({name})",
        "the square-root filter is two orders of magnitude better conditioned",
        "S0 Fig. 9",
        f"median κ(S) of SRUKF-J {np.nanmedian(root):.0f}, {ratio:.0f} times less than the UKF's "
        f"κ(P); κ(S)² is UKF-J's κ(P) to {mismatch:.0e} at worst"
        + (": the same information in half the digits" if same else "")
        + f". Median κ(P) of the UKF {np.nanmedian(full):.2g} (at most {np.nanmax(full):.2g}), "
        f"UKF-J {np.nanmedian(joseph):.2g}; κ(S) of SRUKF {classical:.0f}",
        judge(ratio > 30.0, reason_holds=not same),
    )


def never_fails(vague: dict[str, tuple[Study, dict[str, Outcome]]], name: str) -> Claim:
    """Tracks lost from vague priors, studies and outcomes by the prior's spread."""
    told, brief, printed_lost, spared = [], [], 0, 0
    for spread, (study, outcomes) in vague.items():
        lost = {label: int(_astray(study, o).sum()) for label, o in outcomes.items()}
        printed_lost += lost["SRUKF-J"]
        spared += lost["SRUKF-J, H at prior"]
        listed = ", ".join(f"{label} {count}" for label, count in lost.items())
        told.append(f"prior {spread}: {listed}")
        brief.append(f"{lost['SRUKF-J']} of {study.runs} with a prior of {spread}")
    blamed = printed_lost > 0 and spared == 0
    steps = [int(np.max(o["UKF-J, H at prior"].indefinite)) for _, o in vague.values()]
    return Claim(
        f"C9 ({name})",
        "SRUKF-Joseph never fails",
        "S0, S1 conclusions",
        f"SRUKF-J loses {', '.join(brief)}"
        + (", all by the Jacobian at the posterior" if blamed else "")
        + f". Lost, {'; '.join(told)}. UKF-J with H at the prior has an indefinite P in up to "
        f"{max(steps)} steps of a run",
        judge(printed_lost == 0),
    )


def _astray(study: Study, outcome: Outcome) -> NDArray[np.bool_]:
    """Whether the position's RMS error exceeds 1 km late in the run, or the filter failed."""
    late = outcome.position_error[:, study.time > VAGUE_AFTER]
    rms = np.sqrt(np.mean(np.sum(late**2, axis=2), axis=1))
    return ~(rms <= VAGUE_LIMIT)
