"""E5: positions from GPS reflections, linear Kalman filter (SPEC 7.1; claim C13)."""

from __future__ import annotations

import numpy as np

from kfenv.scenarios.radar.bistatic import BistaticTracking

from . import figures
from .bounds import bound, over_bound
from .claims import Claim, judge
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

METHODS = (
    Method("LKF", "lkf"),
    Method("EKF-J", "ekf-joseph"),
    Method("SRUKF-J exact", "srukf-joseph-exact"),
)
SETTLED = 5.0  # s: until then the exactly known start makes the errors smaller


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E5."""
    study, outcomes = laboratory.study(
        "published", BistaticTracking(faults="paper"), METHODS, spacing=0.5
    )
    least = bound(study)
    drawn = figures.rmse(study.time, outcomes, least[:, 0:9:3], figures.PLAIN)
    laboratory.save(drawn, "rmse")
    recording = study.sample(0, 1)
    path = filter_recording(study.scenario, METHODS[0], recording).mean[0]
    truth, time = recording.truth[0], recording.time
    measured, places, bends = recording.measurement[0], path[:, ::3], path[:, 2::3]
    drawn = figures.track(time, truth[:, ::3], measured, {"LKF": places}, figures.PLAIN)
    laboratory.save(drawn, "track")
    drawn = figures.accelerations(time, truth[:, 2::3], {"LKF": bends}, figures.PLAIN)
    laboratory.save(drawn, "accelerations")
    return [_converges(study, outcomes), _efficient(study, outcomes["LKF"], least)]


def _converges(study: Study, outcomes: dict[str, Outcome]) -> Claim:
    linear = outcomes["LKF"]
    late = study.time > SETTLED
    rms = np.sqrt(np.mean(linear.error[:, late] ** 2, axis=(0, 1)))
    noise = study.sample(0, 1).true_noise[0, 0]
    apart = max(float(np.max(np.abs(o.error - linear.error))) for o in outcomes.values())
    nees = linear.nees[:, late].mean()
    position, velocity = rms[0::3], rms[1::3]
    return Claim(
        "C13 (E5)",
        "the linear Kalman filter converges",
        "S3 sec. 5",
        f"after {SETTLED:g} s RMSE x/y/z {_three(position)} m where {_three(noise)} m are "
        f"measured; velocity {_three(velocity)} m/s; position NEES {nees:.2f} of 3; "
        f"{study.runs} runs, {linear.lost.sum()} lost. The square-root filter's states differ by "
        f"{apart:.0e} at most",
        judge(bool(np.all(position < noise)) and not linear.lost.any()),
    )


def _efficient(study: Study, outcome: Outcome, least: np.ndarray) -> Claim:
    ratio, upper = over_bound(study, outcome, least, SETTLED)
    return Claim(
        "bound (E5)",
        "no filter is below the posterior Cramér-Rao bound",
        "SPEC 10",
        f"RMSE over the bound x/y/z {_three(ratio)} (95 % interval up to {_three(upper)}): the "
        "linear filter attains it",
        judge(bool(np.all(upper > 1.0))),
    )


def _three(numbers: np.ndarray) -> str:
    return "/".join(f"{number:.2f}" for number in numbers)
