"""What the rules make of an innovation, and the parameters that several of them have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..agent import Parameter

Array = NDArray[np.float64]

PROCESS_NOISE = Parameter("process_noise", 0.05, 200.0, 1.0)
NOISE = Parameter("noise", 0.05, 50.0, 1.0)  # factor of the told deviation, for all channels


def split(info: Mapping[str, Any], scale: float = 1.0) -> tuple[Array, Array, Array]:
    """The innovation, H P H^T, and the variance of the noise, each (B, m).

    Args:
        scale: of the told deviation.
    """
    told = info["noise"] ** 2
    explained = np.maximum(info["innovation_variance"] - told, 0.0)
    return info["innovation"], explained, scale**2 * told


def share_of_noise(noise: Array, explained: Array) -> Array:
    """What an update leaves of the innovation of a channel by itself: R / (H P H^T + R)."""
    return noise / (explained + noise)
