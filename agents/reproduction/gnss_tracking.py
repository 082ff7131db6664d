"""E4: GNSS tracking, clock fault and loss of lock (SPEC 4.3, 7.1; claim C10)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pymap3d
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.filters.bound import cramer_rao_bound
from kfenv.models.gnss.pseudorange import BIAS, CHANNELS, as_printed
from kfenv.models.model import Sensor
from kfenv.scenarios.gnss.tracking import GnssTracking

from ..plotting import shade
from . import figures, gnss_figures
from .claims import Claim, judge, mean_and_interval, too_few, with_interval
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

Array = NDArray[np.float64]
Outcomes = dict[str, Outcome]

KAPPA = 0.0  # of the sigma points
FAULT, LOSS = (70.0, 100.0), (150.0, 165.0)  # s, of the preset "paper"
RECOVERY = 10.0  # s after either until its errors are forgotten
SETTLED = 25.0  # s
BROKEN = 1e6  # times the condition number of a sound covariance: this one has come apart
ROUNDING = 1e-3  # m: of states of 6e6 m, over 2500 steps
UNLIMITED = 1e14  # a condition number that is drawn no further

METHODS = (
    Method("EKF as printed", "ekf-unsymmetrised"),
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical", KAPPA),
    Method("UKF-J", "ukf-joseph", KAPPA),
    Method("SRUKF-J", "srukf-joseph", KAPPA),
    Method("SRUKF-J exact", "srukf-joseph-exact", KAPPA),
)
PRINTED, SOUND = METHODS[0], METHODS[1:]
SHOWN = ("EKF-J", "UKF", "UKF-J", "SRUKF-J")
JACOBIAN = (Method("SRUKF-J, H as printed", "srukf-joseph", KAPPA),)
POSITION, ACCELERATION = slice(0, 9, 3), slice(2, 9, 3)


@dataclass(frozen=True)
class PrintedJacobian(GnssTracking):
    """The same episodes for a filter with the Jacobian of Appendix B.

    Attributes:
        jacobian_step: by how much earlier the state is with respect to which it is taken, s.
    """

    jacobian_step: float = 0.1

    @cached_property
    def sensor(self) -> Sensor:
        """Twelve pseudoranges and their rates, with other slopes."""
        return as_printed(self.jacobian_step)


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E4."""
    study, raw = laboratory.study("published", published(), METHODS)
    outcomes = {label: local(study, outcome) for label, outcome in raw.items()}
    printed = {}
    for name, step in {"filter step": 1.0 / study.scenario.rate, "GNSS interval": 1.0}.items():
        key = f"Jacobian as printed, {name}"
        scenario = PrintedJacobian(faults="paper", jacobian_step=step)
        other, found = laboratory.study(key, scenario, JACOBIAN)
        printed[step] = local(other, found[JACOBIAN[0].label])
    least = _bound(study)
    _draw(laboratory, study, outcomes, printed, least)
    return [
        _clock_fault(study, outcomes),
        _one_estimator(outcomes),
        _loss_of_lock(study, outcomes, least),
        _noisier(study, outcomes),
        _acceleration(study, outcomes),
        _appendix(study, outcomes["SRUKF-J"], printed),
    ]


def published() -> GnssTracking:
    """The published scenario: six satellites above the mask all the time."""
    return GnssTracking(faults="paper")


def rotation(scenario: GnssTracking) -> Array:
    """From the earth-fixed frame to east, north, up at the flights' origin (3, 3)."""
    return scenario.local_frame(np.array(pymap3d.geodetic2ecef(*scenario.place)))[1]


def local(study: Study, outcome: Outcome) -> Outcome:
    """The outcome with its errors in east, north and up."""
    return outcome._replace(error=turned(outcome.error, rotation(study.scenario)))


def turned(states: Array, axes: Array) -> Array:
    """States (..., 11), or differences of them, with the nine of the motion in other axes."""
    motion = states[..., :9].reshape(*states.shape[:-1], 3, 3)
    moved = np.einsum("ij,...jd->...id", axes, motion)
    return np.concatenate([moved.reshape(*states.shape[:-1], 9), states[..., 9:]], axis=-1)


def inside(study: Study) -> NDArray[np.bool_]:
    """Which kept instants lie in the clock fault."""
    return (study.time >= FAULT[0]) & (study.time < FAULT[1])


def outside(study: Study) -> NDArray[np.bool_]:
    """Which kept instants are settled and untouched by either fault."""
    spoilt = [(study.time >= s) & (study.time < e + RECOVERY) for s, e in (FAULT, LOSS)]
    return (study.time > SETTLED) & ~spoilt[0] & ~spoilt[1]


