"""What all training runs share: their folder, their description, their interruption."""

from __future__ import annotations

import json
import platform
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, astuple
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from kfenv.envs.core import Core

from ..files import is_free
from ..plain import plain
from .settings import RECURRENT_PPO


class TrainingInterrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM in training; the checkpoint is saved, and the message says how to go on."""


def describe_run(
    env_id: str, env_kwargs: Mapping[str, Any], algorithm: str, settings: Any, seed: int
) -> dict[str, Any]:
    """All that is needed to repeat a run, but its length, as plain JSON."""
    packages = ["kfenv", "numpy", "gymnasium", "stable_baselines3", "torch"]
    packages += ["sb3_contrib"] if algorithm == RECURRENT_PPO else []
    config = {
        "env_id": env_id,
        "env_kwargs": dict(env_kwargs),
        "algorithm": algorithm,
        "seed": seed,
        "settings": asdict(settings),
        "versions": {name: metadata.version(name) for name in packages},
    }
    config["versions"]["python"] = platform.python_version()
    return plain(config)


def layout(core: Core | None) -> dict[str, Any]:
    """The features that an environment of kfenv shows and its knobs; nothing of others."""
    if core is None:
        return {}
    return {"features": core.feature_names(), "knobs": [astuple(knob) for knob in core.knobs]}


def admit(folder: Path, config: Mapping[str, Any], resume: bool) -> None:
    """Raise unless the run may write into `folder`; touch nothing."""
    if resume:
        _check_same_run(folder, config)
        return _check_checkpoint(folder)
    if not is_free(folder):
        raise FileExistsError(
            f"{folder} exists and is not an empty folder: choose another output, or continue "
            "the run in it with --resume (resume=True)"
        )


def _check_same_run(folder: Path, config: Mapping[str, Any]) -> None:
    """Raise unless the run in `folder` was started with `config`, its length and versions apart."""
    try:
        former = _flat(json.loads((folder / "config.json").read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{folder} holds no run to resume (no config.json): check the path, or start a new "
            "run without --resume"
        ) from None
    except (ValueError, AttributeError):
        raise ValueError(
            f"{folder / 'config.json'} is damaged: start a new run in another folder"
        ) from None
    present = _flat(config)
    for key in sorted(former.keys() | present.keys()):
        if former.get(key) != present.get(key):
            raise ValueError(
                f"cannot resume {folder}: {key} was {former.get(key)!r} and is now "
                f"{present.get(key)!r}; give the former value, or choose another output"
            )


def _check_checkpoint(folder: Path) -> None:
    """Raise if the run in `folder` has come to a policy and has no checkpoint to go on from."""
    if (folder / "policy.npz").exists() and not any(folder.glob("checkpoint.*")):
        raise FileNotFoundError(
            f"{folder} has lost its checkpoint, without which the run would begin anew and replace "
            "its policy: put the checkpoint back, or start a new run in another folder"
        )


def _flat(config: Mapping[str, Any]) -> dict[str, Any]:
    """The entries that a resumed run must share, with one-level names."""
    flat = {key: config.get(key) for key in ("env_id", "algorithm", "seed", "init")}
    for group in ("env_kwargs", "settings", "curriculum"):
        flat |= {f"{group}.{key}": value for key, value in config.get(group, {}).items()}
    return flat


@contextmanager
def torch_threads(number: int) -> Iterator[None]:
    """Let torch use so many processor cores."""
    former = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(former)


@contextmanager
def stop_as_event() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C or SIGTERM into an event, so that no update is cut in two.

    The second one acts.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may handle signals
        return
    former = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in former.items():
            signal.signal(number, handler)

    def request_stop(*_: Any) -> None:
        stop.set()
        restore()

    for number in former:
        signal.signal(number, request_stop)
    try:
        yield stop
    finally:
        restore()
