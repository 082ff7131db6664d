"""E6: inertial navigation with outlying fixes (SPEC 7.1; claims C11, C12)."""

from __future__ import annotations

from typing import Any

from . import inertial_claims, inertial_figures
from .claims import Claim
from .densities import noise_density
from .inertial_case import (
    ALL,
    CUBATURE,
    EIGHT,
    SHIFT,
    STRICT,
    SWING,
    UNIT_FAULT_SPAN,
    WINDOW,
    PaperCase,
    fix_errors,
)
from .laboratory import Laboratory
from .monte_carlo import Outcome, Study

Outcomes = dict[str, Outcome]

SHADED = {"outliers": WINDOW}
ZOOM = (14.0, 18.0)  # s
DENSITY_RUNS = 20  # whose fixes make the histograms


def reproduce(laboratory: Laboratory) -> list[Claim]:
    """E6."""

    def fly(key: str, methods: tuple, **variant: Any) -> tuple[Study, Outcomes]:
        return laboratory.study(key, PaperCase(**variant), methods, spacing=0.1)

    paper = fly("paper", ALL)
    strict = fly("unit fault", STRICT, unit_fault=True)
    relaxed = fly("unit fault, Q of the table", CUBATURE, unit_fault=True)
    by_channel = fly("outliers by channel", CUBATURE, by="channel")
    varying = fly("mixture that varies", CUBATURE, swing=SWING)
    shifted = fly("mixture not centred", CUBATURE, shift=SHIFT)
    _draw_flight(laboratory, *paper)
    _draw_densities(laboratory, paper[0], shifted[0])
    both = SHADED | {"unit fault": UNIT_FAULT_SPAN}
    for name, (study, outcomes), methods, spans, panels in (
        ("rmse", paper, EIGHT, SHADED, inertial_figures.PER_AXIS),
        ("rmse_3d", paper, EIGHT, SHADED, inertial_figures.IN_3D),
        ("rmse_unit_fault", strict, STRICT, both, inertial_figures.IN_3D),
        ("rmse_varying", varying, CUBATURE, SHADED, inertial_figures.IN_3D),
    ):
        errors = {method.label: outcomes[method.label].channel_error for method in methods}
        laboratory.save(inertial_figures.rmse(study.time, errors, spans, panels), name)
    return [
        *inertial_claims.of_the_case(*paper),
        inertial_claims.best_when_struck(*strict, relaxed[1]),
        inertial_claims.mismatched(*by_channel),
        inertial_claims.varies(*varying),
        inertial_claims.not_centred(*shifted),
    ]


def _draw_flight(laboratory: Laboratory, study: Study, outcomes: Outcomes) -> None:
    """Each angle and velocity of the first run, as all eight filters see it (S4 Fig. 8 to 19)."""
    recording = study.sample(0, 1)
    for channel, name in inertial_figures.DRAWN.items():
        run = inertial_figures.Run(
            study.time,
            recording.truth[0, study.kept, channel],
            recording.measurement[0, study.kept, channel],
            {m.label: outcomes[m.label].channel_error[0, :, channel] for m in EIGHT},
        )
        laboratory.save(inertial_figures.estimates(channel, run, WINDOW, ZOOM), name)


def _draw_densities(laboratory: Laboratory, centred: Study, shifted: Study) -> None:
    """The noise of the fixes in the window, in deviations of R (S4 Fig. 5, 6)."""
    for study, name in ((centred, "density"), (shifted, "density_not_centred")):
        noise = fix_errors(study, DENSITY_RUNS) / study.scenario.fix_deviations
        share, ratio = study.scenario.mixture
        shown = noise_density(noise[..., :6].ravel(), share, ratio, study.scenario.shift)
        laboratory.save(shown, name)
