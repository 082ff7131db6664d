"""How a Gaussian passes a function: by its Jacobian, or by sigma points (SPEC 2.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from kfenv.filters.designs import FilterDesign
from kfenv.models.model import Component
from kfenv.models.namespaces.dual import Dual, seed

Array = NDArray[np.float64]
TWO_PI = 2.0 * pi


def angle_indices(components: tuple[Component, ...]) -> NDArray[np.intp]:
    """Where angles stand among states or channels."""
    return np.flatnonzero([component.angle for component in components])


def wrap(values: Array, angles: NDArray[np.intp]) -> Array:
    """Wrap the components ``angles`` of values (B, m, ...) to [-pi, pi)."""
    wrapped = values.copy()
    wrapped[:, angles] -= TWO_PI * np.floor(values[:, angles] / TWO_PI + 0.5)
    return wrapped


@dataclass(frozen=True)
class StateFunction:
    """A motion's step or a sensor's measure with all but the state filled in, for B filters.

    A channel that is not present becomes the constant zero, so that a measurement of
    zero with unit noise has no effect through it.

    Attributes:
        plain, dual: the component function on the namespaces `batch` and `dual`.
        angles: indices of the outputs that are angles.
        inputs: known inputs, (B, p).
        dt: time step (B,) of a motion; None for a sensor.
        present: (B, m), which outputs count; None if all do.
    """

    plain: Callable
    dual: Callable
    angles: NDArray[np.intp]
    inputs: Array
    dt: Array | None = None
    present: NDArray[np.bool_] | None = None

    def values(self, points: Array) -> Array:
        """The function at points (B, n, k): (B, m, k)."""
        inputs = tuple(self.inputs.T[:, :, None])
        dt = () if self.dt is None else (self.dt[:, None],)
        components = self.plain(tuple(np.moveaxis(points, 1, 0)), inputs, *dt)
        shape = len(points), len(components), points.shape[2]
        values = np.empty(shape, points.dtype)
        for c, component in enumerate(components):
            values[:, c] = component
        return self._silence(values)

    def jacobian(self, mean: Array) -> Array:
        """Exact first derivatives at mean (B, n): (B, m, n)."""
        dt = () if self.dt is None else (self.dt,)
        components = self.dual(seed(mean), tuple(self.inputs.T), *dt)
        slopes = np.zeros((len(mean), len(components), mean.shape[1]), mean.dtype)
        for c, component in enumerate(components):
            if isinstance(component, Dual):  # a constant has no slope
                slopes[:, c] = component.gradient
        return self._silence(slopes)

    def _silence(self, values: Array) -> Array:
        if self.present is not None:
            values[~self.present] = 0.0
        return values


class Weights(NamedTuple):
    """Weights of the points mean, mean + spread S e_i, mean - spread S e_i."""

    spread: float
    mean: Array  # (2n+1,)
    covariance: Array  # (2n+1,)


def sigma_weights(design: FilterDesign, n: int, dtype: DTypeLike = np.float64) -> Weights:
    """Sigma-point weights for n states; with alpha = 1, beta = 0 those of SPEC 2.2.

    Args:
        dtype: of the weights, which are worked out in float64.

    Raises:
        ValueError: if n + kappa is not positive, or a central weight is negative in
            square-root form.
    """
    kappa = 0.0 if design.transform == "cubature" else design.kappa
    scale = design.alpha**2 * (n + kappa)
    if not scale > 0.0:
        raise ValueError(f"kappa must be greater than -n = {-n}, got {kappa!r}.")
    mean = np.full(2 * n + 1, 0.5 / scale)
    mean[0] = 1.0 - n / scale
    if design.alpha == 1.0:
        mean[0] = kappa / scale  # exactly zero for the cubature points
    covariance = mean.copy()
    covariance[0] += 1.0 - design.alpha**2 + design.beta
    if design.centre == "stacked" and design.form == "square-root" and covariance[0] < 0.0:
        raise ValueError(
            f"The central weight {covariance[0]:.3g} is negative and has no square root: "
            "raise kappa, alpha or beta, or choose the form 'covariance', or the centre "
            "'downdated' to study what becomes of it."
        )
    return Weights(sqrt(scale), mean.astype(dtype), covariance.astype(dtype))


class Ensemble(NamedTuple):
    """Weighted deviations that carry a Gaussian through a function, X w X^T = P."""

    mean: Array  # (B, m) of the function's value
    states: Array  # (B, n, k) deviations of the points from their mean
    values: Array  # (B, m, k) deviations of the function's value
    weights: Array  # (k,)


def unscented(function: StateFunction, mean: Array, factor: Array, weights: Weights) -> Ensemble:
    """Sigma points of N(mean, factor factor^T) through the function.

    Values are averaged as offsets from the central point, so that angles do not break.
    """
    centre = np.zeros((*mean.shape, 1), mean.dtype)
    states = weights.spread * np.concatenate([centre, factor, -factor], axis=2)
    values = function.values(mean[:, :, None] + states)
    middle = values[:, :, 0]
    deviations = wrap(values - middle[:, :, None], function.angles)
    shift = deviations @ weights.mean
    deviations -= shift[:, :, None]
    new_mean = wrap(middle + shift, function.angles)
    return Ensemble(new_mean, states, deviations, weights.covariance)


def extended(function: StateFunction, mean: Array, factor: Array) -> Ensemble:
    """The function linearised at the mean; the columns of the factor are the deviations."""
    value, J = linearised(function, mean)
    return Ensemble(value, factor, J @ factor, np.ones(factor.shape[2], factor.dtype))


def linearised(function: StateFunction, mean: Array) -> tuple[Array, Array]:
    """Value (B, m) and Jacobian (B, m, n) of the function at the mean."""
    value = wrap(function.values(mean[:, :, None])[:, :, 0], function.angles)
    return value, function.jacobian(mean)
