"""The networks that a policy file may hold, evaluated by NumPy alone.

All map observations (B, D) and a memory (B, H) to actions (B, K) and the next memory. All
their numbers are float32.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.envs.knobs import Knob

ACTIVATIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
ALGORITHMS = ("ppo", "sac")
MEMORYLESS, RECURRENT = "mlp-log-factors", "gru"
MOST_DEVIATIONS = 5.0  # at which a standardised feature is cut
LARGEST = 1e9  # of a network's numbers: what is larger can make NaN of float32 sums

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ActionNetwork:
    """A multilayer perceptron from observations to actions, as PPO and SAC train it.

    PPO's mean action is clipped to the action space; SAC's goes through tanh and is then scaled to
    it.
    """

    kind: ClassVar[str] = "mlp"
    memory_size: ClassVar[int] = 0
    algorithm: str
    activation: str
    weights: tuple[Array, ...]  # (inputs, outputs) of each layer
    biases: tuple[Array, ...]
    low: Array  # (K,) bounds of the action space
    high: Array

    def __post_init__(self) -> None:
        """Raise ValueError unless the parts fit each other."""
        if self.algorithm not in ALGORITHMS or self.activation not in ACTIVATIONS:
            raise ValueError(
                f"unknown algorithm or activation: {self.algorithm}, {self.activation}"
            )
        if not self.weights:
            raise ValueError("it has no layers")
        inputs = self.weights[0].shape[:1]
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            _check_shape(f"bias_{i}", bias, (bias.size,))
            _check_shape(f"weight_{i}", weight, (*inputs, bias.size))
            inputs = bias.shape
        _check_bounds("action bounds", self.low, self.high, inputs)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], knobs: Sequence[Knob]) -> ActionNetwork:
        """Take the network out of a file's arrays; the knobs do not matter to it."""
        layers = range(int(arrays["layers"]))
        return cls(
            str(arrays["algorithm"]),
            str(arrays["activation"]),
            tuple(_numbers(arrays, f"weight_{i}") for i in layers),
            tuple(_numbers(arrays, f"bias_{i}") for i in layers),
            _numbers(arrays, "low"),
            _numbers(arrays, "high"),
        )

    @property
    def observation_size(self) -> int:
        """D."""
        return self.weights[0].shape[0]

    @property
    def action_size(self) -> int:
        """K."""
        return self.weights[-1].shape[1]

    @property
    def parameters(self) -> tuple[Array, ...]:
        """All that training chose."""
        return (*self.weights, *self.biases)

    def decide(self, observations: Array, memory: Array) -> tuple[Array, Array]:
        """Deterministic actions (B, K), and the memory (B, 0) as it was."""
        hidden_layer, x = ACTIVATIONS[self.activation], observations
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = hidden_layer(x @ weight + bias)
        x = x @ self.weights[-1] + self.biases[-1]
        if self.algorithm == "sac":
            return self.low + 0.5 * (np.tanh(x) + 1.0) * (self.high - self.low), memory
        return np.clip(x, self.low, self.high), memory


@dataclass(frozen=True)
class Gru:
    """A gated recurrent unit with PyTorch's conventions.

    Its weights are PyTorch's transposed, (H, 3 H), with the gates in the order r, z, n
    (Cho et al. 2014, with the reset gate after the multiplication).
    """

    weight_ih: Array
    weight_hh: Array
    bias_ih: Array  # (3 H,)
    bias_hh: Array

    def step(self, x: Array, memory: Array) -> Array:
        """The next memory (B, H) for inputs (B, H)."""
        size = memory.shape[1]
        new = x @ self.weight_ih + self.bias_ih
        old = memory @ self.weight_hh + self.bias_hh
        gates = _sigmoid(new[:, : 2 * size] + old[:, : 2 * size])
        reset, keep = gates[:, :size], gates[:, size:]
        candidate = np.tanh(new[:, 2 * size :] + reset * old[:, 2 * size :])
        return candidate + keep * (memory - candidate)


