"""Turns models of stable-baselines3 into policies of plain arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...contestants.networks import ACTIVATIONS, ALGORITHMS, ActionNetwork
from ...contestants.policy import write_policy

OF_ENVIRONMENT = ("env_id", "env_kwargs", "features", "knobs")


def export_policy(model: Any, path: str | Path, metadata: Mapping[str, Any]) -> Path:
    """Write the actor of a stable-baselines3 model as plain arrays to `path`.

    `metadata` must hold `env_id` and `env_kwargs`, and of an environment of kfenv what `layout`
    says; whatever else it holds is kept. All of it must be plain JSON. The same policy gives the
    same bytes.
    """
    about = {key: metadata[key] for key in OF_ENVIRONMENT if key in metadata}
    rest = {key: value for key, value in metadata.items() if key not in OF_ENVIRONMENT}
    taught = getattr(model.policy, "network", None)
    arrays = _arrays(model) if taught is None else taught.arrays()
    return write_policy(path, arrays, {**about, "metadata": rest})


def _arrays(model: Any) -> dict[str, Any]:
    """Those of an `ActionNetwork`."""
    layers = _actor_layers(model)
    linear = [layer for layer in layers if hasattr(layer, "weight")]
    arrays: dict[str, Any] = {
        "kind": ActionNetwork.kind,
        "algorithm": type(model).__name__.lower(),
        "activation": _activation([layer for layer in layers if not hasattr(layer, "weight")]),
        "layers": len(linear),
        "low": model.action_space.low,
        "high": model.action_space.high,
    }
    for i, layer in enumerate(linear):
        arrays[f"weight_{i}"] = layer.weight.detach().cpu().numpy().T
        arrays[f"bias_{i}"] = layer.bias.detach().cpu().numpy()
    return arrays


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
