"""Accuracy in E1 and E2: EKF, UKF and Joseph, and the bound (SPEC 7.1; claims C3 and C4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.scenarios.radar.validation import RadarValidation
from kfenv.scenarios.trajectories import accelerated_flights, paper_trajectory

from . import figures
from .bounds import bound, over_bound
from .claims import Claim, judge, too_few, with_interval
from .comparisons import (
    MATTERS,
    ROUNDING,
    SETTLED,
    largest_difference,
    matters,
    run_rmse,
    unsure,
)
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study

Array = NDArray[np.float64]

DRAWN = (
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical"),
    Method("UKF-J", "ukf-joseph"),
    Method("SRUKF-J exact", "srukf-joseph-exact"),
)
DRAWN_RUNS = 200
DRAWN_DURATION, DRAWN_SETTLED = 30.0, 10.0  # s: some longer ones would pass close to the radar,
# whose information would lower the bound for all


@dataclass(frozen=True)
class DrawnFlights(RadarValidation):
    """Flights drawn from the filter's own motion model, from where trajectory A starts."""

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, 9)."""
        start = paper_trajectory("A", self.time[:2])[0]
        return accelerated_flights(rngs, self.motion, start, self.time)


def accuracy(study: Study, outcomes: dict[str, Outcome], name: str) -> list[Claim]:
    """Whether the UKF beats the EKF, and Joseph the classical form."""
    late = study.time > SETTLED
    rmse = {label: run_rmse(outcome, late) for label, outcome in outcomes.items()}
    typical = float(np.nanmean(rmse["UKF-J"]))
    over_ekf = rmse["EKF-J"] - rmse["UKF-J"]
    over_classical = rmse["UKF"] - rmse["UKF-J"]
    share = abs(np.nanmean(over_classical)) / typical
    apart = largest_difference(outcomes["UKF-J"], outcomes["SRUKF-J"])
    axes = "; ".join(
        f"{label} {_three(_axis_rmse(outcomes[label], late))}"
        for label in ("EKF-J", "UKF", "UKF-J", "SRUKF-J", "SRUKF-J exact")
    )
    return [
        Claim(
            f"C3 ({name})",
            "the UKF is more accurate than the EKF",
            "S0, S1 sec. 4",
            f"RMSE of EKF-J less UKF-J on the same noise: {with_interval(over_ekf)} of "
            f"{typical:.0f}; less than {MATTERS:.0%} counts as none{unsure(over_ekf, typical)}. "
            f"RMSE x/y/z after {SETTLED:g} s, m: {axes}",
            judge(matters(over_ekf, typical)),
        ),
        Claim(
            f"C4 ({name})",
            "the Joseph sigma-point filter is more accurate than the classical one",
            "S1 Fig. 5",
            f"RMSE of UKF less UKF-J: {with_interval(over_classical)} of {typical:.0f}; less than "
            f"{MATTERS:.0%} counts as none{unsure(over_classical, typical)}",
            judge(matters(over_classical, typical)),
        ),
        Claim(
            f"C4b ({name})",
            "estimates are in line with the classical formulation",
            "S1 conclusion",
            f"the RMSE of UKF less UKF-J is {share:.3%} of it"
            f"{too_few(over_classical, MATTERS * typical)}",
            judge(share < MATTERS),
        ),
        Claim(
            f"C4d ({name})",
            "the square-root Joseph filter is more accurate than UKF-Joseph",
            "S0 Fig. 5",
            f"the states of UKF-J and SRUKF-J differ by {apart:.1e} at most"
            + (": one estimator in two forms" if apart < ROUNDING else ""),
            judge(matters(rmse["UKF-J"] - rmse["SRUKF-J"], typical)),
        ),
    ]


def _axis_rmse(outcome: Outcome, when: NDArray[np.bool_]) -> Array:
    """(3,) at some instants of the runs that kept the track."""
    errors = outcome.position_error[~outcome.lost][:, when]
    return np.sqrt(np.mean(errors**2, axis=(0, 1)))


def _three(numbers: Array) -> str:
    return "/".join(f"{number:.1f}" for number in numbers)


def near_the_bound(
    laboratory: Laboratory, study: Study, outcomes: dict[str, Outcome], least: Array, name: str
) -> Claim:
    """How near the filters come to the bound, on flights for which it is one."""
    drawn, found = laboratory.study(
        "drawn flights", DrawnFlights(DRAWN_DURATION, study.scenario.rate), DRAWN, DRAWN_RUNS
    )
    limit = bound(drawn)
    laboratory.save(figures.rmse(drawn.time, found, limit[:, 0:9:3]), "rmse_drawn_flights")
    near = {
        label: over_bound(drawn, outcome, limit, DRAWN_SETTLED) for label, outcome in found.items()
    }
    told = "; ".join(f"{label} {_ratios(ratio)}" for label, (ratio, _) in near.items())
    on_a = over_bound(study, outcomes["SRUKF-J exact"], least, SETTLED)[0]
    jerks = _ratios(_jerk_density(study))
    return Claim(
        f"bound ({name})",
        "no filter is below the posterior Cramér-Rao bound",
        "SPEC 10",
        f"RMSE over the bound x/y/z in {drawn.runs} flights drawn from the motion model, for which "
        f"alone it is one: {told}. On trajectory A {_ratios(on_a)}: the square of its "
        f"acceleration's change is {jerks} m²/s⁵ where the model expects 1",
        judge(all(np.all(upper > 1.0) for _, upper in near.values())),
    )


def _jerk_density(study: Study) -> Array:
    """(3,) mean square change of the true acceleration per second, m^2/s^5."""
    time, truth = study.scenario.time, study.sample(0, 1).truth[0]
    return np.mean(np.diff(truth[:, 2::3], axis=0) ** 2, axis=0) / (time[1] - time[0])


def _ratios(numbers: Array) -> str:
    return "/".join(f"{number:.3f}" for number in numbers)
