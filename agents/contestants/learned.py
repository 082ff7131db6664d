"""A trained policy as an agent: plain arrays, run by NumPy alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

from kfenv.envs.knobs import MOST_FADING, Knob
from kfenv.envs.loop import Loop
from kfenv.envs.options import SHORT, Options
from kfenv.scenarios.recording import Recording

from .agent import Agent, Array, Briefing
from .policy import NumpyPolicy

# What a policy was trained with and must be evaluated with, and its default.
OWN_OPTIONS = {
    "observation": SHORT,
    "actions": None,
    "decision_interval": None,
    "most_fading": MOST_FADING,
}


class Learned(Agent):
    """The deterministic policy in a file that `kfenv train` wrote.

    Raises:
        ValueError: if the file is none, or is damaged.
    """

    all_knobs = False
    sees = "observation"

    def __init__(self, path: str | Path, name: str | None = None) -> None:
        path = Path(path)
        path = path / "policy.npz" if path.is_dir() else path
        self.path = path
        self.policy = NumpyPolicy.load(path)
        super().__init__(name or (path.parent.name if path.name == "policy.npz" else path.stem))

    @property
    def own_options(self) -> dict[str, Any]:
        """Those that the policy was trained with."""
        return OWN_OPTIONS | self.given_options

    @property
    def given_options(self) -> dict[str, Any]:
        """Those of them that are no defaults."""
        kwargs = self.policy.env_kwargs
        return {name: kwargs[name] for name in OWN_OPTIONS if name in kwargs}

    def with_values(self, values: Mapping[str, float]) -> Learned:
        """Itself: a policy has no parameters."""
        return self

    def check(self, scenario: Any, options: Options, recording: Recording | None) -> None:
        """See `Contestant.check`.

        Raises:
            ValueError: if the policy was trained on an environment of another kind, or of
                another observation or other knobs.
        """
        self._check_kind(scenario)
        try:
            options = replace(options, recording=None, **self.own_options)
            loop = Loop(scenario, options, 1)
        except (TypeError, ValueError) as error:
            raise self._refusal(f"its options are refused: {error}") from None
        self.check_fits(loop)

    def check_fits(self, loop: Loop) -> None:
        """Complain if what an environment's loop shows and takes is not the policy's.

        Raises:
            ValueError: in one sentence.
        """
        self._check_kind(loop.scenario)
        policy, knobs = self.policy, _in_words(loop.knobs)
        self._compare("observation", policy.features, policy.observation_size, loop.feature_names())
        self._compare("knobs", _in_words(policy.knobs), policy.action_size, knobs)

    def _check_kind(self, scenario: Any) -> None:
        if _scenario_class(self.policy.env_id) is not type(scenario):
            raise self._refusal(f"this is {scenario.name}")

    def _compare(self, what: str, trained: Sequence[str], size: int, met: Sequence[str]) -> None:
        """Complain of the first difference; an old file tells no more than the size."""
        if size != len(met):
            told = f"its {what} had {size} numbers and would have {len(met)} here"
            raise self._refusal(told + _difference(trained, met) + ": train one as you ask for it")
        for one, other in zip(trained, met, strict=False):
            if one != other:
                raise self._refusal(f"its {what} had {one!r} where there is {other!r} here")

    def _refusal(self, why: str) -> ValueError:
        return ValueError(f"The policy {self.name} was trained on {self.policy.env_id}, and {why}.")

    def reset(self, briefing: Briefing) -> None:
        """Forget the last briefing, and what its episodes left in memory."""
        super().reset(briefing)
        self._memory = self.policy.start(briefing.batch)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        actions, self._memory = self.policy.decide(observation, self._memory)
        return actions.astype(np.float64)


def _scenario_class(env_id: str) -> type | None:
    """Of an environment's id, which may begin with a module; None if it has none here."""
    spec = gym.registry.get(env_id.rpartition(":")[2])
    if spec is None or spec.entry_point is None:
        return None
    return getattr(load_env_creator(spec.entry_point), "scenario_class", None)


def _difference(trained: Sequence[str], met: Sequence[str]) -> str:
    """The first name that only one of them has, if there is one."""
    gone, new = ([name for name in a if name not in b] for a, b in ((trained, met), (met, trained)))
    return f", without {gone[0]!r}" if gone else f", with {new[0]!r}" if new else ""


def _in_words(knobs: Sequence[Knob]) -> tuple[str, ...]:
    return tuple(f"{knob.name} from {knob.low:g} to {knob.high:g}" for knob in knobs)
