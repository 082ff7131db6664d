"""The eight navigation filters: extended or cubature, fading or not, Gaussian sum or not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.filters.fading import Fading
from kfenv.filters.gaussian_sum import GaussianSum, Mixture
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.replay import replay
from kfenv.filters.results import History, Run
from kfenv.models.model import Motion, Sensor
from kfenv.names import unknown

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdaptiveDesign:
    """A filter of SPEC 5 and 6.

    Attributes:
        base: a design in square-root form.
        fading: how it fades its predictions, if it does.
        mixture: the noise that its Gaussian sum is made for, if it is one.

    Raises:
        ValueError: if the parts do not go together.
    """

    base: FilterDesign
    fading: Fading | None = None
    mixture: Mixture | None = None

    def __post_init__(self) -> None:
        if self.base.form != "square-root":
            raise ValueError(
                "Fading and Gaussian sums are built on square-root filters; this base carries "
                f"a covariance: {self.base}."
            )
        if self.fading and self.fading.v_mode == "robust" and not self.mixture:
            raise ValueError(
                "v_mode 'robust' asks a Gaussian sum how likely an outlier is: give a mixture, "
                "or take v_mode 'printed'."
            )


def _name(kind: str, fades: bool, sums: bool) -> str:
    return ("gs" if sums else "") + ("a" if fades else "") + kind


def _design(base: FilterDesign, fades: bool, sums: bool) -> AdaptiveDesign:
    fading = Fading(v_mode="robust" if sums else "printed") if fades else None
    return AdaptiveDesign(base, fading, Mixture() if sums else None)


_BASES = {
    "ekf": FilterDesign("extended", "square-root", "joseph-exact"),
    "ckf": FilterDesign("cubature", "square-root", "joseph-exact"),
}
ADAPTIVE_DESIGNS: dict[str, AdaptiveDesign] = {
    _name(kind, fades, sums): _design(base, fades, sums)
    for (kind, base), sums, fades in product(_BASES.items(), (False, True), (False, True))
}


class AdaptiveFilter:
    """A batch of filters of one adaptive design, for whole recordings.

    Args:
        motion, sensor: the models.
        design: a name in `ADAPTIVE_DESIGNS`, or an `AdaptiveDesign`.

    Raises:
        ValueError: if there is no such design.
    """

    def __init__(self, motion: Motion, sensor: Sensor, design: AdaptiveDesign | str) -> None:
        if isinstance(design, str):
            if design not in ADAPTIVE_DESIGNS:
                raise ValueError(unknown("adaptive filter", design, ADAPTIVE_DESIGNS))
            design = ADAPTIVE_DESIGNS[design]
        self.motion, self.sensor, self.design = motion, sensor, design
        self._tier = ReferenceFilter(motion, sensor, design.base)
        if design.mixture:
            self._tier = GaussianSum(self._tier, design.mixture)

    def __reduce__(self):
        return AdaptiveFilter, (self.motion, self.sensor, self.design)

    def run(
        self,
        mean: Array,
        factor: Array,
        time: Array,
        u: Array,
        s: Array,
        z: Array,
        sd: Array,
        fading: Array,
        process_scale: Array,
    ) -> Run:
        """Filter whole recordings; arguments as in `ReferenceFilter.run`."""
        case = (mean, factor, time, u, s, z, sd, fading, process_scale)
        return Run(*replay(self._tier, self.design.fading, *case, keep=False)[:4])

    def history(
        self,
        mean: Array,
        factor: Array,
        time: Array,
        u: Array,
        s: Array,
        z: Array,
        sd: Array,
        fading: Array,
        process_scale: Array,
    ) -> History:
        """`run` that also keeps the posterior covariances; arguments as there."""
        case = (mean, factor, time, u, s, z, sd, fading, process_scale)
        return replay(self._tier, self.design.fading, *case)
