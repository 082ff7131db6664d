"""The engine's filter in torch, every output with a gradient: the reference of `gradients`.

It goes where torch goes, and any loss may be taken of what it tells; refinement takes the
compiled sweep, which is many times as fast.

It is the sigma-point filter of SPEC section 9 with the exact Joseph form, held in covariances:
a gradient through a Cholesky factorisation costs less than one through a triangularisation.
All tensors are float64 and batch first, on one device.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.linalg import solve_triangular

from kfenv.models.model import Component, Motion, Sensor
from kfenv.models.namespaces import tensor

TWO_PI = 2.0 * pi


class Predicted(NamedTuple):
    """The state dt later; the knobs weigh the two parts of its covariance."""

    mean: Tensor  # (B, n)
    propagated: Tensor  # (B, n, n) covariance without process noise
    noise: Tensor  # (B, n, n) covariance of the process noise
    failed: Tensor  # (B,) bool


class Posterior(NamedTuple):
    """The state after a measurement. A missing channel has innovation zero and variance one."""

    mean: Tensor  # (B, n)
    covariance: Tensor  # (B, n, n)
    innovation: Tensor  # (B, m)
    variance: Tensor  # (B, m) of the innovation
    failed: Tensor  # (B,) bool


class DifferentiableFilter:
    """A batch of filters with gradients, for one motion and one sensor.

    A filter whose covariance is not positive definite, or that leaves the numbers, is marked
    in ``failed`` of that step (of the update also for its prediction's sake): its outputs are
    then constants of one (covariances the identity), no gradient passes through it, and its
    neighbours do not notice. It goes on from there, as meaningless as it is: who trains
    remembers whom to leave out.

    Args:
        motion, sensor: the models.
        kappa: spread of the sigma points, as of `kfenv.filters.engine.Engine`.
        device: where the tensors are.

    Raises:
        ValueError: if kappa is negative or not finite.
    """

    def __init__(
        self,
        motion: Motion,
        sensor: Sensor,
        kappa: float = 1.0,
        device: torch.device | str = "cpu",
    ) -> None:
        if not 0.0 <= kappa < float("inf"):
            raise ValueError(f"kappa must be a non-negative number, got {kappa!r}.")
        self.motion, self.sensor, self.kappa = motion, sensor, float(kappa)
        self.device = torch.device(device)
        self._step, self._noise_factor = motion.build(tensor)
        self._measure = sensor.build(tensor)
        n = len(motion.states)
        self._signs, self._centring = (part.to(self.device) for part in _sigma(n, self.kappa))
        self._weighted_signs = self._signs * sqrt(0.5 / (n + kappa))
        self._state_turns, self._channel_turns = (
            _turns(parts, self.device) for parts in (motion.states, sensor.channels)
        )
        unit = torch.eye(n, dtype=torch.float64, device=self.device)
        self._half_triangle = torch.ones_like(unit).tril() - 0.5 * unit
        places = torch.zeros(len(motion.noise_pattern), n, n, dtype=torch.float64)
        for k, (row, column) in enumerate(motion.noise_pattern):
            places[k, row, column] = 1.0
        self._places = places.flatten(1).to(self.device)

    def predict(self, mean: Tensor, covariance: Tensor, inputs: Tensor, dt: Tensor) -> Predicted:
        """Time update.

        Args:
            mean, covariance: of the state, (B, n), (B, n, n).
            inputs: known inputs of the motion, (B, p).
            dt: time step, s, (B,).
        """
        guard = Guard()
        mean, covariance, inputs, dt = guard.enter(mean, covariance, inputs, dt)
        factor, regular = Factor.apply(covariance, self._half_triangle)
        points = _points(mean, factor @ self._signs)
        moved = _stacked(self._step(points, _columns(inputs), dt[:, None]), points[0].shape)
        new_mean, deviations = Moments.apply(moved, self._centring, self._state_turns)
        entries = self._noise_factor(mean.unbind(1), inputs.unbind(1), dt)
        noise = (_stacked(entries, dt.shape) @ self._places).view_as(covariance)
        found = _wrapped(new_mean, self._state_turns), Gram.apply(deviations), Gram.apply(noise)
        return Predicted(*guard.leave(regular, *found), guard.failed)

    def update(
        self,
        predicted: Predicted,
        fading: Tensor,
        process_scale: Tensor,
        inputs: Tensor,
        value: Tensor,
        told: Tensor,
    ) -> Posterior:
        """Measurement update; where nothing arrived, the prediction.

        Args:
            predicted: what `predict` gave, or the initial state with no process noise.
            fading, process_scale: the knobs, variance factors (B,).
            inputs: known inputs of the sensor, (B, k).
            value: measured, (B, m), NaN where nothing arrived.
            told: standard deviations of the noise as the filter takes them, (B, m).
        """
        guard, present = Guard(), ~torch.isnan(value)
        mean, propagated, noise, fading, process_scale, told = guard.enter(
            *predicted[:3], fading, process_scale, told
        )
        covariance = fading[:, None, None] * propagated + process_scale[:, None, None] * noise
        factor, regular = Factor.apply(covariance, self._half_triangle)
        points = _points(mean, factor @ self._signs)
        seen = _stacked(self._measure(points, _columns(inputs)), points[0].shape)
        expected, deviations = Moments.apply(seen, self._centring, self._channel_turns)
        deviations = deviations.masked_fill(~present[:, :, None], 0.0)
        told = torch.where(present, told, 1.0)
        innovation = _wrapped(torch.where(present, value - expected, 0.0), self._channel_turns)
        spread = Gram.apply(torch.cat([deviations, torch.diag_embed(told)], dim=2))
        states = factor @ self._weighted_signs
        gain, invertible = Gain.apply(states @ deviations.mT, spread)
        new_mean = _wrapped(mean + (gain @ innovation[:, :, None])[:, :, 0], self._state_turns)
        joseph = torch.cat([states - gain @ deviations, gain * told[:, None]], dim=2)
        found = new_mean, Gram.apply(joseph), innovation, spread.diagonal(dim1=1, dim2=2)
        sound = regular & invertible & ~predicted.failed
        return Posterior(*guard.leave(sound, *found), guard.failed)


class Guard:
    """Keeps a failed filter's numbers and gradients from those who share its parameters.

    What is not a number times a gradient of zero is not a number either; so the gradient is
    cut where a step begins, and its results replaced where it ends.
    """

    def __init__(self) -> None:
        self.failed: Tensor | None = None  # (B,) bool, once the step has ended
        self._all_sound = False

    def enter(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """The same tensors; a failed filter's gradients end here."""
        views = tuple(given.view_as(given) for given in tensors)
        for view in views:
            if view.requires_grad:
                view.register_hook(self._cut)
        return views

    def leave(self, sound: Tensor, *results: Tensor) -> tuple[Tensor, ...]:
        """The results, with ones for those of failed filters; `sound` (B,) tells some of them."""
        for result in results:
            sound = sound & torch.isfinite(result.detach().flatten(1).sum(dim=1))
        self.failed = ~sound
        self._all_sound = bool(sound.all())
        if self._all_sound:
            return results
        return tuple(torch.where(_over(sound, result), result, _safe(result)) for result in results)

    def _cut(self, gradient: Tensor) -> Tensor:
        if self._all_sound:
            return gradient
        return gradient.masked_fill(_over(self.failed, gradient), 0.0)


class Factor(Function):
    """Lower factor L of a covariance P, and whether there is one (B,).

    These four have their gradients by hand, in fewer operations than torch would do.
    """

    @staticmethod
    def forward(ctx, covariance, half_triangle):
        factor, info = torch.linalg.cholesky_ex(covariance)
        regular = info == 0
        ctx.save_for_backward(factor, half_triangle)
        ctx.mark_non_differentiable(regular)
        return factor, regular

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient, _):
        """L^-T Phi(L^T dL) L^-1, made symmetric; Phi is the lower triangle, half the diagonal."""
        factor, half_triangle = ctx.saved_tensors
        inner = (factor.mT @ gradient) * half_triangle
        inner = solve_triangular(factor.mT, inner, upper=True)
        outer = solve_triangular(factor, inner, upper=False, left=False)
        return 0.5 * (outer + outer.mT), None


