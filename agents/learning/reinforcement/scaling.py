"""What learning sees of rewards: scaled so that values are about one, and no lost track pays.

Let w be the worst reward, n the decisions of an episode.

* Of the dense rewards (and of those whose range nobody knows) learning sees 1 - gamma times the
  reward, so that values are mean rewards. With m decisions to go a loss costs the lesser of
  m (1 - gamma) w and w, where it is cut; to keep the track costs w (1 - gamma^m) at most,
  which is less than either.
* Of the others it sees n / (1 + gamma + ... + gamma^(n - 1)) times the reward, so that values
  are returns. A loss costs at once all that an episode can still cost, which discounting only
  makes cheaper to keep; so nothing may be cut.
* A time limit is the end: beyond it learning would foresee costs that a loss escapes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium.envs.registration import load_env_creator

from kfenv.envs.options import Options
from kfenv.envs.rewards import DENSE, worst

from ...contest.rollout import find_spec, scenario_and_options


class Scaling(NamedTuple):
    """How `VectorEnvAdapter` shows rewards.

    Attributes:
        scale: learning sees each reward times this ...
        limit: ... and cut to this size.
        ends_in_time: whether nothing counts beyond a time limit.
    """

    scale: float
    limit: float
    ends_in_time: bool


def is_of_kfenv(env_id: str) -> bool:
    """Whether its rewards, and what a lost track costs, are known here."""
    return hasattr(load_env_creator(find_spec(env_id).entry_point), "scenario_class")


def reward_of(env_id: str, env_kwargs: Mapping[str, Any]) -> str | None:
    """The reward's name, if the environment is one of kfenv."""
    if not is_of_kfenv(env_id):
        return None
    return scenario_and_options(env_id, dict(env_kwargs))[1].reward


def scaling_for(env_id: str, env_kwargs: Mapping[str, Any], gamma: float) -> Scaling:
    """What learning with this discount sees of an environment's rewards.

    Raises:
        ValueError: if that were nothing, not even what a lost track costs.
    """
    reward = reward_of(env_id, env_kwargs)
    if reward in (None, *DENSE):
        if gamma == 1.0:
            raise ValueError(
                "setting gamma = 1.0 leaves nothing of rewards that learning sees times 1 - gamma, "
                "and so a lost track would cost nothing: set it below 1, or train on kfenv's "
                "reward 'rmse' or 'log-rmse'"
            )
        limit = math.inf if reward is None else worst(reward, 1.0, 1.0)
        return Scaling(1.0 - gamma, limit, reward is not None)
    decisions = _decisions(*scenario_and_options(env_id, dict(env_kwargs)))
    return Scaling(decisions / float(np.sum(gamma ** np.arange(decisions))), math.inf, True)


def _decisions(scenario: Any, options: Options) -> int:
    """Of an episode."""
    time = scenario.time if options.recording is None else options.recording.time
    return -(-time.shape[-1] // (options.decision_interval or scenario.steps_per_measurement))
