"""E3: variable turn, phased-array radar, jamming and signal loss (SPEC 7.1; claims C7, C8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from matplotlib.figure import Figure
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from kfenv.filters.reference import NOT_POSITIVE_DEFINITE
from kfenv.models.model import Motion
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.faults import SignalLoss
from kfenv.scenarios.radar.scenario import Rain, SelfScreeningJammer
from kfenv.scenarios.radar.tracking import PAPER_DURATION, RadarTracking
from kfenv.scenarios.trajectories import paper_trajectory

from ..plotting import shade
from . import figures, radar_figures, timing
from .bounds import bound
from .claims import Claim, judge, with_interval
from .comparisons import (
    ACCELERATION,
    BROKEN,
    ROUNDING,
    SETTLED,
    largest_difference,
    matters,
    run_rmse,
    unsure,
)
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study, filter_recording

Array = NDArray[np.float64]
Outcomes = dict[str, Outcome]

KAPPA = 0.0  # of the sigma points; the textbooks' 3 - n = -6 is the failing contrast
JAMMER = SelfScreeningJammer(start=70.0, duration=30.0)
JAM_END = JAMMER.start + JAMMER.duration
LOSS_START = 150.0  # s
LOSSES = (10.0, 20.0, 30.0)  # s; S0 tells neither when nor how long
CLOSE_UP = (65.0, 80.0)  # s, of the track's figure: the jam begins
HEAVY_RAIN = 50.0  # mm/h
# m/s, of the speed in the motion model (SPEC 3.2), whose clip of the turn rate remains
FLOOR, NO_FLOOR = 10.0, 1e-3

METHODS = (
    Method("EKF as printed", "ekf-unsymmetrised"),
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical", KAPPA),
    Method("UKF-J", "ukf-joseph", KAPPA),
    Method("SRUKF-J", "srukf-joseph", KAPPA),
    Method("SRUKF-J exact", "srukf-joseph-exact", KAPPA),
)
PRINTED, SOUND = METHODS[0].label, METHODS[1:]
FEW = tuple(m for m in METHODS if m.label in ("EKF-J", "UKF-J", "SRUKF-J exact"))
CONTRAST = (  # square roots have none of a negative weight
    Method("UKF, κ = -6", "ukf-classical", -6.0),
    Method("UKF-J, κ = -6", "ukf-joseph", -6.0),
)
VARIANT_RUNS = 10  # the paper's number
AFTER_GAP = 10.0  # s until the errors of a loss are forgotten
HALF = 0.6  # of the noise: more is not half of it any more


@dataclass(frozen=True)
class TrajectoryB(RadarTracking):
    """Trajectory B before the phased array, with any faults.

    Attributes:
        speed_floor: of the filter's motion model, m/s.
    """

    duration: float = PAPER_DURATION
    speed_floor: float = FLOOR

    @cached_property
    def motion(self) -> Motion:
        """Variable turn, white jerk of 1 m^2/s^5."""
        return variable_turn(1.0, self.speed_floor)

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, 9), always the same."""
        return np.tile(paper_trajectory("B", self.time), (len(rngs), 1, 1))


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E3."""
    study, outcomes = laboratory.study("trajectory B", jammed_and_lost(), METHODS + CONTRAST)
    _draw(laboratory, study, outcomes)
    gaps = {LOSSES[0]: outcomes}
    bare = {}
    for loss in LOSSES[1:]:
        key, scenario = f"loss {loss:g} s", jammed_and_lost(loss)
        gaps[loss] = laboratory.study(key, scenario, SOUND + CONTRAST)[1]
        without = replace(scenario, speed_floor=NO_FLOOR)
        bare[loss] = laboratory.study(f"{key}, no floor", without, FEW + CONTRAST)[1]
    rain = laboratory.study("rain", jammed_and_lost(rain=HEAVY_RAIN), FEW, VARIANT_RUNS)[1]
    unaware = laboratory.study("unaware", jammed_and_lost(known=False), FEW, VARIANT_RUNS)[1]
    times = timing.time_filters(jammed_and_lost(), METHODS, laboratory.seed)
    laboratory.save(timing.figure(times), "time")
    return [
        _jammed(study, outcomes),
        _signal_lost(study, gaps, bare),
        _never_fails(study, gaps),
        _acceleration(study, outcomes),
        *_half_the_noise(study, outcomes),
        _rained_on(study, outcomes, rain),
        _not_told(study, outcomes, unaware),
    ]


def jammed_and_lost(loss: float = LOSSES[0], rain: float = 0.0, known: bool = True) -> TrajectoryB:
    """S0's array, jammer and signal loss, at times and on a trajectory of ours.

    Args:
        loss: duration of the signal loss, s.
        rain: mm/h.
        known: whether the filter is told of the jammer.
    """
    # It rains in all of them, if only 0 mm/h, so that all draw the same noise.
    faults = (
        replace(JAMMER, known=known), SignalLoss((loss, loss), LOSS_START), Rain((rain, rain))
    )  # fmt: skip
    return TrajectoryB(faults=faults)


def _draw(laboratory: Laboratory, study: Study, outcomes: Outcomes) -> None:
    recording = study.sample(0, 1)
    faults, time, truth = recording.faults[0], recording.time, recording.truth[0]
    shown = {label: outcomes[label] for label in ("EKF-J", "UKF", "UKF-J", "SRUKF-J")}

    def save(figure: Figure, name: str) -> None:
        for axes in figure.axes:
            shade(axes, faults, labelled=False)
        laboratory.save(figure, name)

    save(figures.rmse(study.time, shown, bound(study)[:, ::3]), "rmse")
    for first, second in (("UKF", "UKF-J"), ("EKF-J", "SRUKF-J")):
        title = f"RMSE of {first} less RMSE of {second}: positive where {second} is better"
        drawn = figures.rmse_difference(study.time, outcomes[first], outcomes[second], title)
        save(drawn, f"rmse_difference_{first.lower()}")
    conditioned = {"EKF as printed": outcomes["EKF as printed"]} | shown
    save(figures.condition(study.time, conditioned), "condition")
    level = _level(study, recording.measurement[0])
    laboratory.save(radar_figures.signal(time, level, study.time, conditioned, faults), "signal")
    noise = recording.true_noise[0, study.kept]
    names = [channel.name for channel in study.scenario.sensor.channels]
    drawn = radar_figures.channel_rmse(study.time, noise, names, shown, faults)
    laboratory.save(drawn, "rmse_against_noise")
    paths = {
        method.label: filter_recording(study.scenario, method, recording).mean[0]
        for method in METHODS
        if method.label in ("EKF-J", "UKF-J", "SRUKF-J")
    }
    positions = {label: path[:, ::3] for label, path in paths.items()}
    measured = radar_figures.positions(recording.measurement[0])
    close_up = (time >= CLOSE_UP[0]) & (time <= CLOSE_UP[1])
    for name, when in (("track", time >= 0.0), ("track_jammed", close_up)):
        shown_paths = {label: path[when] for label, path in positions.items()}
        drawn = figures.track(
            time[when], truth[when, ::3], measured[when], shown_paths, faults=faults
        )
        laboratory.save(drawn, name)
    bends = {label: path[:, 2::3] for label, path in paths.items()}
    save(figures.accelerations(time, truth[:, 2::3], bends), "accelerations")


def _level(study: Study, measurement: Array) -> Array:
    """(T,) dB, S/(N + J) of a single pulse, NaN where nothing arrives."""
    scenario, rng = study.scenario, default_rng(0)  # none of it is random
    draft = scenario.draft(scenario.trajectory(rng), rng)
    scenario.spoil(draft, rng)
    return np.where(np.isnan(measurement[:, 0]), np.nan, 10.0 * np.log10(draft.snr))


def _lost(outcomes: Outcomes, start: float = 0.0, stop: float = np.inf) -> dict[str, int]:
    """How many tracks each filter lost in an interval."""
    return {
        label: int(np.sum((outcome.lost_at >= start) & (outcome.lost_at < stop)))
        for label, outcome in outcomes.items()
    }


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{label} {count}" for label, count in counts.items())


def _jammed(study: Study, outcomes: Outcomes) -> Claim:
    lost = _lost(outcomes, JAMMER.start, LOSS_START)
    before = outcomes[PRINTED].condition[:, study.time < JAMMER.start][:, -1]
    gone = outcomes[PRINTED].lost_at[outcomes[PRINTED].lost]
    healthy = float(np.nanmedian(before)) < BROKEN
    astray = lost[PRINTED] > study.runs // 2
    return Claim(
        "C7 (E3)",
        "the EKF diverges when jammed, the others do not",
        "S0 sec. 5.1",
        f"of {study.runs} runs lost from the jam's begin to the signal loss: "
        f"{_listed(lost)}. {PRINTED}: κ(P) {np.nanmedian(before):.0e} (median) "
        + ("" if healthy else "already ")
        + f"before the jam, {len(gone)} lost over the whole run"
        + (f", at {np.median(gone):.0f} s (median)" if len(gone) else ""),
        judge(astray or lost["EKF-J"] > 0, reason_holds=healthy),
    )


def _signal_lost(study: Study, gaps: dict[float, Outcomes], bare: dict[float, Outcomes]) -> Claim:
    told = []
    for loss, found in gaps.items():
        without = _lost(bare.get(loss, {}), LOSS_START)
        counts = _lost({k: o for k, o in found.items() if k != PRINTED}, LOSS_START)
        listed = (
            f"{k} {n}" + (f" ({without[k]})" if k in without else "") for k, n in counts.items()
        )
        told.append(f"{loss:g} s: {', '.join(listed)}")
    classical = ", ".join(
        f"{_lost(found, LOSS_START)['UKF']} for {loss:g} s" for loss, found in gaps.items()
    )
    contrast = [
        found[method.label] for found in (*gaps.values(), *bare.values()) for method in CONTRAST
    ]
    astray = sum(int(outcome.lost.sum()) for outcome in contrast)
    rootless = sum(int(np.sum(outcome.failure == NOT_POSITIVE_DEFINITE)) for outcome in contrast)
    return Claim(
        "C7b (E3)",
        "the UKF diverges when the signal is lost",
        "S0 sec. 5.1",
        f"of {study.runs} runs without a signal the UKF loses {classical}. All that are lost from "
        f"{LOSS_START:g} s on, in brackets without the speed floor, "
        "but with the clip of the turn rate, of the motion model; "
        f"κ = {KAPPA:g} unless told. Loss of {'; '.join(told)}. Of the "
        f"{astray} losses with κ = -6, whose central weight is negative, {rootless} are of the "
        "covariance's positive definiteness",
        judge(_lost(gaps[LOSSES[0]], LOSS_START)["UKF"] > 0),
    )


def _never_fails(study: Study, gaps: dict[float, Outcomes]) -> Claim:
    lost = {loss: _lost(found) for loss, found in gaps.items()}
    apart = largest_difference(*(gaps[LOSSES[0]][label] for label in ("UKF-J", "SRUKF-J")))
    counts = "; ".join(
        f"{loss:g} s: SRUKF-J {found['SRUKF-J']}, UKF-J {found['UKF-J']}, "
        f"SRUKF-J exact {found['SRUKF-J exact']}"
        for loss, found in lost.items()
    )
    best = all(
        found["SRUKF-J"] == 0 or found["SRUKF-J"] < min(found["UKF-J"], found["EKF-J"])
        for found in lost.values()
    )
    return Claim(
        "C7c (E3)",
        "SRUKF-Joseph alone survives every signal loss",
        "S0 sec. 5.1",
        f"of {study.runs} runs lost after a loss of {counts}. The states of UKF-J and "
        f"SRUKF-J are at most {apart:.1e} apart",
        judge(best and any(found["UKF-J"] > 0 for found in lost.values())),
    )


def _acceleration(study: Study, outcomes: Outcomes) -> Claim:
    late = study.time > SETTLED
    joseph, root = (run_rmse(outcomes[label], late, ACCELERATION) for label in ("UKF-J", "SRUKF-J"))
    typical = float(np.nanmean(joseph))
    apart = largest_difference(outcomes["UKF-J"], outcomes["SRUKF-J"])
    return Claim(
        "C4c (E3)",
        "the square-root filter's acceleration is closer to the truth",
        "S0 Fig. 13",
        f"acceleration RMSE of UKF-J less SRUKF-J: {with_interval(joseph - root, 'm/s²')} of "
        f"{typical:.2f}{unsure(joseph - root, typical)}; their states differ by {apart:.1e} at "
        "most" + (": one estimator in two forms" if apart < ROUNDING else ""),
        judge(matters(joseph - root, typical)),
    )


def _ratios(study: Study, outcome: Outcome) -> tuple[Array, Array]:
    """RMSE over noise of range, azimuth and elevation, outside the jam and in it."""
    time = study.time
    noise = study.sample(0, 1).true_noise[0, study.kept]  # the same in every run
    error = outcome.channel_error[~outcome.lost] / noise
    jam = (time >= JAMMER.start) & (time < JAM_END)
    gap = (time >= LOSS_START) & (time < LOSS_START + LOSSES[0] + AFTER_GAP)
    outside = (time > SETTLED) & ~jam & ~gap
    return tuple(np.sqrt(np.mean(error[:, when] ** 2, axis=(0, 1))) for when in (outside, jam))


def _half_the_noise(study: Study, outcomes: Outcomes) -> list[Claim]:
    ratios = {
        label: np.stack(_ratios(study, outcomes[label])) for label in ("EKF-J", "UKF-J", "SRUKF-J")
    }

    def claim(name: str, what: str, channels: slice) -> Claim:
        told = "; ".join(
            f"{label} {_slashed(pair[0, channels])} (in the jam {_slashed(pair[1, channels])})"
            for label, pair in ratios.items()
        )
        return Claim(
            name,
            f"the error of {what} is half the radar's noise, jammed or not",
            "S0 sec. 5.1",
            f"RMSE over noise: {told}",
            judge(np.max(ratios["SRUKF-J"][:, channels]) < HALF),
        )

    return [
        claim("C8 (E3)", "azimuth and elevation", slice(1, 3)),
        claim("C8b (E3)", "range", slice(0, 1)),
    ]


def _slashed(numbers: Array) -> str:
    return "/".join(f"{number:.2f}" for number in numbers)


def _compared(
    study: Study, outcomes: Outcomes, variant: Outcomes, start: float, stop: float
) -> str:
    """Position RMSE between two times and how a variant changes it, on the same noise."""
    told, when = [], (study.time > start) & (study.time <= stop)
    for label, outcome in variant.items():
        after = run_rmse(outcome, when)
        before = run_rmse(outcomes[label], when)[: len(after)]
        told.append(
            f"{label} {np.nanmedian(before):.1f} m, {with_interval(after / before, 'times')}"
        )
    return "; ".join(told)


def _rained_on(study: Study, outcomes: Outcomes, rain: Outcomes) -> Claim:
    lost = _lost(rain)
    return Claim(
        "E3 rain",
        f"rain of {HEAVY_RAIN:g} mm/h is survived",
        "S0 sec. 5.1",
        f"median position RMSE from {SETTLED:g} s to the signal loss, and what rain makes of it: "
        f"{_compared(study, outcomes, rain, SETTLED, LOSS_START)}; lost: {_listed(lost)}",
        judge(max(lost.values()) == 0),
    )


def _not_told(study: Study, outcomes: Outcomes, unaware: Outcomes) -> Claim:
    lost = _lost(unaware)
    return Claim(
        "E3 unaware",
        "a jammer that the filter is not told of is survived",
        "own claim",
        "median position RMSE in the jam, and what not being told makes of it: "
        f"{_compared(study, outcomes, unaware, JAMMER.start, JAM_END)}; lost: {_listed(lost)}",
        judge(max(lost.values()) == 0),
    )
