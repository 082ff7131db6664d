"""Settings of a training run: typed, read from TOML, checked at the door."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, get_type_hints

from kfenv.envs.options import REWARDS
from kfenv.names import unknown

from ..contestants.networks import ACTIVATIONS


@dataclass(frozen=True)
class Settings(ABC):
    """What every algorithm needs; the defaults are in `agents/learning/config/ALGORITHM.toml`."""

    num_envs: int
    """Sub-environments stepped together."""
    hidden: list[int]
    """Width of each hidden layer; policy and value have a network each. Under recurrent-ppo the
    first is the width of the policy too, and of the value's memory; a policy that a run starts
    from keeps its own."""
    activation: str
    """"tanh" or "relu"."""
    learning_rate: float
    """Step size of the optimiser at the start ..."""
    final_learning_rate: float
    """... and at the end, linear in between; set both alike for a constant rate."""
    gamma: float
    """Discount per step: the agent looks about 1 / (1 - gamma) steps ahead."""
    checkpoint_every: int
    """Environment steps between two checkpoints."""
    torch_threads: int
    """Processor cores that the gradient computation may use."""

    @property
    @abstractmethod
    def block(self) -> int:
        """Environment steps between two updates; a run is a whole number of them."""

    def __post_init__(self) -> None:
        """Check what the types cannot say."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int) and value < 1:
                _refuse(field.name, value, "a positive whole number")
        if not self.hidden or min(self.hidden) < 1:
            _refuse("hidden", self.hidden, "a list of positive layer widths")
        if self.activation not in ACTIVATIONS:
            raise ValueError(unknown("activation", self.activation, ACTIVATIONS))
        _within(self, 0.0, 1.0, "learning_rate", "final_learning_rate", "gamma")


@dataclass(frozen=True)
class PPOSettings(Settings):
    """Proximal policy optimisation."""

    n_steps: int
    """Steps of each sub-environment in a rollout."""
    minibatches: int
    """Parts that a rollout is cut into for the gradient: few and large ones are cheap."""
    epochs: int
    """Passes over each rollout."""
    gae_lambda: float
    """Bias (0) against variance (1) of the advantage."""
    clip_range: float
    """How far an update may move the probability of an action."""
    entropy_coefficient: float
    """Reward for staying random."""
    value_coefficient: float
    """Weight of the value loss."""
    max_gradient_norm: float
    """Longer gradients are shortened to this."""
    log_std_init: float
    """Logarithm of the first standard deviation of actions."""

    @property
    def block(self) -> int:
        """One rollout."""
        return self.num_envs * self.n_steps

    def __post_init__(self) -> None:
        """Check what the types cannot say."""
        super().__post_init__()
        _within(self, 0.0, 1.0, "gae_lambda", "clip_range")
        if self.block % self.minibatches or self.block < 2 * self.minibatches:
            raise ValueError(
                f"minibatches = {self.minibatches} does not divide the rollout of {self.block} "
                "steps (num_envs times n_steps) into parts of two or more: choose a divisor"
            )


@dataclass(frozen=True)
class SACSettings(Settings):
    """Soft actor-critic."""

    train_every: int
    """Steps of each sub-environment between two updates."""
    gradient_steps: int
    """Gradient steps in an update."""
    batch_size: int
    """Transitions in a gradient step."""
    buffer_size: int
    """Transitions kept."""
    learning_starts: int
    """Random steps before the first update."""
    tau: float
    """How fast the target networks follow."""
    first_entropy_coefficient: float
    """Reward for staying random at the start; it is then adapted."""
    log_std_init: float
    """Logarithm of the first standard deviation of actions, before tanh."""

    @property
    def block(self) -> int:
        """The steps between two updates."""
        return self.num_envs * self.train_every

    def __post_init__(self) -> None:
        """Check what the types cannot say."""
        super().__post_init__()
        _within(self, 0.0, 1.0, "tau", "first_entropy_coefficient")