class Gram(Function):
    """D D^T of a matrix D."""

    @staticmethod
    def forward(ctx, deviations):
        ctx.save_for_backward(deviations)
        return deviations @ deviations.mT

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        (deviations,) = ctx.saved_tensors
        return (gradient + gradient.mT) @ deviations


class Gain(Function):
    """K = P_xz P_zz^-1 by the factor of P_zz, and whether there is one (B,)."""

    @staticmethod
    def forward(ctx, cross, spread):
        root, info = torch.linalg.cholesky_ex(spread)
        gain, invertible = _over_root(cross, root), info == 0
        ctx.save_for_backward(gain, root)
        ctx.mark_non_differentiable(invertible)
        return gain, invertible

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient, _):
        gain, root = ctx.saved_tensors
        slope = _over_root(gradient, root)
        return slope, -gain.mT @ slope


class Moments(Function):
    """Mean (B, m) of values (B, m, P) at the points, and their weighted deviations (B, m, P).

    Values are averaged as offsets from the central point, so that angles do not break.
    """

    @staticmethod
    def forward(ctx, values, centring, turns):
        centre = values[:, :, :1]
        found = _wrapped(values - centre, turns) @ centring
        ctx.save_for_backward(centring)
        return centre[:, :, 0] + found[:, :, 0], found[:, :, 1:]

    @staticmethod
    @once_differentiable
    def backward(ctx, of_mean, of_deviations):
        (centring,) = ctx.saved_tensors
        slopes = torch.cat([of_mean[:, :, None], of_deviations], dim=2) @ centring.mT
        slopes[:, :, 0] += of_mean - slopes.sum(dim=2)
        return slopes, None, None


