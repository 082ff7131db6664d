"""A policy beside the loop that it was trained in: what an export needs to know."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from kfenv.envs.loop import Loop

from ..contest.rollout import scenario_and_options
from ..contestants.learned import Learned
from ..contestants.policy import NumpyPolicy
from ..contestants.registry import make_agent


@dataclass(frozen=True)
class Deployable:
    """A trained policy and, for one filter, the features and knobs around it.

    Attributes:
        policy: the network, and what it was trained on.
        loop: of the environment that it was trained on.
        content: of its file.
    """

    policy: NumpyPolicy
    loop: Loop
    content: bytes

    @classmethod
    def find(cls, policy: str, env_id: str | None = None, **env_kwargs: Any) -> Deployable:
        """The policy in a file or a training folder, or ``"learned"`` of an environment.

        Args:
            policy: path or name.
            env_id: only a policy that comes with kfenv needs it.
            **env_kwargs: keywords of the environment beside those that the policy tells.

        Raises:
            ValueError: if there is no such policy, or it does not fit the environment.
        """
        agent = make_agent(policy)
        if env_id is not None:
            agent = agent.suited_to(scenario_and_options(env_id, env_kwargs)[0])
        if not isinstance(agent, Learned):
            raise ValueError(
                f"{policy!r} is no trained policy: give the folder of a training run, its "
                "policy.npz, or 'learned' with the environment."
            )
        told = agent.policy
        scenario, options = scenario_and_options(told.env_id, told.env_kwargs | env_kwargs)
        loop = Loop(scenario, replace(options, recording=None, **agent.own_options), 1)
        agent.check_fits(loop)
        return cls(told, loop, agent.path.read_bytes())
