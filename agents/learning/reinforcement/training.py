"""Trains an agent with stable-baselines3: checkpoints, resumable, repeatable.

The output folder holds

    config.json        all that is needed to repeat the run
    checkpoint.zip     the stable-baselines3 model with its optimiser
    replay_buffer.pkl  SAC alone: the transitions it learns from, unless they are too large
    policy.npz         the policy as plain arrays, for `NumpyPolicy`
    training.json      how far the run has come, its speed and its learning curve
    tensorboard/       the same and more for TensorBoard
    .lock              the id of the process that trains, while it does
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

try:
    from stable_baselines3.common.logger import configure
except ImportError as error:
    raise ImportError(
        f"Training needs stable-baselines3 and torch ({error}): pip install -e '.[train]'."
    ) from error

from ...contest.rollout import find_spec
from ...contestants.learned import Learned
from ...files import locked, write_json
from ..progress import TrainingProgress
from ..runs import TrainingInterrupted, admit, describe_run, stop_as_event, torch_threads
from ..settings import RECURRENT_PPO, Settings, read_settings
from .checkpoints import Bookkeeper, load_checkpoint
from .models import check_start, model_class, new_model
from .scaling import is_of_kfenv, reward_of, scaling_for
from .stable_baselines import VectorEnvAdapter


def train(
    env_id: str,
    *,
    algorithm: str = "ppo",
    steps: int,
    seed: int,
    output: str | Path,
    env_kwargs: Mapping[str, Any] | None = None,
    num_envs: int | None = None,
    config_path: str | Path | None = None,
    init: str | Path | None = None,
    progress: bool = True,
    resume: bool = False,
) -> Path:
    """Train on `env_id` and return the path of the exported policy.

    Args:
        env_id: Id of a registered environment, with a flat `Box` to observe and to act.
        algorithm: "ppo", "sac" or "recurrent-ppo".
        steps: Environment steps over all sub-environments, rounded up to whole updates.
        seed: The same seed gives the same policy, on the same machine and libraries.
        output: A new or empty folder, or with `resume` that of an earlier run.
        env_kwargs: Options of the environment. An environment of kfenv is trained on its reward
            "improvement", which has far less variance than the default, unless one is given.
        num_envs: Overrides the setting of that name.
        config_path: TOML file with settings that differ from the bundled ones.
        init: A taught policy to start from: one with a memory for "recurrent-ppo", one without for
            the others. Options of the environment that belong to it need not be given again.
        progress: Show a progress bar if the standard error stream is a terminal.
        resume: Go on from the checkpoint in `output`. Everything but `steps` must be as before.
            The environments start new episodes, so the policy differs from an uninterrupted run's.
            The checkpoint and the replay buffer are pickles: reading them runs the code that they
            hold, so resume only folders of your own.

    Raises:
        TrainingInterrupted: Ctrl-C or SIGTERM. The checkpoint is saved; a second one stops
            without it.
        FileExistsError: `output` holds files already and `resume` is not set.
        FileNotFoundError: there is no run to resume, or it has lost its checkpoint.
        RuntimeError: another process trains in `output`.
        ValueError: An argument or a setting is wrong; the message says which and what to do.
    """
    _check_counts(steps, seed)
    start = _read_start(init, algorithm, env_id)
    own = {} if start is None else start.given_options
    env_kwargs = with_training_reward(env_id, {**own, **(env_kwargs or {})})
    reward = reward_of(env_id, env_kwargs)
    settings = read_settings(algorithm, config_path, reward, **_given(num_envs=num_envs))
    model_class(algorithm)
    config = describe_run(env_id, env_kwargs, algorithm, settings, seed) | {"steps": steps}
    if start is not None:
        config["init"] = start.policy.digest
    folder = Path(output)
    admit(folder, config, resume)
    env = make_training_env(env_id, env_kwargs, settings)
    try:
        if start is not None:
            check_start(algorithm, start, env.core)
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder), torch_threads(settings.torch_threads):
            write_json(folder / "config.json", config)
            _run(folder, config, settings, env, start, progress)
    finally:
        env.close()
    return folder / "policy.npz"


def training_seed(seed: int, steps_done: int = 0) -> int:
    """Seed for the episodes and the learning of a run that has come to `steps_done`.

    It depends on the steps so that a resumed run does not repeat the episodes it began with.
    Evaluation draws from spawned seed sequences, which plain seeds never meet.
    """
    return int(np.random.SeedSequence([seed, steps_done]).generate_state(1)[0])


def with_training_reward(env_id: str, env_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Add reward="improvement" for an environment of kfenv, unless a reward is chosen."""
    default = {"reward": "improvement"} if is_of_kfenv(env_id) else {}
    return default | dict(env_kwargs)


def make_training_env(
    env_id: str, env_kwargs: Mapping[str, Any], settings: Settings
) -> VectorEnvAdapter:
    """Make a same-step vector environment for stable-baselines3: native where there is one."""
    scaling = scaling_for(env_id, env_kwargs, settings.gamma)
    same_step = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if find_spec(env_id).vector_entry_point is None:
        how = {"vectorization_mode": "sync", "vector_kwargs": same_step}
    else:
        how = {"vectorization_mode": "vector_entry_point", **same_step}
    vector = gym.make_vec(env_id, num_envs=settings.num_envs, **how, **env_kwargs)
    env = VectorEnvAdapter(vector, *scaling)
    for name in ("observation_space", "action_space"):
        space = getattr(env, name)
        if not isinstance(space, gym.spaces.Box) or len(space.shape) != 1:
            env.close()
            raise ValueError(f"cannot train on {env_id}: its {name} is {space}, not a flat Box")
    return env


def _check_counts(steps: int, seed: int) -> None:
    if steps < 1:
        raise ValueError(f"steps = {steps} must be a positive number of environment steps")
    if seed < 0:
        raise ValueError(f"seed = {seed} must be zero or a positive whole number")


def _read_start(init: str | Path | None, algorithm: str, env_id: str) -> Learned | None:
    """The policy to start from, if there is one."""
    if (init is not None or algorithm == RECURRENT_PPO) and not is_of_kfenv(env_id):
        raise ValueError(
            "recurrent-ppo and the start from a policy are for environments of kfenv, whose knobs "
            "the network sets: train with ppo or sac, from scratch"
        )
    return None if init is None else Learned(init)


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


# The run


def _run(
    folder: Path,
    config: Mapping[str, Any],
    settings: Settings,
    env: VectorEnvAdapter,
    start: Learned | None,
    progress: bool,
) -> None:
    """Train from the start or the checkpoint to the last step, and save."""
    algorithm, seed = config["algorithm"], config["seed"]
    if (folder / "checkpoint.zip").exists():
        model = load_checkpoint(folder, algorithm, env)
        model.set_random_seed(training_seed(seed, model.num_timesteps))
    else:
        model = new_model(algorithm, settings, env, training_seed(seed), start)
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    total = math.ceil(config["steps"] / settings.block) * settings.block
    with (
        stop_as_event() as stop,
        TrainingProgress(algorithm, total, model.num_timesteps, shown=progress) as bar,
    ):
        keeper = Bookkeeper(folder, config, settings, total, stop, bar)
        model.learn(
            max(0, total - model.num_timesteps),
            callback=keeper,
            log_interval=settings.num_envs if algorithm == "sac" else 1,
            reset_num_timesteps=False,
        )
        keeper.finish()
    model.logger.close()
    if model.num_timesteps < total:
        raise TrainingInterrupted(
            f"stopped after {model.num_timesteps} of {total} steps; the checkpoint is in {folder}: "
            "give the same command with --resume (resume=True) to go on"
        )
