"""The family of reference filters: what a filter is chosen from, and names for the choices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

from kfenv.names import unknown

_JOSEPH = ("joseph", "joseph-prior", "joseph-exact", "joseph-statistical")
UPDATES = {
    "covariance": ("classical", "unsymmetrised", "khp", *_JOSEPH, "joseph-omega"),
    "square-root": ("classical", *_JOSEPH, "carlson"),
    "unit-triangular": ("bierman",),
}
LINEARISED = ("khp", "carlson", "bierman")  # updates that need H at the prediction
STATISTICAL = ("joseph-statistical", "joseph-omega")  # where that H would be the Jacobian


@dataclass(frozen=True)
class FilterDesign:
    """One filter of the family (SPEC 2.2): transform, form of the covariance, form of the update.

    Attributes:
        transform: how a Gaussian passes a function. ``"extended"`` linearises with the
            exact Jacobian (on linear models this is the Kalman filter), ``"unscented"``
            takes 2n+1 sigma points, ``"cubature"`` is unscented with kappa = 0.
        form: ``"covariance"`` carries P, ``"square-root"`` a lower factor of it,
            ``"unit-triangular"`` L and D of P = L D L^T, L with a diagonal of ones.
        update: how the covariance is corrected, with gain K and innovation covariance Pzz.

            ``"classical"`` P - K Pzz K^T, symmetrised; in square-root form one rank-one
            downdate for each column of K chol(Pzz).
            ``"unsymmetrised"`` the same as printed, which rounding makes diverge (SPEC 2.3).
            ``"khp"`` (I - K H) P, extended only.
            ``"joseph"`` (I - K H) P (I - K H)^T + K R K^T with the Jacobian H at the
            posterior mean, as printed (S0 eq 17, 18, 32).
            ``"joseph-prior"`` the same with H at the predicted mean.
            ``"joseph-exact"`` the Joseph form from the sigma points themselves (SPEC 9).
            ``"joseph-statistical"`` with the statistical H = (P^-1 Pxz)^T (S0 eq 16), as
            printed; ``"joseph-omega"`` the same with R + Omega for R, covariance form only,
            which puts back what that H leaves out and so is exact (SPEC F9).
            ``"carlson"`` the triangular square root's own update, channel by channel, and
            ``"bierman"`` that of L and D; extended only (S0 Table 3).
        kappa, alpha, beta: spread of the sigma points, unscented only. The defaults
            alpha = 1, beta = 0 give the plain transform; others the scaled one.
        centre: how a square-root form takes in the central sigma point. ``"stacked"`` in
            the QR with the others, which needs a weight that is not negative;
            ``"downdated"`` after it as printed (S0 eq 22 and 26), which for a negative
            weight is a downdate that can fail (SPEC F6).

    Raises:
        ValueError: if the parts do not exist or do not go together.
    """

    transform: Literal["extended", "unscented", "cubature"]
    form: Literal["covariance", "square-root", "unit-triangular"]
    update: str
    kappa: float = 1.0
    alpha: float = 1.0
    beta: float = 0.0
    centre: Literal["stacked", "downdated"] = "stacked"

    def __post_init__(self) -> None:
        _check_choice("transform", self.transform, ("extended", "unscented", "cubature"))
        _check_choice("form", self.form, tuple(UPDATES))
        _check_choice(f"update of the {self.form} form", self.update, UPDATES[self.form])
        _check_choice("centre", self.centre, ("stacked", "downdated"))
        extended = self.transform == "extended"
        if self.update in LINEARISED and not extended:
            raise ValueError(
                f"update {self.update!r} needs the Jacobian of the 'extended' transform."
            )
        exact_already = self.update == "joseph-exact" and self.form == "covariance"
        if extended and (exact_already or self.update in STATISTICAL):
            raise ValueError("With the 'extended' transform 'joseph-prior' is exact: use that.")
        if self.centre == "downdated" and (extended or self.form != "square-root"):
            raise ValueError("centre 'downdated' is for sigma points in the 'square-root' form.")
        spread = (self.kappa, self.alpha, self.beta)
        if self.transform != "unscented" and spread != (1.0, 1.0, 0.0):
            raise ValueError(
                f"kappa, alpha and beta belong to the 'unscented' transform, not to "
                f"{self.transform!r}: leave them out."
            )
        if not all(map(isfinite, spread)) or not self.alpha > 0.0:
            raise ValueError(
                f"kappa, alpha and beta must be finite and alpha positive, got {spread}."
            )


def _check_choice(what: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{what} must be one of {', '.join(choices)}; got {value!r}.")


def _family(prefix: str, transform: str, form: str, updates: tuple[str, ...]) -> dict:
    return {f"{prefix}-{update}": FilterDesign(transform, form, update) for update in updates}


_SIGMA_POINT = ("classical", "unsymmetrised", *_JOSEPH, "joseph-omega")

DESIGNS: dict[str, FilterDesign] = {
    "lkf": FilterDesign("extended", "covariance", "classical"),
    **_family("ekf", "extended", "covariance", ("classical", "unsymmetrised", "khp")),
    # The extended filter's own H is the one at the prediction.
    "ekf-joseph": FilterDesign("extended", "covariance", "joseph-prior"),
    "ekf-ud": FilterDesign("extended", "unit-triangular", "bierman"),
    **_family("srekf", "extended", "square-root", ("classical", "carlson")),
    "srekf-joseph": FilterDesign("extended", "square-root", "joseph-prior"),
    **_family("ukf", "unscented", "covariance", _SIGMA_POINT),
    **_family("ckf", "cubature", "covariance", _SIGMA_POINT),
    **_family("srukf", "unscented", "square-root", ("classical", *_JOSEPH)),
    **_family("srckf", "cubature", "square-root", ("classical", *_JOSEPH)),
}


def find_design(design: FilterDesign | str, kappa: float | None = None) -> FilterDesign:
    """The design of that name (a design is returned as it is), with another kappa if given.

    Raises:
        ValueError: if no design has that name, or it takes no kappa.
    """
    if isinstance(design, str):
        if design not in DESIGNS:
            raise ValueError(unknown("filter design", design, DESIGNS))
        design = DESIGNS[design]
    return design if kappa is None else replace(design, kappa=float(kappa))