def rms(outcome: Outcome, columns: slice | int, when: NDArray[np.bool_]) -> Array:
    """RMS over runs kept and instants, of each of the columns."""
    return np.sqrt(np.mean(outcome.error[~outcome.lost][:, when, columns] ** 2, axis=(0, 1)))


def _run_rms(outcome: Outcome, columns: slice, when: NDArray[np.bool_]) -> Array:
    """(N,) RMS of each run, of the length of the columns' vector; NaN where lost."""
    squares = np.sum(outcome.error[:, when, columns] ** 2, axis=2)
    return np.where(outcome.lost, np.nan, np.sqrt(np.mean(squares, axis=1)))


# ----- claims -----------------------------------------------------------------------------


def _clock_fault(study: Study, outcomes: Outcomes) -> Claim:
    lost = {label: _lost(outcome, 0.0, LOSS[0]) for label, outcome in outcomes.items()}
    early = _lost(outcomes[PRINTED.label], 0.0, FAULT[0])
    told = "; ".join(
        f"{label} {_three(rms(outcomes[label], POSITION, inside(study)))} "
        f"({_three(rms(outcomes[label], POSITION, outside(study)))})"
        for label in (m.label for m in SOUND)
    )
    only_rivals = lost["EKF-J"] > 0 and lost["UKF-J"] > 0 and lost["SRUKF-J"] == 0
    return Claim(
        "C10 (E4)",
        "the clock fault makes EKF and UKF diverge even with Joseph, the SRUKF not",
        "S0 sec. 5.2",
        f"of {study.runs} runs lost until the loss of lock: {_listed(lost)} (EKF as printed "
        f"{_breaking(study, outcomes)}, {early} lost before the fault). RMSE east/north/up "
        f"in the fault (outside), m: {told}",
        judge(only_rivals),
    )


def _breaking(study: Study, outcomes: Outcomes) -> str:
    """When the covariance of the EKF as printed comes apart."""
    sound = np.nanmedian(outcomes["EKF-J"].condition, axis=0)
    apart = ~(outcomes[PRINTED.label].condition <= BROKEN * sound)
    onset = study.time[np.argmax(apart, axis=1)][apart.any(axis=1)]
    if not len(onset):
        return "keeps its conditioning"
    return (
        f"has κ(P) {BROKEN:.0e} times too large in {len(onset)} runs, from {onset.min():.0f}, "
        f"median {np.median(onset):.0f} s"
    )


def _one_estimator(outcomes: Outcomes) -> Claim:
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


def _loss_of_lock(study: Study, outcomes: Outcomes, least: Array) -> Claim:
    sound = {m.label: outcomes[m.label] for m in SOUND}
    lost = {label: _lost(outcome, LOSS[0], np.inf) for label, outcome in sound.items()}
    end = np.argmax(study.time >= LOSS[1]) - 1
    last = study.time == study.time[end]
    peaks = {k: np.linalg.norm(rms(outcome, POSITION, last)) for k, outcome in sound.items()}
    told = ", ".join(f"{label} {peak:.1f}" for label, peak in peaks.items())
    expected = np.linalg.norm(least[end])
    calmer = ", than which this one manoeuvres less" if max(peaks.values()) < expected else ""
    return Claim(
        "C10 PLL (E4)",
        f"{LOSS[1] - LOSS[0]:g} s without any satellite are survived",
        "S0 sec. 5.2",
        f"of {study.runs} runs lost from {LOSS[0]:g} s on: {_listed(lost)}; RMS position error "
        f"at {study.time[end]:g} s, m: {told}. The bound's is {expected:.0f} m, but for flights "
        f"drawn from the motion model{calmer}",
        judge(not any(lost.values())),
    )


def _noisier(study: Study, outcomes: Outcomes) -> Claim:
    up = slice(6, 7)
    told, holds = [], True
    for label in ("EKF-J", "UKF-J", "SRUKF-J"):
        calm, fault = (_run_rms(outcomes[label], up, w(study)) for w in (outside, inside))
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
        f"mean RMSE of a run: {'; '.join(told)}. The estimated clock bias follows the jitter: its "
        f"RMSE is {' → '.join(f'{number:.1f}' for number in clock)} m",
        judge(holds),
    )


