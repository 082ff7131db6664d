"""Numbers drawn for many episodes at once, each episode's from its own generator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Draws:
    """Uniform numbers that are drawn together and handed out in turn.

    The bits are those of the generators' own ``uniform``, called one after the other.

    Args:
        rngs: B generators.
        count: how many numbers are taken of each in all.

    Attributes:
        left: (B, N) those still to be handed out, between 0 and 1.
    """

    def __init__(self, rngs: Sequence[Generator], count: int) -> None:
        self.left = np.empty((len(rngs), count))
        for rng, row in zip(rngs, self.left, strict=True):
            rng.random(out=row)

    def uniform(self, low: Array | float, high: Array | float, count: int) -> Array:
        """The next numbers (B, count), between bounds that broadcast against them."""
        taken, self.left = self.left[:, :count], self.left[:, count:]
        return low + (high - low) * taken


def normal(rngs: Sequence[Generator], shape: tuple[int, ...]) -> Array:
    """Standard normal numbers (B, *shape)."""
    drawn = np.empty((len(rngs), *shape))
    for rng, row in zip(rngs, drawn, strict=True):
        rng.standard_normal(out=row)
    return drawn