@dataclass(frozen=True)
class TaughtSettings:
    """A network that learns from a teacher, then by gradients through the filter."""

    units: int
    """Width of each layer and of the memory."""
    memory: bool
    """Whether the network has a recurrent memory, beside the observation's windows."""
    torch_threads: int
    """Processor cores that the gradient computation may use."""
    checkpoint_every: int
    """Updates through the filter between two checkpoints; every round of lessons has its own."""
    rounds: int
    """Of lessons: in the first the teacher rolls the episodes, in the others the pupil."""
    episodes: int
    """New ones in each round."""
    epochs: int
    """Passes over each round's episodes."""
    batch_decisions: int
    """Decisions in a batch of lessons."""
    jitter: float
    """Deviation added to the teacher's log factors where it rolls."""
    learning_rate: float
    """Step size in lessons at the start ..."""
    final_learning_rate: float
    """... and at the end of all rounds, along a cosine."""
    max_gradient_norm: float
    """Longer gradients are shortened to this in lessons."""
    tuning_trials: int
    """Settings of the teacher that are tried for each of its parameters."""
    refined_episodes: int
    """Episodes in lock-step through the filter."""
    chunk: int
    """Decisions that gradients flow back through."""
    refining_rate: float
    """Step size through the filter at the start ..."""
    final_refining_rate: float
    """... and at the end, along a cosine."""
    max_refining_norm: float
    """Longer gradients are shortened to this through the filter."""
    largest_error: float
    """RMS error of an episode, in error scales, above which it weighs no less."""
    consistency: float
    """Weight of the term that brings the NEES to one ..."""
    consistent_share: float
    """... in this last part of the updates."""

    def __post_init__(self) -> None:
        """Check what the types cannot say."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if type(value) is int and value < (0 if field.name in MAY_BE_ZERO else 1):
                _refuse(field.name, value, "a positive whole number")
            if type(value) is float and not 0.0 <= value < math.inf:
                _refuse(field.name, value, "a number that is not negative")


MAY_BE_ZERO = ("rounds", "tuning_trials")

RECURRENT_PPO = "recurrent-ppo"
ALGORITHMS: dict[str, type] = {
    "ppo": PPOSettings,
    "sac": SACSettings,
    RECURRENT_PPO: PPOSettings,
    "taught": TaughtSettings,
}


def read_settings(
    algorithm: str,
    config_path: str | Path | None = None,
    reward: str | None = None,
    **overrides: Any,
) -> Settings:
    """Return the bundled settings, changed by the TOML file and then by `overrides`.

    Args:
        algorithm: a name in `ALGORITHMS`.
        config_path: a TOML file. In it, as in the bundled one, a table that is called like a
            reward of kfenv holds what differs under that reward.
        reward: of the environment, if it is one of kfenv.
        overrides: by name.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(unknown("algorithm", algorithm, ALGORITHMS))
    bundled = tomllib.loads((files(__package__) / "config" / f"{algorithm}.toml").read_text())
    given = _read_toml(Path(config_path)) if config_path is not None else {}
    values = _under(reward, bundled) | _under(reward, given) | overrides
    return _typed(ALGORITHMS[algorithm], values)


def _under(reward: str | None, values: dict[str, Any]) -> dict[str, Any]:
    """The values outside of the rewards' tables, changed by the reward's own."""
    tables = {name: values.pop(name) for name in REWARDS if isinstance(values.get(name), dict)}
    return values | tables.get(reward, {})


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}): correct that line") from None


def _typed(kind: type[Settings], values: dict[str, Any]) -> Settings:
    """Build settings from untrusted values; raise ValueError naming the key that is wrong."""
    types = get_type_hints(kind)
    for name, value in values.items():
        if name not in types:
            raise ValueError(unknown("setting", name, types))
        if types[name] is float and type(value) is int:
            values[name] = float(value)
        elif not _is_a(value, types[name]):
            _refuse(name, value, getattr(types[name], "__name__", str(types[name])))
    return kind(**values)


def _is_a(value: Any, kind: Any) -> bool:
    if kind == list[int]:
        return isinstance(value, list) and all(type(item) is int for item in value)
    return type(value) is kind


def _within(settings: Settings, low: float, high: float, *names: str) -> None:
    for name in names:
        if not low <= getattr(settings, name) <= high:
            _refuse(name, getattr(settings, name), f"a number from {low:g} to {high:g}")


def _refuse(name: str, value: Any, wanted: str) -> None:
    raise ValueError(f"setting {name} = {value!r} must be {wanted}")
