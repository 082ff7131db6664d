"""The eight navigation filters: extended or cubature, fading or not, Gaussian sum or not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.filters.fading import Fading
from kfenv.filters.gaussian_sum import GaussianSum, Mixture
from kfenv.filters.protocol import Episodes, Filter, Knobs
from kfenv.filters.reference import ReferenceFilter
from kfenv.filters.replay import replay
from kfenv.filters.results import History, Run
from kfenv.models.model import Motion, Sensor
from kfenv.models.own import is_compilable
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


def find_adaptive_design(name: str) -> AdaptiveDesign:
    """The design of that name.

    Raises:
        ValueError: if there is none.
    """
    if name not in ADAPTIVE_DESIGNS:
        raise ValueError(unknown("adaptive filter", name, ADAPTIVE_DESIGNS))
    return ADAPTIVE_DESIGNS[name]


def told_design(name: str, mixture: tuple[float, float] | None) -> AdaptiveDesign:
    """The design of that name, its Gaussian sum made for the mixture (weight, ratio) if told one.

    Raises:
        ValueError: if there is no such design.
    """
    design = find_adaptive_design(name)
    if design.mixture is None or mixture is None:
        return design
    return replace(design, mixture=Mixture(*mixture))


def build_tier(
    motion: Motion, sensor: Sensor, design: AdaptiveDesign, compiled: bool = False
) -> Filter:
    """What predicts and updates for a design, all but its fading.

    Args:
        compiled: whether the engine does a cubature filter's work.
    """
    exact_cubature = ADAPTIVE_DESIGNS["ckf"].base
    compiled = compiled and is_compilable(motion) and is_compilable(sensor)
    if compiled and design.base == exact_cubature:
        from kfenv.filters.engine import Engine  # brings the compiler, half a second

        base = Engine(motion, sensor, kappa=0.0)
    else:
        base = ReferenceFilter(motion, sensor, design.base)
    return GaussianSum(base, design.mixture) if design.mixture else base


class AdaptiveFilter:
    """A batch of filters of one adaptive design, for whole recordings.

    Args:
        motion, sensor: the models.
        design: a name in `ADAPTIVE_DESIGNS`, or an `AdaptiveDesign`.
        compiled: whether the engine does a cubature filter's work.

    Raises:
        ValueError: if there is no such design.
    """

    def __init__(
        self,
        motion: Motion,
        sensor: Sensor,
        design: AdaptiveDesign | str,
        compiled: bool = False,
    ) -> None:
        if isinstance(design, str):
            design = find_adaptive_design(design)
        self.design = design
        self._tier = build_tier(motion, sensor, design, compiled)

    def run(self, episodes: Episodes, knobs: Knobs | None = None) -> Run:
        """See `Filter.run`."""
        return Run(*replay(self._tier, self.design.fading, episodes, knobs, keep=False)[:4])

    def history(self, episodes: Episodes, knobs: Knobs | None = None) -> History:
        """`run` that also keeps the posterior covariances."""
        return replay(self._tier, self.design.fading, episodes, knobs)