@dataclass(frozen=True)
class FactorNetwork:
    """A network from raw observations to the logarithms of the knobs' factors.

    The observations are standardised and cut; a tanh layer of H units follows, then, unless
    `gru` is None, a recurrent unit, whose memory stands beside that layer's output; another tanh
    layer of H units, and a linear one, whose outputs are clipped to what the policy may set.
    """

    mean: Array  # (D,) of each feature
    deviation: Array  # (D,)
    weight_in: Array  # (D, H)
    bias_in: Array  # (H,)
    gru: Gru | None
    weight_mid: Array  # (2 H, H), or (H, H) without memory
    bias_mid: Array
    weight_out: Array  # (H, K)
    bias_out: Array
    log_low: Array  # (K,) bounds of the log factors
    log_high: Array
    knob_low: Array  # (K,) logarithms of the knobs' ends
    knob_high: Array

    def __post_init__(self) -> None:
        """Raise ValueError unless the parts fit each other."""
        d, h, k = self.mean.size, self.bias_in.size, self.bias_out.size
        beside = h if self.gru is None else 2 * h
        shapes: dict[str, tuple[int, ...]] = {
            "mean": (d,), "deviation": (d,), "weight_in": (d, h), "bias_in": (h,),
            "weight_mid": (beside, h), "bias_mid": (h,), "weight_out": (h, k), "bias_out": (k,),
            "knob_low": (k,), "knob_high": (k,),
        }  # fmt: skip
        for name, shape in shapes.items():
            _check_shape(name, getattr(self, name), shape)
        if self.gru is not None:
            for item in fields(Gru):
                shape = (h, 3 * h) if item.name.startswith("weight") else (3 * h,)
                _check_shape(item.name, getattr(self.gru, item.name), shape)
        if not (self.deviation > 0.0).all():
            raise ValueError("the deviation of a feature is not positive")
        _check_bounds("bounds of the log factors", self.log_low, self.log_high, (k,))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], knobs: Sequence[Knob]) -> FactorNetwork:
        """Take the network out of a file's arrays."""
        recurrent = str(arrays["kind"]) == RECURRENT
        gru = Gru(**{i.name: _numbers(arrays, i.name) for i in fields(Gru)}) if recurrent else None
        ends = np.log([[knob.low, knob.high] for knob in knobs]).astype(np.float32)
        own = ("gru", "knob_low", "knob_high")
        named = {i.name: _numbers(arrays, i.name) for i in fields(cls) if i.name not in own}
        low, high = ends.reshape(-1, 2).T
        return cls(**named, gru=gru, knob_low=low, knob_high=high)

    @property
    def kind(self) -> str:
        """As the file names it."""
        return MEMORYLESS if self.gru is None else RECURRENT

    @property
    def memory_size(self) -> int:
        """H, or 0 without memory."""
        return 0 if self.gru is None else self.bias_in.size

    @property
    def observation_size(self) -> int:
        """D."""
        return self.mean.size

    @property
    def action_size(self) -> int:
        """K."""
        return self.bias_out.size

    @property
    def parameters(self) -> tuple[Array, ...]:
        """All that training chose."""
        own = tuple(value for value in vars(self).values() if isinstance(value, np.ndarray))
        return own if self.gru is None else (*own, *vars(self.gru).values())

    def log_factors(self, observations: Array, memory: Array) -> tuple[Array, Array]:
        """The logarithms (B, K) of the factors that the knobs should take."""
        z = (observations - self.mean) / self.deviation
        z = np.minimum(np.maximum(z, -MOST_DEVIATIONS), MOST_DEVIATIONS)
        x = np.tanh(z @ self.weight_in + self.bias_in)
        if self.gru is not None:
            memory = self.gru.step(x, memory)
            x = np.concatenate((memory, x), axis=1)
        x = np.tanh(x @ self.weight_mid + self.bias_mid) @ self.weight_out + self.bias_out
        return np.minimum(np.maximum(x, self.log_low), self.log_high), memory

    def decide(self, observations: Array, memory: Array) -> tuple[Array, Array]:
        """Deterministic actions (B, K) and the next memory; see `kfenv.envs.knobs.Knob`."""
        x, memory = self.log_factors(observations, memory)
        return actions_of(x, self.knob_low, self.knob_high), memory


def actions_of(log_factors: Array, low: Array, high: Array) -> Array:
    """The actions that set log factors (B, K), from the logarithms of the knobs' ends (K,)."""
    actions = np.where(log_factors >= 0.0, log_factors / high, log_factors / -low)
    return np.minimum(np.maximum(actions, -1.0), 1.0)


def _sigmoid(x: Array) -> Array:
    """Without overflow at either end."""
    return 0.5 * np.tanh(0.5 * x) + 0.5


def _numbers(arrays: Mapping[str, ArrayLike], name: str) -> Array:
    """One of the arrays as float32."""
    given = np.asarray(arrays[name])
    if given.dtype.kind != "f":
        raise ValueError(f"{name} holds {given.dtype}, not real numbers")
    if not (np.abs(given) <= LARGEST).all():
        raise ValueError(f"a number in {name} is not finite or beyond {LARGEST:g}")
    return np.ascontiguousarray(given, dtype=np.float32)


def _check_shape(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape or 0 in shape:
        raise ValueError(f"{name} has the shape {array.shape}, where {shape} belongs")


def _check_bounds(what: str, low: Array, high: Array, shape: tuple[int, ...]) -> None:
    if low.shape != shape or high.shape != shape:
        raise ValueError(f"{shape[0]} actions, but {what} of shape {low.shape} and {high.shape}")
    if not (low < high).all():
        raise ValueError(f"the {what} are not below each other")
