"""Proximal policy optimisation of policies with memory, through sb3-contrib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kfenv.envs.knobs import Knob

try:
    from sb3_contrib import RecurrentPPO
    from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
except ImportError as error:
    raise ValueError(
        f"recurrent-ppo needs sb3-contrib ({error}): pip install -e '.[train]'."
    ) from error

from ..networks import RecurrentNetwork
from .actors import MeanActions, renew_optimiser

__all__ = ["RecurrentPPO", "TaughtRecurrentPolicy"]


class _AsLSTM(torch.nn.Module):
    """A network in the place of the actor's LSTM: its memory is the hidden state.

    The cell state that an LSTM has besides goes through unused.
    """

    num_layers = 1

    def __init__(self, mean: MeanActions) -> None:
        super().__init__()
        self.mean = mean
        self.input_size, self.hidden_size = len(mean.network.mean), mean.network.memory_size

    def forward(
        self, observations: Tensor, states: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Actions (T, B, K) and states, each (1, B, H), for observations (T, B, D)."""
        actions, hidden = self.mean.sequence(observations, states[0][0])
        return actions, (hidden[None], states[1])


class TaughtRecurrentPolicy(RecurrentActorCriticPolicy):
    """Recurrent PPO's policy: the actor is the network, the critic has an LSTM as wide."""

    def __init__(
        self, *args: Any, network: RecurrentNetwork, knobs: Sequence[Knob], **kwargs: Any
    ) -> None:
        super().__init__(*args, lstm_hidden_size=network.memory_size, **kwargs)
        self.lstm_actor = _AsLSTM(MeanActions(network, knobs))
        self.mlp_extractor.policy_net = torch.nn.Identity()
        self.action_net = torch.nn.Identity()
        renew_optimiser(self)

    @property
    def network(self) -> RecurrentNetwork:
        """As training has changed it."""
        return self.lstm_actor.mean.network
