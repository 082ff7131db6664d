"""Lost tracks in hard geometry: close passes, azimuth jumps, vague priors, near-exact sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from math import pi, radians
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.filters.engine import Engine
from kfenv.filters.results import FAILURES
from kfenv.models.constant_acceleration import constant_acceleration
from kfenv.models.model import Motion
from kfenv.models.variable_turn import variable_turn
from kfenv.scenarios.faults import SignalLoss
from kfenv.scenarios.radar.scenario import RadarDraft, RadarScenario

from ..files import write_json, written_whole
from .claims import Claim, judge
from .laboratory import Laboratory
from .monte_carlo import Method, Outcome, Study

Array = NDArray[np.float64]
Range = tuple[float, float]

DEFAULT, ENGINE = "SRUKF-J exact", "engine"
METHODS = (
    Method("EKF", "ekf-classical"),
    Method("EKF-J", "ekf-joseph"),
    Method("UKF", "ukf-classical"),
    Method("UKF-J", "ukf-joseph"),
    Method("CKF", "ckf-classical"),
    Method("SRUKF", "srukf-classical"),
    Method("SRUKF-J", "srukf-joseph"),
    Method("SRUKF-J, H at prior", "srukf-joseph-prior"),
    Method(DEFAULT, "srukf-joseph-exact"),
    Method("SRCKF-J exact", "srckf-joseph-exact"),
)
LOST = 1000.0  # m rms in the last third of a run
INCONSISTENT = 50.0  # median NEES of the position there; 2.4 is nominal


@dataclass(frozen=True)
class HardGeometry(RadarScenario):
    """Level flights, straight or turning gently, that pass the radar at half the time.

    The noise is constant and the filter knows it.

    Attributes:
        distance: of the target at half the time, when it flies across the line of sight, m.
        elevation, bearing: where it then is, rad.
        noise_deviation: of range, azimuth and elevation: m, rad, rad.
        prior: standard deviations of position, velocity and acceleration per axis.
        turning: whether the filter's model is the variable turn or constant acceleration.
    """

    duration: float = 60.0
    rate: float = 4.0
    faults: tuple = ()
    distance: Range = (1_000.0, 6_000.0)
    elevation: Range = (radians(2.0), radians(30.0))
    bearing: Range = (-pi, pi)
    noise_deviation: tuple[float, float, float] = (20.0, radians(1.45), radians(1.45))
    prior: tuple[float, float, float] = (300.0, 30.0, 3.0)
    turning: bool = True

    name: ClassVar[str] = "HardGeometry"
    error_scale: ClassVar[float] = 100.0
    speed: ClassVar[Range] = (60.0, 200.0)  # m/s
    turn_rate: ClassVar[Range] = (-radians(3.0), radians(3.0))  # rad/s

    @cached_property
    def motion(self) -> Motion:
        """White jerk of 1 m^2/s^5."""
        return variable_turn(1.0) if self.turning else constant_acceleration(1.0)

    @property
    def initial_deviations(self) -> Array:
        """See `TrackingScenario`."""
        return np.tile(self.prior, 3)

    def trajectories(self, rngs: Sequence[Generator]) -> Array:
        """Truth (B, T, 9)."""
        return np.stack([self._arc(rng) for rng in rngs])

    def _arc(self, rng: Generator) -> Array:
        """Truth (T, 9) of constant speed and turn rate."""
        distance, elevation = rng.uniform(*self.distance), rng.uniform(*self.elevation)
        bearing = rng.uniform(*self.bearing)
        heading = bearing + rng.choice((-0.5, 0.5)) * pi
        speed, turn_rate = rng.uniform(*self.speed), rng.uniform(*self.turn_rate)
        since = self.time - 0.5 * self.duration
        ground, half = distance * np.cos(elevation), 0.5 * turn_rate * since
        chord = speed * since * np.sinc(half / pi)
        truth = np.zeros((len(since), 9))
        for column, offset in ((0, 0.0), (3, 0.5 * pi)):  # north leads east by a quarter turn
            truth[:, column] = ground * np.sin(bearing + offset)
            truth[:, column] += chord * np.sin(heading + half + offset)
            truth[:, column + 1] = speed * np.sin(heading + 2.0 * half + offset)
            truth[:, column + 2] = speed * turn_rate * np.cos(heading + 2.0 * half + offset)
        truth[:, 6] = distance * np.sin(elevation)
        return truth

    def noise(self, draft: RadarDraft, snr: Array) -> Array:
        """The same at every time."""
        return np.broadcast_to(self.noise_deviation, draft.exact.shape)


CLOSE = {"distance": (5.0, 100.0), "elevation": (0.0, 0.5 * pi)}
VAGUE = (1e4, 1e3, 3.0)  # m, m/s, m/s^2
WILD = (1e4, 1e3, 100.0)
PRECISE = (0.01, 1e-6, 1e-6)  # m, rad, rad
LOSS = SignalLoss((20.0, 20.0), start=15.0)
CASES = {
    "passing within 100 m": HardGeometry(**CLOSE),
    "azimuth across ±180°": HardGeometry(bearing=(pi, pi)),
    "vague prior": HardGeometry(prior=VAGUE),
    "vague prior, accelerating": HardGeometry(prior=WILD),
    "vague prior, linear motion": HardGeometry(prior=WILD, turning=False),
    "near-exact sensor": HardGeometry(noise_deviation=PRECISE),
    "near-exact within 100 m": HardGeometry(noise_deviation=PRECISE, **CLOSE),
    "20 s of signal loss": HardGeometry(faults=(LOSS,)),
}


@dataclass(frozen=True)
class Tally:
    """How one filter fared in one case.

    Attributes:
        lost: position error of more than `LOST` rms in the last third, or a failure.
        failures: how many runs ended by each failure.
        inconsistent: further runs whose covariance promises far too much (`INCONSISTENT`).
        rmse: median over the runs kept of the position RMSE in the last third, m.
        nees: median of the position NEES there; 2.4 is nominal.
    """

    lost: int
    failures: dict[str, int]
    inconsistent: int | None
    rmse: float | None
    nees: float | None


Tallies = dict[str, dict[str, Tally]]  # by case and filter


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """The table of lost tracks."""
    tallies: Tallies = {}
    for case, scenario in CASES.items():
        study, outcomes = laboratory.study(case, scenario, METHODS)
        tallies[case] = {label: _tally(study, outcome) for label, outcome in outcomes.items()}
        tallies[case][ENGINE] = _engine(study)
    runs = study.runs
    _write(laboratory.folder, tallies, runs)
    laboratory.save(_figure(tallies, runs), "lost")
    return [
        *(_default_keeps(case, found, runs) for case, found in tallies.items()),
        _printed_keeps(tallies, runs),
    ]


def _tally(study: Study, outcome: Outcome) -> Tally:
    return _count(study, outcome.position_error, outcome.failure, outcome.nees)


def _engine(study: Study) -> Tally:
    """The environments' own filter on the same recordings; it tells no covariances."""
    recording = study.sample()
    run = Engine(study.scenario.motion, study.scenario.sensor).run(recording)
    return _count(study, (run.mean - recording.truth)[:, study.kept, ::3], run.status, None)