def _acceleration(study: Study, outcomes: Outcomes) -> Claim:
    """Of the runs that were not lost, whose number C10 and C10 PLL tell."""
    told, holds = [], True
    for label in ("EKF-J", "UKF-J", "SRUKF-J"):
        calm, fault = (_run_rms(outcomes[label], ACCELERATION, w(study)) for w in (outside, inside))
        told.append(
            f"{label} {np.nanmean(calm):.2f} → {np.nanmean(fault):.2f} m/s²"
            f"{too_few(fault - calm, 0.0)}"
        )
        holds &= mean_and_interval(fault - calm)[1] > 0.0
    axes = (
        _three(rms(outcomes["SRUKF-J"], ACCELERATION, when(study)), 2) for when in (outside, inside)
    )
    return Claim(
        "C10c (E4)",
        "the acceleration's error rises during the clock fault",
        "S0 sec. 5.2",
        f"mean RMSE of a run: {'; '.join(told)}. SRUKF-J east/north/up {' → '.join(axes)}",
        judge(holds),
    )


def _appendix(study: Study, right: Outcome, printed: dict[float, Outcome]) -> Claim:
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
        f"RMSE east/north/up outside → in the clock fault of SRUKF-J with it, {'; '.join(told)}; "
        f"with the Jacobian at the measurement's time {' → '.join(axes)} m",
        judge(worst < 1.1 * rms(right, POSITION, inside(study))[2]),
    )


def _lost(outcome: Outcome, start: float, stop: float) -> int:
    """How many tracks were lost in an interval."""
    return int(np.sum((outcome.lost_at >= start) & (outcome.lost_at < stop)))


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{label} {count}" for label, count in counts.items())


def _three(numbers: Array, decimals: int = 1) -> str:
    return "/".join(f"{number:.{decimals}f}" for number in numbers)


# ----- figures ----------------------------------------------------------------------------


def _draw(
    laboratory: Laboratory, study: Study, outcomes: Outcomes, printed: dict[float, Outcome],
    least: Array,
) -> None:  # fmt: skip
    recording = study.sample(0, 1)
    faults = recording.faults[0]
    shown = {label: outcomes[label] for label in SHOWN}

    def save(figure: Figure, name: str) -> None:
        for axes in figure.axes:
            shade(axes, faults, labelled=False)
        laboratory.save(figure, name)

    save(figures.rmse(study.time, shown, least), "rmse")
    for first, second in (("UKF", "UKF-J"), ("EKF-J", "SRUKF-J")):
        title = f"RMSE of {first} less RMSE of {second}: positive where {second} is better"
        drawn = figures.rmse_difference(study.time, outcomes[first], outcomes[second], title)
        save(drawn, f"rmse_difference_{first.lower()}")
    wrong = {f"H as printed, dt = {step:g} s": outcome for step, outcome in printed.items()}
    save(figures.rmse(study.time, {"SRUKF-J": outcomes["SRUKF-J"]} | wrong), "rmse_appendix")
    conditioned = {PRINTED.label: outcomes[PRINTED.label]} | shown
    drawn = figures.condition(study.time, conditioned)
    drawn.axes[0].set_ylim(1.0, UNLIMITED)  # of both: what comes apart grows to 1e60
    save(drawn, "condition")
    satellites = np.sum(np.isfinite(recording.measurement[0, study.kept, :CHANNELS]), axis=1)
    laboratory.save(gnss_figures.receiver(study.time, satellites, shown, faults), "receiver")

    axes, origin = rotation(study.scenario), np.zeros(11)
    origin[POSITION] = pymap3d.geodetic2ecef(*study.scenario.place)
    truth = turned(recording.truth[0] - origin, axes)
    paths = {
        method.label: turned(filter_recording(study.scenario, method, recording).mean[0] - origin,
                             axes)
        for method in METHODS if method.label in ("EKF-J", "UKF-J", "SRUKF-J")
    }  # fmt: skip
    places = {label: path[:, POSITION] for label, path in paths.items()}
    laboratory.save(figures.track(recording.time, truth[:, POSITION], None, places), "track")
    bends = {label: path[:, ACCELERATION] for label, path in paths.items()}
    save(figures.accelerations(recording.time, truth[:, ACCELERATION], bends), "accelerations")


def _bound(study: Study) -> Array:
    """Posterior Cramer-Rao bound (K, 3) of east, north and up.

    Of a receiver without the clock fault, which no channel's noise knows of, and for
    flights drawn from the motion model: on this one a filter may lie below it.
    """
    recording = study.sample(0, 1)  # the same geometry in every run
    heard = np.where(np.isnan(recording.measurement), np.nan, recording.true_noise)
    covariance = cramer_rao_bound(
        study.scenario.motion, study.scenario.sensor, recording.truth, recording.time, heard,
        recording.factor[0] @ recording.factor[0].T, recording.motion_inputs,
        recording.sensor_inputs,
    )[study.kept, POSITION, POSITION]  # fmt: skip
    axes = rotation(study.scenario)
    return np.sqrt(np.diagonal(axes @ covariance @ axes.T, axis1=1, axis2=2))
