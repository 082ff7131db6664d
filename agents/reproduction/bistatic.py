"""E5: positions from GPS reflections, linear Kalman filter (SPEC 7.1; claim C13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.results import History
from kfenv.scenarios.radar.bistatic import BistaticTracking

from . import bistatic_figures, figures
from .bounds import bound, squares_over_bound
from .claims import Claim, judge, mean_and_interval
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

Array = NDArray[np.float64]

METHODS = (
    Method("LKF", "lkf"),
    Method("EKF-J", "ekf-joseph"),
    Method("SRUKF-J exact", "srukf-joseph-exact"),
)
SETTLED = 5.0  # s: until then the exactly known start makes the errors smaller
ELLIPSES = (17, 29, 34, 42, 45, 49)  # steps of S3's figures 3 to 5, the first measurement's is 1
SIGMAS = 2.0  # of an ellipse
PLANE = [0, 3]  # x and y


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E5."""
    study, outcomes = laboratory.study(
        "linear", BistaticTracking(faults="paper"), METHODS, spacing=0.5
    )
    least = bound(study, np.zeros((9, 9)))  # the start is known
    drawn = figures.rmse(study.time, outcomes, least[:, 0:9:3], figures.PLAIN)
    laboratory.save(drawn, "rmse")
    history = filter_recording(study.scenario, METHODS[0], study.sample(0, 1))
    held = shares_held(history, outcomes["LKF"])
    _draw(laboratory, study, history, held)
    return [_converges(study, outcomes, held), _efficient(study, outcomes["LKF"], least)]


def shares_held(history: History, outcome: Outcome) -> dict[int, float]:
    """The share of the runs whose error in x and y lies in the filter's ellipse, by step.

    The covariance of a linear filter does not depend on what is measured: one run tells it.
    """
    held = {}
    for step in ELLIPSES:
        covariance = history.covariance[0, step - 1][np.ix_(PLANE, PLANE)]
        error = outcome.error[:, step - 1, PLANE]
        squared = np.sum(error.T * np.linalg.solve(covariance, error.T), axis=0)
        held[step] = float(np.mean(squared <= SIGMAS**2))
    return held


def _converges(study: Study, outcomes: dict[str, Outcome], held: dict[int, float]) -> Claim:
    linear = outcomes["LKF"]
    late = study.time > SETTLED
    rms = np.sqrt(np.mean(linear.error[:, late] ** 2, axis=(0, 1)))
    noise = study.sample(0, 1).true_noise[0, 0]
    apart = max(float(np.max(np.abs(o.error - linear.error))) for o in outcomes.values())
    nees = linear.nees[:, late].mean()
    position, velocity = rms[0::3], rms[1::3]
    shares = ", ".join(f"{share:.1%}" for share in held.values())
    return Claim(
        "C13 (E5)",
        "the linear Kalman filter converges",
        "S3 sec. 5",
        f"after {SETTLED:g} s RMSE x/y/z {_three(position)} m where {_three(noise)} m are "
        f"measured; velocity {_three(velocity)} m/s; position NEES {nees:.2f} of 3; "
        f"{study.runs} runs, {linear.lost.sum()} lost. Its {SIGMAS:g}-sigma ellipse in x and y "
        f"holds {shares} of the runs at steps {', '.join(map(str, held))}, where "
        f"{1.0 - np.exp(-(SIGMAS**2) / 2.0):.1%} are expected. The states of "
        f"{' and '.join(label for label in outcomes if label != 'LKF')} differ by {apart:.0e} at "
        "most",
        judge(bool(np.all(position < noise)) and not linear.lost.any()),
    )


def _efficient(study: Study, outcome: Outcome, least: Array) -> Claim:
    late = study.time > SETTLED
    early = _over(outcome, least, ~late & (study.time > 0.0))
    ratio, low, high = _over(outcome, least, late)
    above = [name for name, end in zip(figures.PLAIN, low, strict=True) if end > 1.0]
    reached = f"stays above it in {'/'.join(above)}" if above else "attains it"
    return Claim(
        "bound (E5)",
        "no filter is below the posterior Cramér-Rao bound",
        "SPEC 10",
        f"RMSE over the bound of a known start x/y/z after {SETTLED:g} s {_three(ratio)} (95 % "
        f"intervals {_three(low)} to {_three(high)}): the linear filter {reached}. Until then "
        f"{_three(early[0])}, since it is told a start that is uncertain",
        judge(bool(np.all(high > 1.0) and np.all(early[2] > 1.0))),
    )


def _over(outcome: Outcome, least: Array, when: NDArray[np.bool_]) -> Array:
    """RMS error over the bound's RMS, and the ends of its 95 % interval, of each axis (3, 3)."""
    ratios = squares_over_bound(outcome, least, when)
    return np.sqrt(np.array([mean_and_interval(axis) for axis in ratios.T]).T)


def _three(numbers: Array) -> str:
    return "/".join(f"{number:.2f}" for number in numbers)


def _draw(laboratory: Laboratory, study: Study, history: History, held: dict[int, float]) -> None:
    """Figures of the first run."""
    recording, path = study.sample(0, 1), history.mean[0]
    truth, time, measured = recording.truth[0], recording.time, recording.measurement[0]
    places = {"LKF": path[:, ::3]}
    laboratory.save(figures.track(time, truth[:, ::3], measured, places, figures.PLAIN), "track")
    drawn = bistatic_figures.velocities(time, truth[:, 1::3], path[:, 1::3], "LKF")
    laboratory.save(drawn, "velocities")
    drawn = figures.accelerations(time, truth[:, 2::3], {"LKF": path[:, 2::3]}, figures.PLAIN)
    laboratory.save(drawn, "accelerations")
    titles = {
        step - 1: f"step {step}, {time[step - 1]:g} s: holds {share:.0%} of {study.runs} runs"
        for step, share in held.items()
    }
    drawn = bistatic_figures.ellipses(
        truth[:, PLANE], measured[:, :2], path[:, PLANE],
        history.covariance[0][:, PLANE][:, :, PLANE], SIGMAS, titles,
    )  # fmt: skip
    laboratory.save(drawn, "ellipses")
