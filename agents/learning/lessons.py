"""Learning from a teacher: regression on its log factors, over episodes that the pupil rolls."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.random import Generator

from .networks import RecurrentNetwork
from .rolling import Roll

LEAST_DEVIATION = 1e-3  # of a feature, so that one that never moved is not blown up


def standardise(network: RecurrentNetwork, rolls: Sequence[Roll]) -> None:
    """Set the network's mean and deviation of each feature to those of the rolls."""
    seen = np.concatenate([roll.observations[roll.running] for roll in rolls])
    deviation = np.maximum(seen.std(axis=0), LEAST_DEVIATION)
    network.mean.copy_(torch.from_numpy(seen.mean(axis=0)))
    network.deviation.copy_(torch.from_numpy(deviation))


def learn(
    network: RecurrentNetwork,
    optimiser: torch.optim.Optimizer,
    rolls: Sequence[Roll],
    epochs: int,
    decisions: int,
    rng: Generator,
    rate: Callable[[float], float],
    clip: float,
    advance: Callable[[float], None],
) -> None:
    """Fit the labels of rolls.

    Args:
        decisions: in a batch, about.
        rate: learning rate, given the share of the epochs that is done.
        clip: longer gradients are shortened to this.
        advance: called with the mean squared error after each batch.
    """
    batches = [batch for roll in rolls for batch in _batches(roll, decisions)]
    total = epochs * len(batches)
    for step in range(total):
        if step % len(batches) == 0:
            batches = [batch for roll in rolls for batch in _batches(roll, decisions, rng)]
            rng.shuffle(batches)
        roll, chosen = batches[step % len(batches)]
        for group in optimiser.param_groups:
            group["lr"] = rate(step / total)
        loss = _error(network, roll, chosen)
        descend(network, optimiser, loss, clip)
        advance(loss.item())


def descend(
    network: RecurrentNetwork, optimiser: torch.optim.Optimizer, loss: torch.Tensor, clip: float
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


def _batches(
    roll: Roll, decisions: int, rng: Generator | None = None
) -> list[tuple[Roll, np.ndarray]]:
    """The episodes of a roll in parts of about so many decisions."""
    steps, episodes = roll.running.shape
    order = np.arange(episodes) if rng is None else rng.permutation(episodes)
    parts = max(1, round(steps * episodes / decisions))
    return [(roll, np.sort(part)) for part in np.array_split(order, min(parts, episodes))]


def _error(network: RecurrentNetwork, roll: Roll, chosen: np.ndarray) -> torch.Tensor:
    """Mean squared error of the log factors that count."""
    told = torch.from_numpy(roll.observations[:, chosen])
    wanted, _ = network(told, network.start(len(chosen)))
    valid = torch.from_numpy(roll.valid[:, chosen])
    labels = torch.from_numpy(roll.labels[:, chosen])
    labels = labels.clamp(network.log_low, network.log_high)
    squared = torch.where(valid, (wanted - labels) ** 2, 0.0)
    return squared.sum() / valid.sum()
