"""Adaptive fading: one factor on the propagated covariance from the innovations (SPEC 6).

Fading answers a model that is wrong: it forgets the prediction when innovations exceed
what the filter expects. It cannot tell a wrong model from a wrong measurement, so an
outlier raises the gain, which is the opposite of robust.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.names import unknown

Array = NDArray[np.float64]
MOMENTS = ("printed", "robust")
APPLICATIONS = ("once", "raw-moment", "twice")


@dataclass(frozen=True)
class Fading:
    """How the fading factor is found and applied (S4 eq 38 to 42).

    Attributes:
        rho: forgetting of the innovations' second moment V, 0 < rho <= 1.
        eta: scale of V.
        beta: weight of R, the "weakening factor" (the paper's epsilon), at least 1.
        norm: traces normalised by R over H P H^T; False takes the printed ones, which add
            m^2 to rad^2 and have P_yy = H P H^T + R below.
        v_mode: ``"printed"`` takes every innovation into V; ``"robust"`` only as far as a
            Gaussian sum holds it for nominal.
        applied: ``"once"`` on the propagated covariance. As printed: ``"raw-moment"``, eq 40
            on the uncentred second moment, which adds (lambda - 1) m m^T; ``"twice"``, eq 41
            and 42 on P_yy and P_xy again, after which P can be negative.

    Raises:
        ValueError: if a number is out of its range or a choice does not exist.
    """

    rho: float = 0.95
    eta: float = 1.0
    beta: float = 1.5
    norm: bool = True
    v_mode: Literal["printed", "robust"] = "printed"
    applied: Literal["once", "raw-moment", "twice"] = "once"

    def __post_init__(self) -> None:
        if not (is_number(self.rho) and 0.0 < self.rho <= 1.0):
            raise ValueError(f"rho must lie in (0, 1], got {self.rho!r}.")
        if not (is_number(self.eta) and self.eta > 0.0):
            raise ValueError(f"eta must be positive, got {self.eta!r}.")
        if not (is_number(self.beta) and self.beta >= 1.0):
            raise ValueError(f"beta must be at least 1, got {self.beta!r}.")
        if self.v_mode not in MOMENTS:
            raise ValueError(unknown("v_mode", self.v_mode, MOMENTS))
        if self.applied not in APPLICATIONS:
            raise ValueError(unknown("way to apply fading", self.applied, APPLICATIONS))


def second_moment(
    design: Fading,
    before: Array,
    innovation: Array,
    variance: Array,
    nominal: Array | None = None,
) -> Array:
    """V_k from V_{k-1}: the diagonal, since only traces are taken (S4 eq 39).

    V_1 = nu nu^T and V_k = (rho V_{k-1} + nu nu^T) / (1 + rho); in robust mode nu nu^T gives
    way to a nu nu^T + (1 - a) V_{k-1}, and V_0 is the innovation covariance.

    Args:
        before: V_{k-1} (B, m), NaN in channels that have not arrived yet.
        innovation: (B, m), NaN in channels that are missing; these keep their V.
        variance: (B, m) of the innovation, without fading.
        nominal: (B,) probability a that the measurement is nominal, for the robust mode.
    """
    squared = innovation**2
    if design.v_mode == "robust":
        before = np.where(np.isnan(before), variance, before)
        squared = nominal[:, None] * squared + (1.0 - nominal[:, None]) * before
    after = (design.rho * before + squared) / (1.0 + design.rho)
    after = np.where(np.isnan(before), squared, after)
    return np.where(np.isnan(innovation), before, after)


def fading_factor(design: Fading, moment: Array, variance: Array, sd: Array) -> Array:
    """lambda = max(1, tr(eta V - beta R) / tr H P H^T), (B,), in traces normalised by R.

    Args:
        moment: V (B, m).
        variance: diagonal of H P H^T + R without fading (B, m), NaN in missing channels.
        sd: deviations of the measurement noise (B, m).
    """
    R = sd**2
    excess, expected = design.eta * moment - design.beta * R, variance
    if design.norm:
        excess, expected = excess / R, variance / R - 1.0
    arrived = ~np.isnan(variance)
    top = np.where(arrived, excess, 0.0).sum(axis=1)
    bottom = np.where(arrived, expected, 0.0).sum(axis=1)
    ratio = np.divide(top, bottom, out=np.ones_like(top), where=bottom > 0.0)
    return np.maximum(ratio, 1.0)