def _sigma(n: int, kappa: float) -> tuple[Tensor, Tensor]:
    """What makes the points of a factor, and what makes moments of their offsets.

    Returns:
        (n, P): factor @ this are the points' offsets from the mean.
        (P, 1 + P): offsets from the central value @ this are the mean's offset and the
        deviations from the mean, each times the root of its weight.
    """
    unit = torch.eye(n, dtype=torch.float64)
    signs = sqrt(n + kappa) * torch.cat([torch.zeros(n, 1, dtype=torch.float64), unit, -unit], 1)
    weights = torch.full((2 * n + 1,), 0.5 / (n + kappa), dtype=torch.float64)
    weights[0] = kappa / (n + kappa)
    centred = torch.eye(2 * n + 1, dtype=torch.float64) - weights[:, None]
    return signs, torch.cat([weights[:, None], centred * weights.sqrt()], dim=1)


def _turns(components: tuple[Component, ...], device: torch.device) -> Tensor | None:
    """A full turn for what is an angle and zero for the others; None if there is no angle."""
    turns = [TWO_PI * part.angle for part in components]
    return torch.tensor(turns, dtype=torch.float64, device=device) if any(turns) else None


def _over(flags: Tensor, tensor: Tensor) -> Tensor:
    """Flags (B,) in a shape that broadcasts over a tensor (B, ...)."""
    return flags.view(-1, *(1,) * (tensor.dim() - 1))


def _safe(result: Tensor) -> Tensor:
    """Ones, or for a covariance the identity."""
    if result.dim() == 2:
        return result.new_ones(())
    return torch.eye(result.shape[1], dtype=result.dtype, device=result.device)


def _over_root(matrix: Tensor, root: Tensor) -> Tensor:
    """Matrix (B, n, m) times the inverse of root root^T."""
    half = solve_triangular(root.mT, matrix, upper=True, left=False)
    return solve_triangular(root, half, upper=False, left=False)


def _points(mean: Tensor, offsets: Tensor) -> tuple[Tensor, ...]:
    """The points' components, (B, P) each, from offsets (B, n, P)."""
    return (mean[:, :, None] + offsets).movedim(1, 0).contiguous().unbind(0)


def _columns(inputs: Tensor) -> tuple[Tensor, ...]:
    """Components (B, 1) of inputs (B, p)."""
    return inputs[:, :, None].unbind(1)


def _stacked(components: tuple, shape: torch.Size) -> Tensor:
    """Components as one tensor, their axis second; what is constant is spread over the shape."""
    like = next(part for part in components if isinstance(part, Tensor))
    return torch.stack(
        [
            part if isinstance(part, Tensor) and part.shape == shape
            else torch.as_tensor(part, dtype=like.dtype, device=like.device).expand(shape)
            for part in components
        ],
        dim=1,
    )  # fmt: skip


def _wrapped(values: Tensor, turns: Tensor | None) -> Tensor:
    """Wrap to [-pi, pi) what are angles, their axis second; see `_turns`."""
    if turns is None:
        return values
    turns = turns.view(-1, *(1,) * (values.dim() - 2))
    return values - turns * torch.floor(values.detach() / TWO_PI + 0.5)
