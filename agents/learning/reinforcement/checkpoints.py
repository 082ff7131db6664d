"""What a training run keeps on disk: its checkpoints, its policy and the record of its course."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from ...files import read_json, write_json, written_whole
from ..progress import TrainingProgress
from ..runs import layout
from ..settings import Settings
from .export import export_policy
from .models import model_class
from .stable_baselines import VectorEnvAdapter

LARGEST_REPLAY_BUFFER = 2**29  # bytes that a checkpoint may take
CURVE_POINTS = 200  # in the learning curve of a run, about


def load_checkpoint(folder: Path, algorithm: str, env: VectorEnvAdapter) -> BaseAlgorithm:
    """Load the checkpoint, and the replay buffer if there is one."""
    try:
        model = model_class(algorithm).load(folder / "checkpoint.zip", env=env, device="cpu")
        if isinstance(model, SAC) and (folder / "replay_buffer.pkl").exists():
            model.load_replay_buffer(folder / "replay_buffer.pkl")
        elif isinstance(model, SAC):
            # Without its memory it first gathers a new one, as at the start.
            model.learning_starts += model.num_timesteps
    except Exception as error:  # a damaged archive can fail in any of its readers
        raise ValueError(
            f"the checkpoint in {folder} is damaged ({type(error).__name__}): start a new run in "
            "another folder"
        ) from error
    return model


class Bookkeeper(BaseCallback):
    """Shows progress, keeps the learning curve, writes checkpoints and stops on request.

    A checkpoint describes the moment before a rollout: weights and step count belong together
    there. A rollout that is cut short is forgotten.
    """

    def __init__(
        self,
        folder: Path,
        config: Mapping[str, Any],
        settings: Settings,
        total: int,
        stop: threading.Event,
        bar: TrainingProgress,
    ) -> None:
        super().__init__()
        self.folder, self.config, self.settings = folder, config, settings
        self.total, self.stop, self.bar = total, stop, bar
        former = read_record(folder)
        self.curve: list[dict[str, Any]] = former.get("curve", [])
        self.seconds_before: float = former.get("seconds", 0.0)
        self.reward_sum, self.reward_count = 0.0, 0

    def _on_training_start(self) -> None:
        self.started = time.monotonic()
        self.before_rollout = self.saved_at = self.model.num_timesteps
        self.curve = [row for row in self.curve if row["steps"] <= self.saved_at]
        self.keeps_buffer = replay_buffer_bytes(self.model) <= LARGEST_REPLAY_BUFFER
        if not self.keeps_buffer:
            warnings.warn(
                "the replay buffer is too large to be saved, so a resumed run will gather a new "
                "one: set a smaller buffer_size to keep it",
                stacklevel=2,
            )

    def _on_rollout_start(self) -> None:
        self.before_rollout = self.model.num_timesteps
        if self.before_rollout - self.saved_at >= self.settings.checkpoint_every:
            self.save()

    def _on_step(self) -> bool:
        self.reward_sum += float(self.locals["rewards"].mean()) / self.training_env.reward_scale
        self.reward_count += 1
        self.bar.advance(self.model.num_timesteps)
        return not self.stop.is_set()

    def _on_rollout_end(self) -> None:
        steps = self.model.num_timesteps
        former = self.curve[-1]["steps"] if self.curve else 0
        if steps - former >= self.total / CURVE_POINTS or steps >= self.total:
            row = self.row()
            self.curve.append(row)
            self.logger.record("rollout/reward_mean", row["mean_reward"])
            self.bar.show(row["mean_return"], row["mean_reward"])
            self.reward_sum, self.reward_count = 0.0, 0

    def row(self) -> dict[str, Any]:
        """A point of the learning curve."""
        episodes = list(self.model.ep_info_buffer or [])
        return {
            "steps": self.model.num_timesteps,
            "seconds": round(self.seconds(), 3),
            "mean_reward": self.reward_sum / self.reward_count,
            "mean_return": float(np.mean([e["r"] for e in episodes])) if episodes else None,
            "mean_length": float(np.mean([e["l"] for e in episodes])) if episodes else None,
        }

    def seconds(self) -> float:
        """Time spent on the run, earlier parts included."""
        return self.seconds_before + time.monotonic() - self.started

    def finish(self) -> None:
        """Save the end of the run, or the moment before the rollout that was cut short."""
        if self.model.num_timesteps < self.total:
            self.model.num_timesteps = self.before_rollout
        self.save()

    def save(self) -> None:
        """Write checkpoint, policy and record, each whole or not at all."""
        self.saved_at = steps = self.model.num_timesteps
        finished, seconds = steps >= self.total, self.seconds()
        if isinstance(self.model, SAC) and self.keeps_buffer:
            with written_whole(self.folder / "replay_buffer.pkl") as file:
                self.model.save_replay_buffer(file)
        with written_whole(self.folder / "checkpoint.zip") as file:
            self.model.save(file)
        about = {**self.config, **layout(self.training_env.core)}
        about |= {"steps_done": steps, "finished": finished}
        export_policy(self.model, self.folder / "policy.npz", about)
        record = {
            "finished": finished,
            "steps": steps,
            "seconds": seconds,
            "steps_per_second": steps / seconds,
            "mean_return": self.curve[-1]["mean_return"] if self.curve else None,
            "curve": self.curve,
        }
        write_json(self.folder / "training.json", record)


def read_record(folder: Path) -> dict[str, Any]:
    """The record of the run so far; empty where there is none."""
    path = folder / "training.json"
    remedy = "delete it; the run goes on, and its learning curve begins anew"
    return read_json(path, dict, remedy) if path.exists() else {}


def replay_buffer_bytes(model: BaseAlgorithm) -> int:
    """Size of the transitions that a model keeps; 0 for PPO, which keeps none."""
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return 0
    return sum(value.nbytes for value in vars(buffer).values() if isinstance(value, np.ndarray))
