"""The Gymnasium environments: one filter, or many in lock-step."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isnan
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from kfenv.envs.core import Core
from kfenv.envs.options import Options, check_recording, split_keywords
from kfenv.envs.statistics import BOUND, bound_actions, tell_without_nan
from kfenv.envs.threads import ThreadedCore
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording

RENDER_MODES = ("rgb_array", "human")
ALONE = np.ones(1, bool)  # the one filter of a single environment runs
INFOS = FULL, NONE = "full", "none"


class TrackingEnv(gym.Env):
    """A filter whose knobs the agent turns; the base of the single environments.

    Subclasses name their `scenario_class`; their pages document everything else.
    """

    scenario_class: ClassVar[type]
    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 10}

    def __init__(self, render_mode: str | None = None, **keywords: Any) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(unknown("render_mode", render_mode, RENDER_MODES))
        self.render_mode = render_mode
        self.scenario, self.options = split_keywords(self.scenario_class, keywords)
        self.core = _make_core(self.scenario, self.options, 1)
        self.observation_space, self.action_space = _spaces(self.core)
        names = [knob.name for knob in self.core.knobs]
        self._knobs = list(zip(names, self.core.knob_place.tolist(), strict=True))
        self._episodes = 0
        self._over = True
        self._film = _new_film(self, render_mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw (or replay the next) episode and observe its first pending measurement.

        A seed also starts a replay again at its first episode.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._episodes = 0
        recording = _next_recording(self.scenario, self.options, [self.np_random], [self._episodes])
        self._episodes += 1
        self.core.load(np.zeros(1, np.int64), recording)
        self._over = False
        if self._film is not None:
            self._film.start(recording)
            if self.render_mode == "human":
                self.render()
        return self.core.observation()[0], self._info()

    def step(
        self, action: NDArray
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Turn the knobs for one decision interval.

        Raises:
            ValueError: for an action of the wrong shape or with NaN.
            RuntimeError: if the episode is over.
        """
        action = _checked(action, self.action_space.shape)
        if self._over:
            raise RuntimeError("The episode is over (or never began): call reset() first.")
        reward, lost, ended = (array.item() for array in self.core.step(action, ALONE))
        self._over = lost or ended
        info = self._info()
        factors = self.core.factors[0].tolist()
        info["knobs"] = {name: factors[place] for name, place in self._knobs}
        if self._film is not None:
            self._film.add(self.core, info)
            if self.render_mode == "human":
                self.render()
        return self.core.observation()[0], reward, lost, ended, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the episode so far: an image (H, W, 3), or a window's update."""
        if self._film is None:
            gym.logger.warn("render() draws nothing: make the environment with a render_mode.")
            return None
        return self._film.draw()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._film is not None:
            self._film.close()

    def _info(self) -> dict[str, Any]:
        info = {
            key: value.item() if value.ndim == 1 else value[0]
            for key, value in _without_nan(self.core.information()).items()
        }
        for key in (self.core.yardstick.error_name, "nees"):
            if isnan(info.get(key, 0.0)):  # checkers compare infos, and NaN equals nothing
                del info[key]
        return info