def _count(study: Study, errors: Array, failure: NDArray[np.int64], nees: Array | None) -> Tally:
    """A tally from position errors (N, K, 3), failures (N,) and NEES (N, K)."""
    late = study.time >= 2.0 / 3.0 * study.scenario.duration
    rmse = np.sqrt(np.mean(np.sum(errors[:, late] ** 2, axis=2), axis=1))
    kept = (rmse <= LOST) & (failure == 0)
    codes, counts = np.unique(failure[failure != 0], return_counts=True)
    typical = None if nees is None else np.median(nees[kept][:, late], axis=1)
    return Tally(
        lost=int(np.sum(~kept)),
        failures={FAILURES[c]: int(n) for c, n in zip(codes, counts, strict=True)},
        inconsistent=None if typical is None else int(np.sum(typical > INCONSISTENT)),
        rmse=float(np.median(rmse[kept])) if kept.any() else None,
        nees=None if typical is None or not kept.any() else float(np.median(typical)),
    )


def _default_keeps(case: str, found: dict[str, Tally], runs: int) -> Claim:
    listed = ", ".join(f"{label} {tally.lost}" for label, tally in found.items())
    return Claim(
        f"hard: {case}",
        "the default filter and the engine lose no track",
        "own claim",
        f"of {runs} runs lost: {listed}",
        judge(found[DEFAULT].lost == found[ENGINE].lost == 0),
    )


def _printed_keeps(tallies: Tallies, runs: int) -> Claim:
    worst = {case: found["SRUKF-J"].lost for case, found in tallies.items()}
    listed = ", ".join(f"{case} {lost}" for case, lost in worst.items())
    return Claim(
        "C9 (hard)",
        "SRUKF-Joseph never fails",
        "S0, S1 conclusions",
        f"of {runs} runs lost: {listed}",
        judge(max(worst.values()) == 0),
    )


def _write(folder: Path, tallies: Tallies, runs: int) -> None:
    """``lost.json``, and ``lost.md`` with lost tracks, median RMSE and median NEES."""
    write_json(
        folder / "lost.json",
        {case: {k: asdict(t) for k, t in found.items()} for case, found in tallies.items()},
    )
    lines = [
        f"Lost tracks of {runs} runs (more than {LOST:g} m rms in the last third, or failed); "
        "median position RMSE, m, and median position NEES (2.4 is nominal) of those kept; "
        f"! how many of those have a median NEES above {INCONSISTENT:g}.",
        "",
        "| filter | " + " | ".join(tallies) + " |",
        "|---|" + "---|" * len(tallies),
    ]
    for label in next(iter(tallies.values())):
        cells = (_cell(found[label]) for found in tallies.values())
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    lines += ["", "Failures of the filters:", ""]
    for case, found in tallies.items():
        for label, tally in found.items():
            for failure, count in tally.failures.items():
                lines.append(f"- {case}, {label}, {count} of {runs}: {failure}")
    with written_whole(folder / "lost.md") as file:
        file.write(("\n".join(lines) + "\n").encode())


def _cell(tally: Tally) -> str:
    """Lost tracks; RMSE and NEES of the others."""
    if tally.rmse is None:
        return f"**{tally.lost}**"
    told = f"**{tally.lost}**; {tally.rmse:.3g}"
    if tally.nees is not None:
        told += f"; {tally.nees:.1f}" + (f" !{tally.inconsistent}" if tally.inconsistent else "")
    return told


def _figure(tallies: Tallies, runs: int) -> Figure:
    """Lost tracks by filter and case, darker for more."""
    labels = list(next(iter(tallies.values())))
    lost = np.array([[found[label].lost for found in tallies.values()] for label in labels])
    figure = Figure((10.0, 6.0), layout="constrained")
    axes = figure.subplots()
    axes.imshow(lost, cmap="OrRd", vmin=0, vmax=runs, aspect="auto")
    for (row, column), count in np.ndenumerate(lost):
        axes.text(column, row, str(count), ha="center", va="center",
                  color="white" if count > 0.6 * runs else "black")  # fmt: skip
    axes.set_xticks(range(len(tallies)), list(tallies), rotation=30, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(length=0)
    axes.set_title(f"Lost tracks of {runs} runs", loc="left")
    axes.spines[:].set_visible(False)
    return figure
