"""The engine's filter in torch, for training through it: every output has a gradient.

It is the sigma-point filter of SPEC section 9 with the exact Joseph form, held in covariances:
a gradient through a Cholesky factorisation costs less than one through a triangularisation.
All tensors are float64 and batch first, on one device.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import torch
from torch import Tensor

from kfenv.models.model import Motion, Sensor
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
    in ``failed``: its outputs are then constants of one (covariances the identity), no
    gradient passes through it in that step, and its neighbours do not notice.

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
        spread, self._weight = sqrt(n + kappa), 0.5 / (n + kappa)
        roots = [sqrt(kappa / (n + kappa)), *2 * n * [sqrt(self._weight)]]
        self._roots = self._constant(roots)  # of the points' weights
        unit = torch.eye(n, dtype=torch.float64)
        signs = spread * torch.cat([torch.zeros(n, 1), unit, -unit], dim=1)
        self._signs = signs.to(self.device)  # factor @ signs are the points' offsets
        self._weighted_signs = self._signs * self._roots
        self._state_turns, self._channel_turns = (
            self._constant([TWO_PI * part.angle for part in parts])
            for parts in (motion.states, sensor.channels)
        )
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
        factor, regular = _factor(covariance)
        points = _points(mean, factor @ self._signs)
        moved = self._step(points, _columns(inputs), dt[:, None])
        new_mean, deviations = self._moments(moved, points[0].shape, self._state_turns)
        entries = self._noise_factor(mean.unbind(1), inputs.unbind(1), dt)
        noise = (_stacked(entries, dt.shape) @ self._places).view_as(covariance)
        new_mean = _wrapped(new_mean, self._state_turns)
        found = new_mean, deviations @ deviations.mT, noise @ noise.mT
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
        factor, regular = _factor(covariance)
        points = _points(mean, factor @ self._signs)
        seen = self._measure(points, _columns(inputs))
        expected, deviations = self._moments(seen, points[0].shape, self._channel_turns)
        deviations = torch.where(present[:, :, None], deviations, 0.0)
        told = torch.where(present, told, 1.0)
        innovation = _wrapped(torch.where(present, value - expected, 0.0), self._channel_turns)
        spread = deviations @ deviations.mT + torch.diag_embed(told * told)
        root, invertible = _factor(spread)
        states = factor @ self._weighted_signs
        gain = torch.cholesky_solve(deviations @ states.mT, root).mT
        new_mean = _wrapped(mean + (gain @ innovation[:, :, None])[:, :, 0], self._state_turns)
        joseph = torch.cat([states - gain @ deviations, gain * told[:, None]], dim=2)
        found = new_mean, joseph @ joseph.mT, innovation, spread.diagonal(dim1=1, dim2=2)
        return Posterior(*guard.leave(regular & invertible, *found), guard.failed)

    def _moments(
        self, components: tuple, shape: torch.Size, turns: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Mean (B, m) of a function's values at the points and weighted deviations (B, m, P)."""
        values = _stacked(components, shape)
        centre = values[:, :, :1]
        offsets = _wrapped(values - centre, turns[:, None])
        shift = self._weight * offsets.sum(dim=2, keepdim=True)
        return (centre + shift)[:, :, 0], (offsets - shift) * self._roots

    def _constant(self, numbers: list[float]) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64, device=self.device)


class Guard:
    """Keeps a failed filter's numbers and gradients from those who share its parameters.

    What is not a number times a gradient of zero is not a number either; so the gradient is
    cut where a step begins, and its results replaced where it ends.
    """

    def __init__(self) -> None:
        self.failed: Tensor | None = None  # (B,) bool, once the step has ended

    def enter(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """The same tensors; a failed filter's gradients end here."""
        views = tuple(given.view_as(given) for given in tensors)
        for view in views:
            if view.requires_grad:
                view.register_hook(self._cut)
        return views

    def leave(self, sound: Tensor, *results: Tensor) -> list[Tensor]:
        """The results, with ones for those of failed filters; `sound` (B,) tells some of them."""
        for result in results:
            sound = sound & torch.isfinite(result).flatten(1).all(dim=1)
        self.failed = ~sound
        return [torch.where(_over(sound, result), result, _safe(result)) for result in results]

    def _cut(self, gradient: Tensor) -> Tensor:
        return gradient.masked_fill(_over(self.failed, gradient), 0.0)


def _over(flags: Tensor, tensor: Tensor) -> Tensor:
    """Flags (B,) in a shape that broadcasts over a tensor (B, ...)."""
    return flags.view(-1, *(1,) * (tensor.dim() - 1))


def _safe(result: Tensor) -> Tensor:
    """Ones, or for a covariance the identity."""
    if result.dim() == 2:
        return result.new_ones(())
    return torch.eye(result.shape[1], dtype=result.dtype, device=result.device)


def _factor(covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Lower factor, and whether there is one (B,)."""
    factor, info = torch.linalg.cholesky_ex(covariance)
    return factor, info == 0


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


def _wrapped(values: Tensor, turns: Tensor) -> Tensor:
    """Wrap to [-pi, pi) where turns are 2 pi; where they are 0 there is nothing to wrap."""
    return values - turns * torch.floor(values.detach() / TWO_PI + 0.5)
