"""Trains an agent with stable-baselines3: checkpoints, resumable, repeatable.

The output folder holds

    config.json        all that is needed to repeat the run
    checkpoint.zip     the stable-baselines3 model with its optimiser
    replay_buffer.pkl  SAC alone: the transitions it learns from, unless they are too large
    policy.npz         the policy as plain arrays, for `NumpyPolicy`
    training.json      how far the run has come, its speed and its learning curve
    tensorboard/       the same and more for TensorBoard
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
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.utils import LinearSchedule
except ImportError as error:
    raise ImportError(
        f"Training needs stable-baselines3 and torch ({error}): pip install -e '.[train]'."
    ) from error

from ..contest.rollout import find_spec
from ..files import write_json
from .checkpoints import Bookkeeper, load_checkpoint
from .progress import TrainingProgress
from .runs import TrainingInterrupted, admit, ctrl_c_as_event, describe_run, torch_threads
from .scaling import is_of_kfenv, reward_of, scaling_for
from .settings import PPOSettings, SACSettings, Settings, read_settings
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
    progress: bool = True,
    resume: bool = False,
) -> Path:
    """Train on `env_id` and return the path of the exported policy.

    Args:
        env_id: Id of a registered environment, with a flat `Box` to observe and to act.
        algorithm: "ppo" or "sac".
        steps: Environment steps over all sub-environments, rounded up to whole updates.
        seed: The same seed gives the same policy, on the same machine and libraries.
        output: A new or empty folder, or with `resume` that of an earlier run.
        env_kwargs: Options of the environment. An environment of kfenv is trained on its reward
            "improvement", which has far less variance than the default, unless one is given.
        num_envs: Overrides the setting of that name.
        config_path: TOML file with settings that differ from the bundled ones.
        progress: Show a progress bar if the standard error stream is a terminal.
        resume: Go on from the checkpoint in `output`. Everything but `steps` must be as before.
            The environments start new episodes, so the policy differs from an uninterrupted run's.

    Raises:
        TrainingInterrupted: Ctrl-C. The checkpoint is saved; a second Ctrl-C stops without it.
        FileExistsError: `output` holds files already and `resume` is not set.
        ValueError: An argument or a setting is wrong; the message says which and what to do.
    """
    _check_counts(steps, seed)
    env_kwargs = with_training_reward(env_id, env_kwargs or {})
    reward = reward_of(env_id, env_kwargs)
    settings = read_settings(algorithm, config_path, reward, **_given(num_envs=num_envs))
    config = describe_run(env_id, env_kwargs, algorithm, settings, seed) | {"steps": steps}
    folder = Path(output)
    admit(folder, config, resume)
    env = make_training_env(env_id, env_kwargs, settings)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "config.json", config)
        with torch_threads(settings.torch_threads):
            _run(folder, config, settings, env, progress)
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


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


# The model


def _new_model(settings: Settings, env: VectorEnvAdapter, seed: int) -> BaseAlgorithm:
    """Make an untrained model."""
    rate = LinearSchedule(settings.learning_rate, settings.final_learning_rate, 1.0)
    policy_kwargs: dict[str, Any] = {
        "net_arch": settings.hidden,
        "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.activation],
    }
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        "env": env,
        "learning_rate": rate,
        "gamma": settings.gamma,
        "policy_kwargs": policy_kwargs,
        "stats_window_size": max(100, settings.num_envs),
        "seed": seed,
        "device": "cpu",
    }
    if isinstance(settings, PPOSettings):
        policy_kwargs["log_std_init"] = settings.log_std_init
        return PPO(**common, **_ppo_arguments(settings))
    assert isinstance(settings, SACSettings)
    model = SAC(**common, **_sac_arguments(settings))
    # stable-baselines3 has no option for this; its own start, near 1, saturates every action.
    torch.nn.init.constant_(model.actor.log_std.bias, settings.log_std_init)
    return model


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


# The run


def _run(
    folder: Path,
    config: Mapping[str, Any],
    settings: Settings,
    env: VectorEnvAdapter,
    progress: bool,
) -> None:
    """Train from the start or the checkpoint to the last step, and save."""
    algorithm, seed = config["algorithm"], config["seed"]
    if (folder / "checkpoint.zip").exists():
        model = load_checkpoint(folder, algorithm, env)
        model.set_random_seed(training_seed(seed, model.num_timesteps))
    else:
        model = _new_model(settings, env, training_seed(seed))
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    total = math.ceil(config["steps"] / settings.block) * settings.block
    with (
        ctrl_c_as_event() as stop,
        TrainingProgress(algorithm, total, model.num_timesteps, shown=progress) as bar,
    ):
        keeper = Bookkeeper(folder, config, settings, total, stop, bar)
        model.learn(
            max(0, total - model.num_timesteps),
            callback=keeper,
            log_interval=1 if algorithm == "ppo" else settings.num_envs,
            reset_num_timesteps=False,
        )
        keeper.finish()
    model.logger.close()
    if model.num_timesteps < total:
        raise TrainingInterrupted(
            f"stopped after {model.num_timesteps} of {total} steps; the checkpoint is in {folder}: "
            "give the same command with --resume (resume=True) to go on"
        )
