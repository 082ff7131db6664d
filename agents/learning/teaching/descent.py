"""A step of the optimiser."""

from __future__ import annotations

import numpy as np
import torch

from ..channelwise import Network


def descend(
    network: Network, optimiser: torch.optim.Optimizer, loss: torch.Tensor, clip: float
) -> float:
    """One step down the gradient, which is shortened to `clip`; none if it is not finite.

    Returns:
        Its length.
    """
    optimiser.zero_grad()
    loss.backward()
    length = float(torch.nn.utils.clip_grad_norm_(network.parameters(), clip))
    if np.isfinite(length):
        optimiser.step()
    return length
