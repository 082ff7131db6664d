"""Environments with arguments and actions of all kinds: refused in a sentence, or sound."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.random import Generator
from numpy.typing import NDArray

import kfenv
from kfenv.envs.options import OBSERVATIONS, REWARDS, Options

from .subject import Case, Wrong

Array = NDArray[np.float64]

DECISIONS, MOST_KNOBS = 30, 40
MODES = ("next_step", "same_step", "disabled")
FILTERS = ("gsekf", "srckf-joseph-exact", "srekf-joseph")
# Arguments of the models, each value of which is compiled anew
COMPILED = {
    "kappa", "process_noise", "biases", "bias_drift", "bias_time", "earth", "constraints",
    "moving", "manoeuvre",
}  # fmt: skip
ODD: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2, 0.1, 3.7, -0.5, 50, 1e-9, 1e9, 1e308, float("nan"),
    float("inf"), "", "x", "none", [], [1.0, 2.0], [0.0, 0.0, 0.0], [1e308] * 3, {}, {"x": 1},
    [[1.0]], 2**70,
)  # fmt: skip
LONGEST = 500  # letters of a complaint


class Environments:
    """Single and vector environments, sometimes with an argument that makes no sense."""

    name = "environments"

    def draw(self, rng: Generator) -> Case:
        """See `Subject`."""
        env_id = kfenv.ENVIRONMENTS[rng.integers(len(kfenv.ENVIRONMENTS))]
        keywords = _keywords(rng, env_id)
        if rng.random() < 0.5:
            names = [item.name for item in (*fields(_scenario(env_id)), *fields(Options))]
            names = [name for name in names if name not in COMPILED]
            keywords[names[rng.integers(len(names))]] = ODD[rng.integers(len(ODD))]
        count = int(rng.integers(1, 9)) if rng.random() < 0.5 else 0
        return {
            "env_id": env_id, "keywords": keywords, "count": count, "seed": int(rng.integers(1000)),
            "mode": MODES[rng.integers(3)], "actions": _actions(rng, max(count, 1)),
        }  # fmt: skip

    def attempt(self, case: Case) -> int:
        """See `Subject`."""
        try:
            env = _make(case)
        except (ValueError, TypeError, OSError) as error:
            _check_complaint(str(error))
            return 0
        try:
            env.reset(seed=case["seed"])
        except ValueError as error:  # what only shows when an episode is drawn
            _check_complaint(str(error))
            return 0
        steps = 0
        for action in case["actions"]:
            if not _step(env, action, case):
                break
            steps += env.core.batch * env.core.interval
        env.close()
        return steps


def _scenario(env_id: str) -> type:
    return load_env_creator(gym.spec(env_id).entry_point).scenario_class


def _make(case: Case) -> Any:
    spec = gym.spec(case["env_id"])
    if not case["count"]:
        return load_env_creator(spec.entry_point)(**case["keywords"])
    maker = load_env_creator(spec.vector_entry_point)
    return maker(num_envs=case["count"], autoreset_mode=case["mode"], **case["keywords"])


def _keywords(rng: Generator, env_id: str) -> dict[str, Any]:
    """Arguments that all make sense; each is there or not."""
    rate = (1.0, 2.0, 5.0, 10.0, 25.0)[rng.integers(5)]
    all_faults = _scenario(env_id).known_faults
    some = [name for name in all_faults if rng.random() < 0.3]
    choices: dict[str, Any] = {
        "duration": float(np.round(rng.uniform(1.0, 8.0), 1)),
        "rate": 10.0 if "Validation" in env_id or "Gnss" in env_id else rate,
        "reward": REWARDS[rng.integers(len(REWARDS))],
        "observation": OBSERVATIONS[rng.integers(len(OBSERVATIONS))],
        "decision_interval": int(rng.integers(1, 6)),
        "most_fading": float(1.0 + 10.0 ** rng.uniform(-3.0, 6.0)),
        "faults": ("none", "random", "paper", {key: {} for key in some})[rng.integers(4)],
    }
    keywords = {name: value for name, value in choices.items() if rng.random() < 0.6}
    keywords["duration"] = choices["duration"]
    if keywords.get("faults") == "paper":  # its times are those of a whole episode
        keywords["duration"] = 200.0
    if rng.random() < 0.1:
        keywords["filter"] = FILTERS[rng.integers(len(FILTERS))]
    return keywords


def _actions(rng: Generator, count: int) -> Array:
    """For more knobs than there are: small, at the bounds, or held, some of them beyond or NaN."""
    shape = (DECISIONS, count, MOST_KNOBS)
    kind = rng.integers(4)
    actions = np.clip(rng.standard_cauchy(shape) / 10.0, -1.0, 1.0)
    if kind == 1:
        actions = np.sign(actions)
    elif kind == 2:
        actions[:] = np.sign(actions[:1])
    if rng.random() < 0.1:
        odd = np.array([np.nan, np.inf, -np.inf, 2.0, -1e9])
        actions[rng.integers(DECISIONS), rng.integers(count)] = rng.choice(odd)
    return actions


def _step(env: Any, action: Array, case: Case) -> bool:
    """One decision, checked; whether the episode goes on."""
    single = not case["count"]
    action = action[0] if single else action
    action = np.ascontiguousarray(action[..., : env.action_space.shape[-1]])
    try:
        observation, reward, terminated, truncated, info = env.step(action)
    except ValueError as error:
        if not np.isnan(action).any():
            raise Wrong(f"a valid action is refused: {error}") from error
        _check_complaint(str(error))
        return True  # unharmed
    if np.isnan(action).any():
        raise Wrong("an action of NaN is taken")
    if not env.observation_space.contains(observation):
        raise Wrong("an observation is outside of its space")
    if not np.isfinite(reward).all():
        raise Wrong("a reward is not finite")
    ended = np.atleast_1d(terminated | truncated)
    sound = (np.atleast_1d(env.core.status) == 0) & ~ended
    if not np.isfinite(np.atleast_2d(info["estimate"])[sound]).all():
        raise Wrong("an estimate is not finite where the status says OK")
    if single or case["mode"] == "disabled":
        return not ended.any()
    return True


def _check_complaint(said: str) -> None:
    if not 15 < len(said) < LONGEST or "\n" in said:
        raise Wrong(f"a complaint is no clear sentence: {said[:200]!r}")
