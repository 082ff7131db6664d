"""Lets stable-baselines3 train on a Gymnasium vector environment."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from kfenv.envs.core import Core

Indices = None | int | Iterable[int]


class VectorEnvAdapter(VecEnv):
    """A Gymnasium `VectorEnv` in the shape that stable-baselines3 expects.

    The environment must reset a finished episode within the same step. Of its infos only the last
    observation of a finished episode is passed on, as `terminal_observation`, with
    `TimeLimit.truncated` and the episode's return, length and time (`episode`: r, l, t), so that
    neither `Monitor` nor `VecMonitor` is needed. The work per step does not grow with the infos.

    Seeding follows Gymnasium: after `seed(s)` the next reset gives sub-environment i the seed
    s + i. A native vector environment steps all sub-environments as one object, so attributes and
    methods are those of the whole, repeated for each sub-environment asked for.

    Args:
        env: The vector environment, in same-step mode.
        reward_scale: Learning sees each reward times this ...
        reward_limit: ... and cut to this size. Returns in `episode` stay as the environment's.
        ends_in_time: Whether the time limit is the end, beyond which nothing counts; otherwise
            learning values what would have followed.
    """

    def __init__(
        self,
        env: VectorEnv,
        reward_scale: float = 1.0,
        reward_limit: float = math.inf,
        ends_in_time: bool = False,
    ) -> None:
        if env.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            raise ValueError(
                "the vector environment resets at the next step, and stable-baselines3 needs it in "
                "the same one: make it with autoreset_mode=AutoresetMode.SAME_STEP"
            )
        self.env, self.reward_scale, self.reward_limit = env, reward_scale, reward_limit
        self.ends_in_time = ends_in_time
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._start = time.monotonic()
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)

    @property
    def core(self) -> Core | None:
        """Of an environment of kfenv."""
        return getattr(self.env.unwrapped, "core", None)

    def reset(self) -> NDArray[Any]:
        """Start every episode anew, with the seed and options last given."""
        observations, _ = self.env.reset(seed=self._seeds[0], options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Step every sub-environment with the actions kept."""
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(dones):
            infos[i] = {
                "terminal_observation": np.array(info["final_obs"][i]),
                "TimeLimit.truncated": bool(
                    truncated[i] and not (terminated[i] or self.ends_in_time)
                ),
                "episode": self._episode(i),
            }
        self._returns[dones] = 0.0
        self._lengths[dones] = 0
        # A copy, because stable-baselines3 adds the value of truncated states to it in place.
        learned = np.clip(self.reward_scale * rewards, -self.reward_limit, self.reward_limit)
        return observations, learned.astype(np.float32), dones, infos

    def _episode(self, i: int) -> dict[str, float]:
        """Return, length and end time of the episode that sub-environment i has just finished."""
        elapsed = round(time.monotonic() - self._start, 6)
        return {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": elapsed}

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """Return the frames that the vector environment renders."""
        return list(self.env.render())

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute, once for each sub-environment asked for."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment, for all sub-environments together."""
        self._refuse_indices(indices)
        setattr(self.env.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once; its result stands for each one."""
        self._refuse_indices(indices)
        result = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [result] * self.num_envs

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: Indices = None
    ) -> list[bool]:
        """Say yes to `Monitor` alone, whose entries in the infos this class fills itself."""
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]

    def _refuse_indices(self, indices: Indices) -> None:
        if indices is not None:
            raise NotImplementedError(
                "a vector environment is one object: leave out indices to address all of it"
            )
