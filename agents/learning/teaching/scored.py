"""What errors are measured of, in torch: `kfenv.models.yardstick.Yardstick` with gradients."""

from __future__ import annotations

import torch

from kfenv.models.namespaces import tensor
from kfenv.models.yardstick import TWO_PI, Yardstick


class ScoredTensors:
    """Errors and NEES of a yardstick; all tensors are float64 and batch first."""

    def __init__(self, yardstick: Yardstick) -> None:
        self._states, self._size = list(yardstick.states), len(yardstick)
        self._measure = None if yardstick.sensor is None else yardstick.sensor.build(tensor)
        self._weight = torch.from_numpy(yardstick.weight)
        self._angles = torch.from_numpy(yardstick.angles)
        self._turns = bool(yardstick.angles.any())

    def off(self, estimate: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        """Weighted differences (B, d) of estimates from truths, both (B, n)."""
        if self._measure is None:
            return self._wrapped((estimate - truth)[:, self._states]) * self._weight
        return self._wrapped(self._values(estimate) - self._values(truth)) * self._weight

    def nees(self, off: torch.Tensor, mean: torch.Tensor, covariance: torch.Tensor) -> torch.Tensor:
        """The NEES (B,) per quantity; that of the identity where the covariance is none."""
        block = self._block(mean, covariance)
        root, failed = torch.linalg.cholesky_ex(block)
        eye = torch.eye(self._size, dtype=off.dtype)
        root = torch.where((failed > 0)[:, None, None], eye, root)
        white = torch.linalg.solve_triangular(root, off[:, :, None], upper=False)
        return (white**2).sum(dim=(1, 2)) / self._size

    def _block(self, mean: torch.Tensor, covariance: torch.Tensor) -> torch.Tensor:
        """Of a function by statistical linearisation, as `Yardstick.rows`."""
        both = self._weight[:, None] * self._weight
        if self._measure is None:
            return covariance[:, self._states][:, :, self._states] * both
        columns = torch.linalg.cholesky_ex(covariance)[0].mT
        high, low = (self._values(mean[:, None] + side * columns) for side in (1.0, -1.0))
        rows = 0.5 * self._wrapped(high - low)
        return rows.mT @ rows * both

    def _values(self, states: torch.Tensor) -> torch.Tensor:
        told = self._measure(tuple(states.unbind(-1)), ())
        return torch.stack([torch.as_tensor(part).expand(states.shape[:-1]) for part in told], -1)

    def _wrapped(self, difference: torch.Tensor) -> torch.Tensor:
        if not self._turns:
            return difference
        turns = torch.floor(difference.detach() / TWO_PI + 0.5)
        return difference - torch.where(self._angles, TWO_PI * turns, 0.0)
