"""A trained policy as plain arrays, evaluated by NumPy alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.checks import is_number
from kfenv.envs.knobs import Knob
from kfenv.names import excerpt

from .channelwise import ChannelwiseNetwork
from .networks import MEMORYLESS, RECURRENT, ActionNetwork, Array, FactorNetwork
from .policy_file import read_arrays, write_arrays

Network = ActionNetwork | FactorNetwork | ChannelwiseNetwork
KINDS: dict[str, type[Network]] = {
    ActionNetwork.kind: ActionNetwork,
    MEMORYLESS: FactorNetwork,
    RECURRENT: FactorNetwork,
    ChannelwiseNetwork.kind: ChannelwiseNetwork,
}

FORMER_FORMAT = "kfenv-policy-1"  # a network of kind "mlp", without features and knobs
FORMAT = "kfenv-policy-2"


@dataclass(frozen=True)
class NumpyPolicy:
    """A network from observations to actions, and what it was trained on.

    Attributes:
        network: see `networks`.
        env_id, env_kwargs: the environment that it was trained on, and its keywords.
        features: what each component of its observation is; empty where nobody told.
        knobs: those that its actions set; empty where nobody told.
        metadata: what else was told.
    """

    network: Network
    env_id: str
    env_kwargs: dict[str, Any]
    features: tuple[str, ...]
    knobs: tuple[Knob, ...]
    metadata: dict[str, Any]

    def __post_init__(self) -> None:
        """Raise ValueError unless the parts fit each other."""
        for what, told, size in (
            ("features", [*self.features], self.observation_size),
            ("knobs", [knob.name for knob in self.knobs], self.action_size),
        ):
            if told and len(told) != size:
                raise ValueError(f"it names {len(told)} {what}, and its network has {size}")
            if not all(isinstance(name, str) for name in told) or len(set(told)) < len(told):
                raise ValueError(f"the names of its {what} are not different words")
        for knob in self.knobs:
            if not (is_number(knob.low) and is_number(knob.high) and 0 < knob.low < 1 < knob.high):
                raise ValueError(f"the knob {knob.name} goes from {knob.low} to {knob.high}")
        for what in ("env_kwargs", "metadata"):
            if not isinstance(getattr(self, what), dict):
                raise ValueError(f"its {what} are no table of names and values")
        if not isinstance(self.env_id, str):
            raise ValueError("its env_id is not text")

    @property
    def observation_size(self) -> int:
        """Length of one observation."""
        return self.network.observation_size

    @property
    def action_size(self) -> int:
        """Length of one action."""
        return self.network.action_size

    @property
    def digest(self) -> str:
        """A hash of all that training chose."""
        parts = (array.tobytes() for array in self.network.parameters)
        return hashlib.sha256(b"".join(parts)).hexdigest()

    def start(self, batch: int) -> Array:
        """The memory (B, H) of episodes that begin; (B, 0) for a policy without any."""
        return np.zeros((batch, self.network.memory_size), np.float32)

    def forget(self, state: Array, mask: NDArray[np.bool_]) -> Array:
        """The memory with the episodes of the mask (B,) begun anew, changed in place."""
        state[mask] = 0.0
        return state

    def decide(self, observations: ArrayLike, state: Array) -> tuple[Array, Array]:
        """Return the deterministic actions and the next memory.

        Args:
            observations: (B, D), or (D,) for a single environment.
            state: (B, H) from `start` or the last decision; left as it is.

        Raises:
            ValueError: for observations of another length than the policy was trained on.
        """
        x = np.asarray(observations, dtype=np.float32)
        if x.shape[-1:] != (self.observation_size,):
            raise ValueError(
                f"the policy takes observations of {self.observation_size} numbers, and these have "
                f"the shape {x.shape}: evaluate it on the environment it was trained on "
                f"({self.env_id})"
            )
        if x.ndim > 1:
            return self.network.decide(x, state)
        actions, state = self.network.decide(x[None], state)
        return actions[0], state

    def predict(self, observations: ArrayLike) -> Array:
        """Return the deterministic actions (..., K) for observations (..., D).

        Raises:
            ValueError: if the policy has a memory.
        """
        if self.network.memory_size:
            raise ValueError("the policy has a memory: use start and decide")
        x = np.asarray(observations, dtype=np.float32)
        return self.decide(x, self.start(x.shape[0] if x.ndim > 1 else 1))[0]

    @classmethod
    def load(cls, path: str | Path) -> NumpyPolicy:
        """Read a policy file; raise ValueError if it is foreign, damaged or inconsistent."""
        try:
            return cls.from_arrays(read_arrays(Path(path)))
        except FileNotFoundError:
            raise FileNotFoundError(f"no policy file {path}: check the path") from None
        except Exception as error:  # a damaged archive can fail in any of its readers
            raise ValueError(
                f"{path} is not a policy of kfenv or is damaged ({_first_line(error)}): "
                "give the policy.npz that `kfenv train` wrote"
            ) from error

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> NumpyPolicy:
        """Build the policy from the arrays of its file; raise unless they belong together."""
        form = str(arrays["format"])
        if form == FORMER_FORMAT:
            about = {name: json.loads(str(arrays[name])) for name in ("env_kwargs", "metadata")}
            about |= {"env_id": str(arrays["env_id"]), "features": [], "knobs": []}
            kind: type[Network] = ActionNetwork
        elif form == FORMAT:
            about = json.loads(str(arrays["about"]))
            kind = KINDS[str(arrays["kind"])]
        else:
            raise ValueError(f"its format is {form}, not {FORMAT}")
        knobs = tuple(Knob(*knob) for knob in about.pop("knobs"))
        features = tuple(about.pop("features"))
        network = kind.from_arrays(arrays, knobs)
        return cls(network, knobs=knobs, features=features, **about)


def write_policy(
    path: str | Path, network: Mapping[str, NDArray[Any]], about: Mapping[str, Any]
) -> Path:
    """Write a policy file, which `NumpyPolicy.load` reads, and return its path.

    Args:
        path: of the file.
        network: its ``kind`` and its arrays, named as in `networks`.
        about: ``env_id``, ``env_kwargs`` and, if known, ``features`` (names), ``knobs`` (each
            with name, low and high) and ``metadata``, all of it plain JSON. The same policy gives
            the same bytes.

    Raises:
        ValueError, KeyError, TypeError: if they do not make a policy; no file is written.
    """
    told = {"features": [], "knobs": [], "metadata": {}} | dict(about)
    told["knobs"] = [astuple(k) if isinstance(k, Knob) else tuple(k) for k in told["knobs"]]
    arrays = {"format": FORMAT, "about": json.dumps(told), **network}
    NumpyPolicy.from_arrays(arrays)
    write_arrays(Path(path), arrays)
    return Path(path)


def write_perceptron(
    path: str | Path,
    layers: Sequence[Sequence[ArrayLike]],
    actions: int,
    env_id: str,
    env_kwargs: Mapping[str, Any],
    activation: str = "tanh",
) -> Path:
    """Write a multilayer perceptron that any library has trained as a policy file.

    Args:
        path: of the file.
        layers: weight (outputs, inputs) and bias (outputs,) of each, as torch has them.
        actions: how many of the last one's outputs are the actions, which are clipped to -1 and
            1; what follows (deviations, often) is left out.
        env_id, env_kwargs: what it was trained on.
        activation: between the layers, "tanh" or "relu".

    Raises:
        ValueError: if they do not make a policy; no file is written.
    """
    ones = np.ones(actions, np.float32)
    network = {"kind": "mlp", "algorithm": "ppo", "activation": activation, "layers": len(layers),
               "low": -ones, "high": ones}  # fmt: skip
    for i, (weight, bias) in enumerate(layers):
        rows = slice(actions) if i == len(layers) - 1 else slice(None)
        network |= {
            f"weight_{i}": np.asarray(weight)[rows].T, f"bias_{i}": np.asarray(bias)[rows]
        }  # fmt: skip
    return write_policy(path, network, {"env_id": env_id, "env_kwargs": dict(env_kwargs)})


def _first_line(error: Exception) -> str:
    return excerpt((str(error).splitlines() or [type(error).__name__])[0].rstrip("."))
