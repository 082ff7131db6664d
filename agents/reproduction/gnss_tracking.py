"""E4: GNSS tracking, clock fault and loss of lock (SPEC 4.3, 7.1; claim C10).

S0 gives the receiver, its rates and its place. The flight, the faults' times and sizes and
the densities of the noise are ours, and so is the constellation unless an almanac is given.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import pymap3d
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kfenv.filters.bound import cramer_rao_bound
from kfenv.models.gnss.pseudorange import CHANNELS, as_printed
from kfenv.models.model import Sensor
from kfenv.scenarios.gnss.tracking import GnssTracking

from ..plotting import shade
from . import figures, gnss_claims, gnss_figures
from .claims import Claim
from .gnss_errors import ACCELERATION, POSITION, local, rotation, turned
from .gnss_pseudoranges import gnss_only, pseudorange_errors
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

Array = NDArray[np.float64]
Outcomes = dict[str, Outcome]

KAPPA = 0.0  # of the sigma points
UNLIMITED = 1e14  # a condition number that is drawn no further

METHODS = (
    Method("EKF as printed", "ekf-unsymmetrised"),
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical", KAPPA),
    Method("UKF-J", "ukf-joseph", KAPPA),
    Method("SRUKF-J", "srukf-joseph", KAPPA),
    Method("SRUKF-J exact", "srukf-joseph-exact", KAPPA),
)
PRINTED = METHODS[0].label
SHOWN = ("EKF-J", "UKF", "UKF-J", "SRUKF-J")
JACOBIAN = (Method("SRUKF-J, H as printed", "srukf-joseph", KAPPA),)


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
    scenario = papers_case(laboratory.almanac)
    study, raw = laboratory.study("our flight", scenario, METHODS)
    outcomes = {label: local(study, outcome) for label, outcome in raw.items()}
    alone = local(study, gnss_only(study))
    printed = _printed_jacobian(laboratory, scenario)
    least = _bound(study)
    recording = study.sample(0, 1)
    satellites = np.sum(np.isfinite(recording.measurement[0, study.kept, :CHANNELS]), axis=1)
    _draw(laboratory, study, outcomes, alone, printed, least, satellites)
    return [
        gnss_claims.clock_fault(study, outcomes, PRINTED, alone, satellites),
        gnss_claims.one_estimator(outcomes),
        gnss_claims.loss_of_lock(study, outcomes, PRINTED, least),
        gnss_claims.noisier(study, outcomes),
        gnss_claims.acceleration(study, outcomes),
        gnss_claims.appendix(study, outcomes["SRUKF-J"], printed),
    ]


def papers_case(almanac: str | None = None) -> GnssTracking:
    """S0's case; the baseline constellation shows it six satellites all the time.

    Args:
        almanac: path of a YUMA file with the satellites instead.

    Raises:
        OSError, ValueError: if there is no almanac in it.
    """
    return GnssTracking(faults="paper", almanac=almanac)


def _printed_jacobian(laboratory: Laboratory, scenario: GnssTracking) -> dict[float, Outcome]:
    """SRUKF-J with Appendix B's Jacobian, by the step that is taken for its dt."""
    found = {}
    for name, step in {"filter step": 1.0 / scenario.rate, "GNSS interval": 1.0}.items():
        same = {item.name: getattr(scenario, item.name) for item in fields(scenario)}
        other = PrintedJacobian(**same, jacobian_step=step)
        study, outcomes = laboratory.study(f"Jacobian as printed, {name}", other, JACOBIAN)
        found[step] = local(study, outcomes[JACOBIAN[0].label])
    return found


def _draw(
    laboratory: Laboratory, study: Study, outcomes: Outcomes, alone: Outcome,
    printed: dict[float, Outcome], least: Array, satellites: NDArray[np.int64],
) -> None:  # fmt: skip
    faults = study.sample(0, 1).faults[0]
    shown = {label: outcomes[label] for label in SHOWN}

    def save(figure: Figure, name: str) -> None:
        for axes in figure.axes:
            shade(axes, faults, labelled=False)
        laboratory.save(figure, name)

    save(figures.rmse(study.time, shown, least), "rmse")
    fixes = {"GNSS alone, epoch by epoch": alone} | {k: outcomes[k] for k in ("EKF-J", "SRUKF-J")}
    save(figures.rmse(study.time, fixes), "rmse_gnss_only")
    for first, second in (("UKF", "UKF-J"), ("EKF-J", "SRUKF-J")):
        title = f"RMSE of {first} less RMSE of {second}: positive where {second} is better"
        drawn = figures.rmse_difference(study.time, outcomes[first], outcomes[second], title)
        save(drawn, f"rmse_difference_{first.lower()}")
    wrong = {f"H as printed, dt = {step:g} s": outcome for step, outcome in printed.items()}
    save(figures.rmse(study.time, {"SRUKF-J": outcomes["SRUKF-J"]} | wrong), "rmse_appendix")
    drawn = figures.condition(study.time, {PRINTED: outcomes[PRINTED]} | shown)
    drawn.axes[0].set_ylim(1.0, UNLIMITED)  # of both: what comes apart grows to 1e60
    drawn.axes[0].legend(frameon=False, fontsize=8, loc="center right")
    save(drawn, "condition")
    laboratory.save(gnss_figures.receiver(study.time, satellites, shown, faults), "receiver")
    errors = pseudorange_errors(study.scenario, study.seed)
    laboratory.save(gnss_figures.pseudorange_errors(errors, faults), "pseudorange_errors")
    track, accelerations = _one_run(study)
    laboratory.save(track, "track")
    save(accelerations, "accelerations")


def _one_run(study: Study) -> tuple[Figure, Figure]:
    """Figures of the first run: where it went, and how it was accelerated."""
    recording, axes, origin = study.sample(0, 1), rotation(study.scenario), np.zeros(11)
    origin[POSITION] = pymap3d.geodetic2ecef(*study.scenario.place)
    truth = turned(recording.truth[0] - origin, axes)
    estimates = {
        method.label: filter_recording(study.scenario, method, recording).mean[0]
        for method in METHODS
        if method.label in gnss_claims.JOSEPH
    }
    paths = {label: turned(mean - origin, axes) for label, mean in estimates.items()}
    places = {label: path[:, POSITION] for label, path in paths.items()}
    bends = {label: path[:, ACCELERATION] for label, path in paths.items()}
    return (
        figures.track(recording.time, truth[:, POSITION], None, places),
        figures.accelerations(recording.time, truth[:, ACCELERATION], bends),
    )


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
