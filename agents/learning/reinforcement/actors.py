"""Policies of stable-baselines3 whose actor is a taught network, and whose critic is their own."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN, Actor, SACPolicy
from torch import Tensor

from kfenv.envs.knobs import Knob

from ..networks import RecurrentNetwork

LARGEST_ACTION = 0.999  # whose inverse of tanh SAC can still work with


class MeanActions(torch.nn.Module):
    """The actions that a copy of a network asks for, as `FactorNetwork.decide` has them."""

    def __init__(self, network: RecurrentNetwork, knobs: Sequence[Knob]) -> None:
        super().__init__()
        self.network = copy.deepcopy(network)
        ends = torch.log(torch.tensor([[knob.low, knob.high] for knob in knobs]))
        self.register_buffer("low", ends[:, 0])
        self.register_buffer("high", ends[:, 1])

    def sequence(self, observations: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (T, B, K) and the next memory (B, H) for observations (T, B, D)."""
        factors, state = self.network(observations, state)
        actions = torch.where(factors >= 0.0, factors / self.high, factors / -self.low)
        return actions.clamp(-1.0, 1.0), state

    def forward(self, observations: Tensor) -> Tensor:
        """Actions (B, K) of a network without memory."""
        return self.sequence(observations[None], self.network.start(len(observations)))[0][0]


class TaughtPolicy(ActorCriticPolicy):
    """PPO's policy."""

    def __init__(
        self, *args: Any, network: RecurrentNetwork, knobs: Sequence[Knob], **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.mlp_extractor.policy_net = MeanActions(network, knobs)
        self.action_net = torch.nn.Identity()
        renew_optimiser(self)

    @property
    def network(self) -> RecurrentNetwork:
        """As training has changed it."""
        return self.mlp_extractor.policy_net.network


class TaughtActor(Actor):
    """SAC's actor: the mean from the taught network, the deviation from layers of its own."""

    def __init__(self, mean: MeanActions, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.mu = mean

    def get_action_dist_params(self, obs: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Mean and log deviation (B, K) before tanh."""
        features = self.extract_features(obs, self.features_extractor)
        mean = self.mu(features).clamp(-LARGEST_ACTION, LARGEST_ACTION)
        log_std = self.log_std(self.latent_pi(features))
        return torch.atanh(mean), log_std.clamp(LOG_STD_MIN, LOG_STD_MAX), {}


class TaughtSACPolicy(SACPolicy):
    """SAC's policy."""

    def __init__(
        self, *args: Any, network: RecurrentNetwork, knobs: Sequence[Knob], **kwargs: Any
    ) -> None:
        self._taught = network, knobs
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """See `SACPolicy`."""
        kwargs = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return TaughtActor(MeanActions(*self._taught), **kwargs).to(self.device)

    @property
    def network(self) -> RecurrentNetwork:
        """As training has changed it."""
        return self.actor.mu.network


def renew_optimiser(policy: ActorCriticPolicy) -> None:
    """After a change of the policy's layers."""
    rate = policy.optimizer.param_groups[0]["lr"]
    policy.optimizer = policy.optimizer_class(
        policy.parameters(), lr=rate, **policy.optimizer_kwargs
    )
