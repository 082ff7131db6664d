"""A trained policy as plain arrays, evaluated by NumPy alone."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..files import written_whole

FORMAT = "kfenv-policy-1"
ACTIVATIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
ALGORITHMS = ("ppo", "sac")

Array = NDArray[np.float32]


@dataclass(frozen=True)
class NumpyPolicy:
    """A multilayer perceptron from observations to actions, without a learning library.

    PPO's mean action is clipped to the action space; SAC's goes through tanh and is then scaled to
    it. `load` reads the file that `export_policy` writes.
    """

    algorithm: str
    activation: str
    weights: tuple[Array, ...]  # (inputs, outputs) of each layer
    biases: tuple[Array, ...]
    low: Array  # (a,) bounds of the action space
    high: Array
    env_id: str
    env_kwargs: dict[str, Any]
    metadata: dict[str, Any]

    @property
    def observation_size(self) -> int:
        """Length of one observation."""
        return self.weights[0].shape[0]

    @property
    def action_size(self) -> int:
        """Length of one action."""
        return self.weights[-1].shape[1]

    def predict(self, observations: ArrayLike) -> Array:
        """Return the deterministic actions (..., a) for observations (..., o)."""
        x = np.asarray(observations, dtype=np.float32)
        if x.shape[-1:] != (self.observation_size,):
            raise ValueError(
                f"the policy takes observations of {self.observation_size} numbers, and these have "
                f"the shape {x.shape}: evaluate it on the environment it was trained on "
                f"({self.env_id})"
            )
        hidden_layer = ACTIVATIONS[self.activation]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = hidden_layer(x @ weight + bias)
        x = x @ self.weights[-1] + self.biases[-1]
        if self.algorithm == "sac":
            return self.low + 0.5 * (np.tanh(x) + 1.0) * (self.high - self.low)
        return np.clip(x, self.low, self.high)

    @classmethod
    def load(cls, path: str | Path) -> NumpyPolicy:
        """Read a policy file; raise ValueError if it is foreign, damaged or inconsistent."""
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            policy = cls._from_arrays(arrays)
        except FileNotFoundError:
            raise FileNotFoundError(f"no policy file {path}: check the path") from None
        except (
            OSError,
            ValueError,
            TypeError,
            LookupError,
            AttributeError,
            EOFError,
            NotImplementedError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise ValueError(
                f"{path} is not a policy of kfenv or is damaged ({_first_line(error)}): "
                "give the policy.npz that `kfenv train` wrote"
            ) from error
        return policy

    @classmethod
    def _from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> NumpyPolicy:
        """Build the policy from the arrays of its file, and check that they belong together."""
        if str(arrays["format"]) != FORMAT:
            raise ValueError(f"its format is {arrays['format']}, not {FORMAT}")
        layers = range(int(arrays["layers"]))
        policy = cls(
            algorithm=str(arrays["algorithm"]),
            activation=str(arrays["activation"]),
            weights=tuple(arrays[f"weight_{i}"] for i in layers),
            biases=tuple(arrays[f"bias_{i}"] for i in layers),
            low=arrays["low"],
            high=arrays["high"],
            env_id=str(arrays["env_id"]),
            env_kwargs=json.loads(str(arrays["env_kwargs"])),
            metadata=json.loads(str(arrays["metadata"])),
        )
        _check(policy)
        return policy


def export_policy(model: Any, path: str | Path, metadata: Mapping[str, Any]) -> Path:
    """Write the actor of a stable-baselines3 PPO or SAC `model` as plain arrays to `path`.

    `metadata` must hold `env_id` and `env_kwargs`; whatever else it holds is kept. All of it must
    be plain JSON. The same policy gives the same bytes.
    """
    path = Path(path)
    algorithm, layers = type(model).__name__.lower(), _actor_layers(model)
    linear = [layer for layer in layers if hasattr(layer, "weight")]
    rest = {key: value for key, value in metadata.items() if key not in ("env_id", "env_kwargs")}
    arrays: dict[str, Any] = {
        "format": FORMAT,
        "algorithm": algorithm,
        "activation": _activation([layer for layer in layers if not hasattr(layer, "weight")]),
        "layers": len(linear),
        "observation_size": linear[0].weight.shape[1],
        "action_size": linear[-1].weight.shape[0],
        "low": model.action_space.low,
        "high": model.action_space.high,
        "env_id": metadata["env_id"],
        "env_kwargs": json.dumps(metadata["env_kwargs"]),
        "metadata": json.dumps(rest),
    }
    for i, layer in enumerate(linear):
        arrays[f"weight_{i}"] = layer.weight.detach().cpu().numpy().T
        arrays[f"bias_{i}"] = layer.bias.detach().cpu().numpy()
    with written_whole(path) as file:
        np.savez(file, **arrays)
    return path


def _actor_layers(model: Any) -> list[Any]:
    """Return the layers from observation to mean action, in order."""
    algorithm = type(model).__name__.lower()
    if algorithm not in ALGORITHMS or model.use_sde:
        raise ValueError(
            f"cannot export a {type(model).__name__} model: only PPO and SAC with an MlpPolicy and "
            "without state-dependent exploration have a plain form"
        )
    if algorithm == "ppo":
        return [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    return [*model.policy.actor.latent_pi, model.policy.actor.mu]


def _activation(layers: Iterable[Any]) -> str:
    """Return the one activation that all hidden layers share."""
    names = {type(layer).__name__.lower() for layer in layers} or {"tanh"}
    if len(names) > 1 or not names <= ACTIVATIONS.keys():
        raise ValueError(
            f"cannot export the activations {sorted(names)}: use one of {sorted(ACTIVATIONS)}"
        )
    return names.pop()


def _check(policy: NumpyPolicy) -> None:
    """Raise ValueError unless the parts of a policy fit each other."""
    if policy.algorithm not in ALGORITHMS or policy.activation not in ACTIVATIONS:
        raise ValueError(
            f"unknown algorithm or activation: {policy.algorithm}, {policy.activation}"
        )
    if not policy.weights:
        raise ValueError("it has no layers")
    inputs = policy.weights[0].shape[0]
    for weight, bias in zip(policy.weights, policy.biases, strict=True):
        if weight.shape != (inputs, bias.size) or bias.ndim != 1:
            raise ValueError(f"a layer of shape {weight.shape} follows {inputs} numbers")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ValueError("a weight is not finite")
        inputs = bias.size
    if policy.low.shape != (inputs,) or policy.high.shape != (inputs,):
        raise ValueError(f"{inputs} actions, but bounds of shape {policy.low.shape}")


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
