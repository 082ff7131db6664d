"""A trained policy as an agent: plain arrays, run by NumPy alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import MOST_FADING

from .agent import Agent, Array
from .policy import NumpyPolicy

# What a policy was trained with and must be evaluated with, and its default.
OWN_OPTIONS = {"actions": None, "decision_interval": None, "most_fading": MOST_FADING}


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
        self.policy = NumpyPolicy.load(path)
        super().__init__(name or (path.parent.name if path.name == "policy.npz" else path.stem))

    @property
    def own_options(self) -> dict[str, Any]:
        """Those that the policy was trained with."""
        kwargs = self.policy.env_kwargs
        return {name: kwargs.get(name, default) for name, default in OWN_OPTIONS.items()}

    def with_values(self, values: Mapping[str, float]) -> Learned:
        """Itself: a policy has no parameters."""
        return self

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        return self.policy.predict(observation).astype(np.float64)
