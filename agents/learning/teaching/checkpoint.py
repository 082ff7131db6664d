"""The checkpoint of a taught run: plain arrays, which run no code when they are read."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...files import written_whole


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes:
        rounds: of lessons that are over.
        rolls, updates: through the filter.
        total: updates that a budget in minutes came to; None as long as it is not known.
        seconds: spent.
        curve: its course.
    """

    rounds: int = 0
    rolls: int = 0
    updates: int = 0
    total: int | None = None
    seconds: float = 0.0
    curve: list[dict[str, Any]] = field(default_factory=list)


def save_checkpoint(
    folder: Path, network: torch.nn.Module, optimiser: torch.optim.Optimizer, done: Progress
) -> None:
    """Write ``checkpoint.npz``, whole or not at all."""
    arrays = {f"network/{name}": value.numpy() for name, value in network.state_dict().items()}
    for number, state in optimiser.state_dict()["state"].items():
        for name, value in state.items():
            arrays[f"optimiser/{number}/{name}"] = value.numpy()
    with written_whole(folder / "checkpoint.npz") as file:
        np.savez(file, progress=json.dumps(asdict(done)), **arrays)


def load_checkpoint(
    folder: Path, network: torch.nn.Module, optimiser: torch.optim.Optimizer
) -> Progress:
    """Read it back into a network and an optimiser.

    Raises:
        ValueError: if it is damaged.
    """
    try:
        with np.load(folder / "checkpoint.npz", allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        network.load_state_dict(_tensors(arrays, "network/"))
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in _tensors(arrays, "optimiser/").items():
            number, what = name.split("/")
            moments.setdefault(int(number), {})[what] = value
        optimiser.load_state_dict(optimiser.state_dict() | {"state": moments})
        return Progress(**json.loads(str(arrays["progress"])))
    except Exception as error:  # a damaged archive can fail in any of its readers
        raise ValueError(
            f"the checkpoint in {folder} is damaged ({type(error).__name__}): start a new run in "
            "another folder"
        ) from error


def _tensors(arrays: dict[str, Any], prefix: str) -> dict[str, torch.Tensor]:
    return {
        name.removeprefix(prefix): torch.from_numpy(value.copy())
        for name, value in arrays.items()
        if name.startswith(prefix)
    }