class TrackingVectorEnv(VectorEnv):
    """Many filters in lock-step over one engine; the base of the vector environments.

    Sub-environment i seeded with s + i gives the same bits as a single environment
    seeded so, in however many threads. With ``recording`` it replays episodes i, i + num_envs,
    ... of it.
    """

    scenario_class: ClassVar[type]

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        info: str = FULL,
        max_episode_steps: int | None = None,
        threads: int = 1,
        **keywords: Any,
    ) -> None:
        for name, value in (("num_envs", num_envs), ("threads", threads)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a positive whole number, got {value!r}.")
        if render_mode is not None:
            raise ValueError("The vector environment does not render: use gym.make for that.")
        if info not in INFOS:
            raise ValueError(unknown("info", info, INFOS))
        if max_episode_steps is not None and not max_episode_steps >= 1:
            raise ValueError(f"max_episode_steps must be positive, got {max_episode_steps!r}.")
        self.num_envs = num_envs
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self.render_mode = None
        self._tells = info == FULL
        self._most_steps = np.inf if max_episode_steps is None else max_episode_steps
        self._steps = np.zeros(num_envs, np.int64)
        self.scenario, self.options = split_keywords(self.scenario_class, keywords)
        make_core = partial(_make_core, self.scenario, self.options)
        if threads == 1:
            self.core = make_core(num_envs)
        else:
            self.core = ThreadedCore(make_core, num_envs, threads)
        self.single_observation_space, self.single_action_space = _spaces(self.core)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        self._episodes = np.zeros(num_envs, np.int64)
        self._over = np.ones(num_envs, bool)
        self._begun = np.zeros(num_envs, bool)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """The generator of each sub-environment."""
        return tuple(self._generator(i) for i in range(self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int, ...]:
        """The seed of each sub-environment."""
        _ = self.np_random
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start new episodes everywhere, or where ``options["reset_mask"]`` is true.

        A seed also starts a replay again at the sub-environment's first episode.

        Raises:
            ValueError: if the seeds or the mask do not match the number of environments.
        """
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds were given for {self.num_envs} environments.")
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must be {self.num_envs} booleans, at least one of them "
                "true."
            )
        for i in np.flatnonzero(mask):
            if seeds[i] is not None:
                self._rngs[i], self._seeds[i] = seeding.np_random(seeds[i])
                self._episodes[i] = 0
        self._begin(mask)
        return self.core.observation(), self._info(mask)

    def step(
        self, actions: NDArray
    ) -> tuple[NDArray[np.float32], NDArray, NDArray, NDArray, dict[str, Any]]:
        """Turn the knobs of all sub-environments for one decision interval.

        Raises:
            ValueError: for actions of the wrong shape or with NaN.
            RuntimeError: if an episode never began, or is over and autoreset is disabled.
        """
        actions = _checked(actions, self.action_space.shape)
        if not self._begun.all():
            raise RuntimeError(
                f"The episodes of {int((~self._begun).sum())} sub-environments never began: "
                "call reset() first."
            )
        due = self._over.copy()
        if due.any() and self.autoreset_mode != AutoresetMode.NEXT_STEP:
            raise RuntimeError(
                f"The episodes of {int(due.sum())} sub-environments are over: "
                "call reset(options={'reset_mask': ...}) first."
            )
        running = ~due
        reward, lost, ended = self.core.step(actions, running)
        self._steps += running
        ended |= running & (self._steps >= self._most_steps)
        over = lost | ended
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            self._over = np.zeros(self.num_envs, bool)
            if over.any():
                infos = self._final(over)
                self._begin(over)
        else:
            self._over = over
            if due.any():
                self._begin(due)
        infos.update(self._info(np.ones(self.num_envs, bool)))
        begun_now = over if self.autoreset_mode == AutoresetMode.SAME_STEP else due
        infos.update(self._knobs(~begun_now))
        return self.core.observation(), reward, lost, ended, infos

    def _info(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """What the core tells of sub-environments, if it is to be told."""
        if not self._tells:
            return {}
        return _vector_info(_without_nan(self.core.information()), mask)

    def _knobs(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        if not self._tells:
            return {}
        factors = {
            knob.name: self.core.factors[:, place].copy()
            for knob, place in zip(self.core.knobs, self.core.knob_place, strict=True)
        }
        return {"knobs": _vector_info(factors, mask), "_knobs": mask}

    def _final(self, over: NDArray[np.bool_]) -> dict[str, Any]:
        """The last observation and info of episodes that are over, as Gymnasium hands them out."""
        observations = np.full(self.num_envs, None, dtype=object)
        last = self.core.observation()
        for i in np.flatnonzero(over):
            observations[i] = last[i]
        told = {"final_obs": observations, "_final_obs": over.copy()}
        if not self._tells:
            return told
        return told | {
            "final_info": self._info(over) | self._knobs(over.copy()),
            "_final_info": over.copy(),
        }

    def _begin(self, mask: NDArray[np.bool_]) -> None:
        chosen = np.flatnonzero(mask)
        for first in range(0, len(chosen), self.scenario.at_once):
            part = chosen[first : first + self.scenario.at_once]
            rngs = [self._generator(i) for i in part]
            episodes = part + self.num_envs * self._episodes[part]
            self.core.place(part, _next_recording(self.scenario, self.options, rngs, episodes))
        self.core.open(chosen)
        self._episodes[chosen] += 1
        self._over[chosen] = False
        self._begun[chosen] = True
        self._steps[chosen] = 0

    def _generator(self, i: int) -> np.random.Generator:
        if self._rngs[i] is None:
            self._rngs[i], self._seeds[i] = seeding.np_random()
        return self._rngs[i]


def _make_core(scenario: Any, options: Options, batch: int) -> Core:
    recording = options.recording
    if recording is None:
        return Core(scenario, options, batch, scenario.time, has_truth=True)
    check_recording(recording, scenario)
    return Core(scenario, options, batch, recording.time, recording.truth is not None)


def _spaces(core: Core) -> tuple[Box, Box]:
    knobs = len(core.knobs)
    high = np.full(core.observation_size, BOUND, np.float32)
    high[-knobs:] = 1.0
    return Box(-high, high, dtype=np.float32), Box(-1.0, 1.0, (knobs,), np.float32)


def _next_recording(
    scenario: Any, options: Options, rngs: Sequence[np.random.Generator], episodes: Sequence[int]
) -> Recording:
    """A drawn episode per generator, or the numbered ones of the recording, going round."""
    if options.recording is None:
        return scenario.sample(rngs)
    return options.recording[np.asarray(episodes) % len(options.recording)]


def _checked(action: NDArray, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An array (B, K) of one's own within the bounds, B = 1 for the shape (K,)."""
    array = np.array(action, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"The action has shape {array.shape}, expected {shape}.")
    array = array.reshape(-1, shape[-1])
    if not bound_actions(array):
        raise ValueError("The action holds NaN: check the policy's output.")
    return array


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    for known in AutoresetMode:
        if mode in (known.value, known.name.lower()):
            return known
    names = [known.name.lower() for known in AutoresetMode]
    raise ValueError(unknown("autoreset_mode", mode, names))


def _without_nan(info: dict[str, Any]) -> dict[str, Any]:
    """See `tell_without_nan`: checkers compare infos, and NaN equals nothing."""
    tell_without_nan(info["estimate"], info["innovation"], info["innovation_variance"], info["nis"])
    return info


def _vector_info(arrays: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    info: dict[str, Any] = {}
    for key, value in arrays.items():
        info[key] = value
        info[f"_{key}"] = mask.copy()
    return info


def _new_film(env: TrackingEnv, render_mode: str | None):
    if render_mode is None:
        return None
    from kfenv.envs.rendering import Film

    return Film(env.scenario, env.core.knobs, render_mode)
