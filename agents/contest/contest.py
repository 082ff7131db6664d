"""What a contest compares, on what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kfenv.names import unknown

from ..contestants.registry import NAMES, make_agent
from .summary import NOMINAL, TUNED
from .tuning_costs import COSTS, ERROR


@dataclass(frozen=True)
class Contest:
    """What is compared on what; equal contests give equal results.

    Attributes:
        env_id, env_kwargs: the environment; what is no plain JSON value is told by its fingerprint.
        agents: names or paths, see `kfenv.agents.contestants.registry.make_agent`.
        episodes: number of test episodes.
        seed: of the episodes.
        split: which episodes the agents meet, "test" or "validation".
        tuning_episodes: the same for every agent that has parameters.
        tuning_trials: settings that each may try for each of its parameters.
        tuning_kwargs: of the environment that agents are tuned in, if others than `env_kwargs`.
            Its faults are then what they expect in the test as well.
        against: an agent that all are compared with besides `fixed` and `fixed-tuned`.
        tune_on: what tuning makes small, see `kfenv.agents.contest.tuning_costs.costs`.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    agents: tuple[str, ...]
    episodes: int
    seed: int
    tuning_episodes: int = 32
    tuning_trials: int = 60
    split: str = "test"
    tuning_kwargs: dict[str, Any] | None = None
    against: str | None = None
    tune_on: str = ERROR

    def __post_init__(self) -> None:
        if self.tune_on not in COSTS:
            raise ValueError(unknown("cost of tuning", self.tune_on, COSTS))
        for name, least in (("episodes", 2), ("tuning_episodes", 1), ("tuning_trials", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}.")
        names = [make_agent(agent).name for agent in self.all_agents]
        for given, name in zip(self.all_agents, names, strict=True):
            if "/" in name:
                raise ValueError(f"An agent's name must not hold a slash: {name!r}.")
            if names.count(name) > 1 or (name in NAMES and given not in NAMES):
                raise ValueError(
                    f"Two agents are called {name!r}: name the trained one with OTHER=PATH."
                )

    @property
    def all_agents(self) -> tuple[str, ...]:
        """The fixed ones first, the tuned one only where there is tuning; then the rival."""
        fixed = (NOMINAL, TUNED) if self.tuning_trials > 0 else (NOMINAL,)
        rival = () if self.against is None else (self.against,)
        return tuple(dict.fromkeys((*fixed, *rival, *self.agents)))

    @property
    def tuning_place(self) -> tuple[str, dict[str, Any]]:
        """The environment that agents are tuned in, and its keywords."""
        return self.env_id, self.env_kwargs if self.tuning_kwargs is None else self.tuning_kwargs

    @property
    def expected_place(self) -> tuple[str, dict[str, Any]]:
        """The environment with the faults that agents expect: those that they were tuned to."""
        if self.tuning_kwargs is None:
            return self.env_id, self.env_kwargs
        own = {key: value for key, value in self.env_kwargs.items() if key != "faults"}
        expected = {key: value for key, value in self.tuning_kwargs.items() if key == "faults"}
        return self.env_id, own | expected
