"""E1 and E2: constant acceleration, radar of constant noise (SPEC 7.1; claims C1 to C6, C9)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.radar.validation import RadarValidation

from . import figures, timing
from .bounds import bound
from .claims import Claim, judge
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording
from .radar_accuracy import accuracy, near_the_bound
from .radar_conditioning import conditioning, divergence, never_fails, onsets, when_broken
from .radar_figures import positions

Array = NDArray[np.float64]

METHODS = (
    Method("EKF as printed", "ekf-unsymmetrised"),
    Method("EKF symmetrised", "ekf-classical"),
    Method("EKF (I-KH)P", "ekf-khp"),
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical"),
    Method("UKF as printed", "ukf-unsymmetrised"),
    Method("UKF-J", "ukf-joseph"),
    Method("SRUKF", "srukf-classical"),
    Method("SRUKF-J", "srukf-joseph"),
    Method("SRUKF-J exact", "srukf-joseph-exact"),
)
TIMED = tuple(m for m in METHODS if m.label not in ("EKF (I-KH)P", "UKF as printed"))
VAGUE = (
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical"),
    Method("UKF-J", "ukf-joseph"),
    Method("SRUKF", "srukf-classical"),
    Method("SRUKF-J", "srukf-joseph"),
    Method("UKF-J, H at prior", "ukf-joseph-prior"),
    Method("SRUKF-J, H at prior", "srukf-joseph-prior"),
    Method("SRUKF-J exact", "srukf-joseph-exact"),
)
VAGUE_PRIORS = {"10 km": (1e4, 1e3, 1e2), "100 km": (1e5, 1e3, 1e2)}
VAGUE_RUNS = 100
PRINTED = METHODS[0]
SENSITIVITY = {  # what moves the instant at which the printed EKF breaks
    "q = 0.1": (0.1, None),
    "q = 10": (10.0, None),
    "q = 100": (100.0, None),
    "prior 10 km": (1.0, VAGUE_PRIORS["10 km"]),
}
SENSITIVITY_RUNS = 25
CHEAP = 0.25  # share of the computing time that still counts as nothing
INTERVALS = (0.1, 0.2, 0.25, 0.5, 1.0)  # s, the range of S1 Fig. 8


def at_10_hz(laboratory: Laboratory) -> list[Claim]:
    """E1."""
    scenario = RadarValidation(rate=10.0)
    return [*_reproduce(laboratory, scenario, "E1"), _growth(laboratory, scenario)]


def at_2_hz(laboratory: Laboratory) -> list[Claim]:
    """E2."""
    return _reproduce(laboratory, RadarValidation(rate=2.0), "E2")


def _reproduce(laboratory: Laboratory, scenario: RadarValidation, name: str) -> list[Claim]:
    study, outcomes = laboratory.study("trajectory A", scenario, METHODS)
    least = bound(study)
    _draw(laboratory, study, outcomes, least)
    vague = {
        spread: laboratory.study(
            f"prior {spread}", scenario, VAGUE, VAGUE_RUNS, initial_deviation=deviation
        )
        for spread, deviation in VAGUE_PRIORS.items()
    }
    times = timing.time_filters(scenario, TIMED, laboratory.seed)
    laboratory.save(timing.figure(times), "time")
    return [
        *divergence(study, outcomes, _sensitivity(laboratory, scenario), name),
        *accuracy(study, outcomes, name),
        conditioning(study, outcomes, name),
        _cost(times, name),
        never_fails(vague, name),
        near_the_bound(laboratory, study, outcomes, least, name),
    ]


def _draw(laboratory: Laboratory, study: Study, outcomes: dict[str, Outcome], least: Array) -> None:
    shown = {label: outcomes[label] for label in ("EKF-J", "UKF", "UKF-J", "SRUKF-J")}
    laboratory.save(figures.rmse(study.time, shown, least[:, 0:9:3]), "rmse")
    for name, first, second in (
        ("ekf", "EKF symmetrised", "EKF-J"),
        ("ukf", "UKF", "UKF-J"),
        ("srukf", "SRUKF", "SRUKF-J"),
        ("joseph", "UKF-J", "SRUKF-J"),  # S0 Fig. 5
    ):
        drawn = figures.rmse_difference(
            study.time, outcomes[first], outcomes[second],
            f"RMSE of {first} less RMSE of {second}: positive where {second} is better",
        )  # fmt: skip
        laboratory.save(drawn, f"rmse_difference_{name}")
    conditioned = ("EKF as printed", "EKF-J", "UKF", "UKF-J", "SRUKF", "SRUKF-J")
    drawn = figures.condition(study.time, {label: outcomes[label] for label in conditioned})
    laboratory.save(drawn, "condition")
    recording = study.sample(0, 1)
    paths = {
        method.label: filter_recording(study.scenario, method, recording).mean[0]
        for method in METHODS
        if method.label in ("EKF-J", "UKF-J", "SRUKF-J")
    }
    places = {label: path[:, ::3] for label, path in paths.items()}
    measured = positions(recording.measurement[0])
    truth, time = recording.truth[0], recording.time
    laboratory.save(figures.track(time, truth[:, ::3], measured, places), "track")
    bends = {label: path[:, 2::3] for label, path in paths.items()}
    laboratory.save(figures.accelerations(time, truth[:, 2::3], bends), "accelerations")


def _sensitivity(laboratory: Laboratory, scenario: RadarValidation) -> str:
    """When the printed EKF breaks under other process noise and another prior."""
    told = []
    for setting, (scale, deviation) in SENSITIVITY.items():
        method = Method(PRINTED.label, PRINTED.design, process_scale=scale)
        study, outcomes = laboratory.study(
            f"EKF, {setting}", scenario, (method,), SENSITIVITY_RUNS, initial_deviation=deviation
        )
        told.append(f"{setting}: {when_broken(onsets(study, outcomes[PRINTED.label]))}")
    return "; ".join(told)


def _cost(times: timing.Timing, name: str) -> Claim:
    pairs = (("EKF symmetrised", "EKF-J"), ("UKF", "UKF-J"), ("SRUKF", "SRUKF-J"))
    ratios = {
        joseph: (
            times.alone[joseph] / times.alone[classical] - 1.0,
            times.together[joseph] / times.together[classical] - 1.0,
        )
        for classical, joseph in pairs
    }
    told = "; ".join(
        f"{label} {100.0 * one:+.0f} % alone, {100.0 * many:+.0f} % in a batch of {timing.MANY}"
        for label, (one, many) in ratios.items()
    )
    micro = {label: 1e6 * seconds for label, seconds in times.alone.items()}
    return Claim(
        f"C6 ({name})",
        "the Joseph form costs nothing",
        "S1 Fig. 8, S0 Fig. 10",
        f"to be judged on a quiet machine only; against the classical form: {told}. "
        f"Per step alone EKF-J {micro['EKF-J']:.0f}, UKF-J {micro['UKF-J']:.0f}, SRUKF-J "
        f"{micro['SRUKF-J']:.0f} µs, engine {micro[timing.ENGINE]:.1f} µs",
        judge(max(ratio for pair in ratios.values() for ratio in pair) < CHEAP),
    )


def _growth(laboratory: Laboratory, scenario: RadarValidation) -> Claim:
    """How the time of a trajectory grows with the rate: measured at each, not extrapolated."""
    noise, rng = scenario.deviation_at_boundary, np.random.default_rng(laboratory.seed)
    rates = 1.0 / np.array(INTERVALS)
    recordings = [
        replace(scenario, rate=float(rate), noise_deviation=noise).sample([rng]) for rate in rates
    ]
    times = timing.time_trajectories(scenario, TIMED, recordings)
    laboratory.save(timing.growth_figure(INTERVALS, times), "time_by_interval")
    logs = np.log([seconds for label, seconds in times.items() if label != timing.ENGINE])
    powers, power_misfit = _line(np.log(rates), logs)
    _, exponential_misfit = _line(rates, logs)
    return Claim(
        "C6b (E1)",
        f"computing time grows exponentially from {rates[-1]:g} to {rates[0]:g} Hz",
        "S1 Fig. 8",
        f"a trajectory of {scenario.duration:g} s takes the rate to the power of "
        f"{powers.min():.2f} to {powers.max():.2f}, by filter; that law misses the logarithm of "
        f"the time by {power_misfit:.2f} (RMS), an exponential one by {exponential_misfit:.2f}",
        judge(exponential_misfit < power_misfit),
    )


def _line(x: Array, rows: Array) -> tuple[Array, float]:
    """Slope of the straight line through each row of (F, K) over x (K,), and the RMS misfit."""
    slopes, offsets = np.polyfit(x, rows.T, 1)
    misfit = rows - (slopes[:, None] * x + offsets[:, None])
    return slopes, float(np.sqrt(np.mean(misfit**2)))
