"""The paper's case of E6 with its variants, and the filters that fly it (SPEC 4.4, 5, 6, 7.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kfenv.filters.adaptive import ADAPTIVE_DESIGNS, AdaptiveDesign
from kfenv.scenarios.faults import Draft, Fault
from kfenv.scenarios.inertial.faults import AccelerationStep, Outliers, RateStep
from kfenv.scenarios.inertial.ins_gnss import InsGnss

from .monte_carlo import Method, Study

Array = NDArray[np.float64]

OUTLIERS = Outliers()
WINDOW = (OUTLIERS.start, OUTLIERS.start + OUTLIERS.duration)  # s, of the errors told

# Ours, since the paper gives neither: how the mixture varies, and where its outliers lie.
SWING = 3.0
SHIFT = 1.0

UNIT_FAULT: tuple[Fault, ...] = (  # ours: 5 m/s^2 forward and right, 3 deg/s in yaw
    AccelerationStep(1.0, (5.0, 5.0), (10.0, 10.0), 10.0, (0, 1)),
    RateStep(1.0, (3.0, 3.0), (10.0, 10.0), 10.0, (2,)),
)
UNIT_FAULT_SPAN = (10.0, 20.0)  # s
SMALL_Q = 0.01  # factor of Q: deviations a tenth of the table's


@dataclass(frozen=True)
class PaperCase(InsGnss):
    """Start, initial covariance, Q, R and mixture of S4; flight, unit and variants are ours.

    Attributes:
        unit_fault: whether the inertial unit goes wrong as well, from 10 to 20 s.
        by: what an outlier hits, see `Outliers`.
        swing: factor on the deviations of the whole mixture in the middle of its window, to
            which they rise and from which they fall; the filters are not told.
        shift: mean of an outlier's noise in its own deviations; zero is the centred mixture.
    """

    faults: str = "paper"
    unit_fault: bool = False
    by: str = "vector"
    swing: float = 1.0
    shift: float = 0.0

    def spoil(self, draft: Draft, rng: Generator) -> None:
        """See `TrackingScenario.spoil`."""
        replace(OUTLIERS, by=self.by).apply(draft, rng)
        hit = draft.noise_factor > 1.0
        draft.noise_factor *= varying_factor(draft.time, self.swing)[:, None]
        deviations = draft.noise_factor * self.fix_deviations
        draft.exact[hit] += self.shift * deviations[hit]
        for fault in UNIT_FAULT if self.unit_fault else ():
            fault.apply(draft, rng)


def varying_factor(time: Array, swing: float) -> Array:
    """Factor (T,) of deviations: one outside the outliers' window, `swing` in its middle."""
    phase = np.clip((time - WINDOW[0]) / (WINDOW[1] - WINDOW[0]), 0.0, 1.0)
    return swing ** (np.sin(np.pi * phase) ** 2)


def fix_errors(study: Study, runs: int) -> Array:
    """Errors (N, K, 9) of the fixes in the outliers' window of the first runs, SI."""
    recording = study.sample(0, runs)
    inside = (recording.time >= WINDOW[0]) & (recording.time < WINDOW[1])
    error = (recording.measurement - recording.truth)[:, inside]
    error[..., 6:] = np.angle(np.exp(1j * error[..., 6:]))
    return error[:, np.isfinite(error[0, :, 0])]


def _fading(name: str, **choices: object) -> AdaptiveDesign:
    design = ADAPTIVE_DESIGNS[name]
    return replace(design, fading=replace(design.fading, **choices))


EIGHT = tuple(Method(name.upper(), design) for name, design in ADAPTIVE_DESIGNS.items())
PRINTED_V = Method("GSACKF, printed V", _fading("gsackf", v_mode="printed"))
CAUTIOUS = Method("GSACKF, β = 3", _fading("gsackf", beta=3.0))
AS_PRINTED = (
    Method("ACKF, eq 40 as printed", _fading("ackf", applied="raw-moment")),
    Method("ACKF, eq 41, 42 as printed", _fading("ackf", applied="twice")),
)
ALL = (*EIGHT, PRINTED_V, CAUTIOUS, *AS_PRINTED)
CUBATURE = (*(method for method in EIGHT if "CKF" in method.label), CAUTIOUS)
STRICT = tuple(replace(method, process_scale=SMALL_Q) for method in CUBATURE)
