"""Untrained models of stable-baselines3 by the name of their algorithm."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import LinearSchedule, set_random_seed

from kfenv.envs.core import Core
from kfenv.envs.statistics import BOUND

from ...contestants.learned import Learned
from ...contestants.networks import MOST_DEVIATIONS
from ..networks import RecurrentNetwork
from ..settings import RECURRENT_PPO, PPOSettings, SACSettings, Settings
from .actors import TaughtPolicy, TaughtSACPolicy
from .stable_baselines import VectorEnvAdapter

FIRST_HEAD = 0.01  # share of its usual weights: an untrained network leaves the knobs alone


def model_class(algorithm: str) -> type[BaseAlgorithm]:
    """Of stable-baselines3 or sb3-contrib.

    Raises:
        ValueError: if its library is not installed.
    """
    if algorithm == RECURRENT_PPO:
        from .recurrent import RecurrentPPO

        return RecurrentPPO
    return {"ppo": PPO, "sac": SAC}[algorithm]


def check_start(algorithm: str, start: Learned, core: Core) -> None:
    """Complain if an algorithm cannot start from a policy in an environment.

    Raises:
        ValueError: in one sentence.
    """
    start.check_fits(core)
    remembers = RecurrentNetwork.from_policy(start.policy).memory_size > 0
    if remembers != (algorithm == RECURRENT_PPO):
        remedy = f"start {RECURRENT_PPO} from it" if remembers else "start ppo or sac from it"
        has = "a" if remembers else "no"
        raise ValueError(f"the policy {start.name} has {has} memory: {remedy}")


def new_model(
    algorithm: str, settings: Settings, env: VectorEnvAdapter, seed: int, start: Learned | None
) -> BaseAlgorithm:
    """A model whose actor is random, or the one of the policy `start`."""
    policy, own = _policy(algorithm, settings, env, seed, start)
    activation = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.activation]
    policy_kwargs = {"net_arch": settings.hidden, "activation_fn": activation} | own
    common: dict[str, Any] = {
        "policy": policy,
        "env": env,
        "learning_rate": LinearSchedule(settings.learning_rate, settings.final_learning_rate, 1.0),
        "gamma": settings.gamma,
        "policy_kwargs": policy_kwargs,
        "stats_window_size": max(100, settings.num_envs),
        "seed": seed,
        "device": "cpu",
    }
    if isinstance(settings, PPOSettings):
        policy_kwargs["log_std_init"] = settings.log_std_init
        return model_class(algorithm)(**common, **_ppo_arguments(settings))
    assert isinstance(settings, SACSettings)
    model = SAC(**common, **_sac_arguments(settings))
    # stable-baselines3 has no option for this; its own start, near 1, saturates every action.
    torch.nn.init.constant_(model.actor.log_std.bias, settings.log_std_init)
    return model


def _policy(
    algorithm: str, settings: Settings, env: VectorEnvAdapter, seed: int, start: Learned | None
) -> tuple[Any, dict[str, Any]]:
    """The kind of policy, and what it must be told besides what is common to all."""
    if start is None and algorithm != RECURRENT_PPO:
        return "MlpPolicy", {}
    core = env.core
    set_random_seed(seed)
    if start is None:
        network = _untrained(core, settings.hidden[0])
    else:
        network = RecurrentNetwork.from_policy(start.policy)
    own = {"network": network, "knobs": core.knobs}
    if algorithm == RECURRENT_PPO:
        from .recurrent import TaughtRecurrentPolicy

        return TaughtRecurrentPolicy, own
    return {"ppo": TaughtPolicy, "sac": TaughtSACPolicy}[algorithm], own


def _untrained(core: Core, hidden: int) -> RecurrentNetwork:
    """A network with memory that sets all of the knobs' ranges and cuts no feature."""
    scale = np.full(core.observation_size, BOUND / MOST_DEVIATIONS)
    ends = np.log([[knob.low, knob.high] for knob in core.knobs])
    network = RecurrentNetwork(np.zeros_like(scale), scale, *ends.T, hidden=hidden)
    with torch.no_grad():
        network.head.weight.mul_(FIRST_HEAD)
        network.head.bias.zero_()
    return network


def _ppo_arguments(settings: PPOSettings) -> dict[str, Any]:
    return {
        "n_steps": settings.n_steps,
        "batch_size": settings.block // settings.minibatches,
        "n_epochs": settings.epochs,
        "gae_lambda": settings.gae_lambda,
        "clip_range": settings.clip_range,
        "ent_coef": settings.entropy_coefficient,
        "vf_coef": settings.value_coefficient,
        "max_grad_norm": settings.max_gradient_norm,
    }


def _sac_arguments(settings: SACSettings) -> dict[str, Any]:
    return {
        "train_freq": settings.train_every,
        "gradient_steps": settings.gradient_steps,
        "batch_size": settings.batch_size,
        "buffer_size": settings.buffer_size,
        "learning_starts": settings.learning_starts,
        "tau": settings.tau,
        "ent_coef": f"auto_{settings.first_entropy_coefficient}",
    }
