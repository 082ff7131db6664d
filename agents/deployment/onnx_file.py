"""A policy as an ONNX model, built from its arrays: no torch needed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.knobs import Knob

from ..contestants.channelwise import ChannelwiseNetwork, sharing
from ..contestants.networks import MOST_DEVIATIONS, ActionNetwork, FactorNetwork, Gru
from ..contestants.policy import NumpyPolicy
from .deployable import Deployable

OPSET, IR = 17, 8  # of 2022: what is older runs it not, what is newer does
BATCH = "batch"


class Graph:
    """Nodes and constants as they are added; each operation returns its output's name."""

    def __init__(self, helper: Any, numpy_helper: Any) -> None:
        self._node, self._tensor = helper.make_node, numpy_helper.from_array
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, kind: type = np.float32) -> str:
        """An array of the file's."""
        name = f"constant_{len(self.constants)}"
        array = np.ascontiguousarray(value, dtype=kind)
        self.constants.append(self._tensor(array, name))
        return name

    def add(self, operation: str, *inputs: str, output: str | None = None, **more: Any) -> str:
        """A node of one output."""
        output = output or f"value_{len(self.nodes)}"
        self.nodes.append(self._node(operation, inputs, [output], **more))
        return output

    def split(self, x: str, sizes: Sequence[int]) -> list[str]:
        """Parts of the last of two axes."""
        names = [f"{x}_{i}" for i in range(len(sizes))]
        self.nodes.append(self._node("Split", [x, self.constant(sizes, np.int64)], names, axis=1))
        return names

    def affine(self, x: str, weight: NDArray, bias: NDArray) -> str:
        """x W + b."""
        product = self.add("MatMul", x, self.constant(weight))
        return self.add("Add", product, self.constant(bias))

    def between(self, x: str, low: NDArray, high: NDArray, output: str | None = None) -> str:
        """x cut to bounds of its last axis."""
        least = self.add("Max", x, self.constant(low))
        return self.add("Min", least, self.constant(high), output=output)


def onnx_model(deployable: Deployable, about: dict[str, Any]) -> bytes:
    """The serialised model of a policy.

    Inputs are ``observation`` (batch, D), raw, and, of a policy with memory, ``memory``
    (batch, H), zeros at first; outputs ``action`` (batch, K), ``knobs`` (batch, K), the factors
    that it sets, and ``next_memory`` (batch, H). All are float32.

    Args:
        deployable: what is exported.
        about: goes into the model's properties, as JSON named ``kfenv_contract``.

    Raises:
        ValueError: if the package onnx is not installed.
    """
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError:
        raise ValueError("ONNX needs the package onnx: pip install 'kfenv[export]'.") from None
    policy, graph = deployable.policy, Graph(helper, numpy_helper)
    action, memory = _decision(graph, policy)
    _factors(graph, deployable.loop.knobs, action)
    sizes = {"observation": policy.observation_size}
    sizes |= dict.fromkeys(("action", "knobs"), policy.action_size)
    if memory is not None:
        sizes |= dict.fromkeys(("memory", "next_memory"), policy.network.memory_size)
    ends = {
        name: helper.make_tensor_value_info(name, TensorProto.FLOAT, [BATCH, size])
        for name, size in sizes.items()
    }
    inputs = [ends.pop(name) for name in ("observation", "memory") if name in ends]
    made = helper.make_graph(graph.nodes, "policy", inputs, [*ends.values()], graph.constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    model.producer_name = "kfenv"
    helper.set_model_props(model, {"kfenv_contract": json.dumps(about)})
    checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _decision(graph: Graph, policy: NumpyPolicy) -> tuple[str, str | None]:
    """Names of the action and of the next memory, which is None without any."""
    network = policy.network
    if isinstance(network, ActionNetwork):
        return _perceptron(graph, network), None
    memory = "memory" if network.memory_size else None
    if isinstance(network, ChannelwiseNetwork):
        logs, memory = _by_channel(graph, network, memory)
    else:
        logs, memory = _log_factors(graph, network, "observation", memory, "next_memory")
    up = graph.add("Div", logs, graph.constant(network.knob_high))
    down = graph.add("Div", logs, graph.constant(-network.knob_low))
    rises = graph.add("GreaterOrEqual", logs, graph.constant(np.zeros(1)))
    action = graph.add("Where", rises, up, down)
    ones = np.ones(policy.action_size)
    return graph.between(action, -ones, ones, output="action"), memory


def _perceptron(graph: Graph, network: ActionNetwork) -> str:
    hidden, x = {"tanh": "Tanh", "relu": "Relu"}[network.activation], "observation"
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        x = graph.add(hidden, graph.affine(x, weight, bias))
    x = graph.affine(x, network.weights[-1], network.biases[-1])
    if network.algorithm != "sac":
        return graph.between(x, network.low, network.high, output="action")
    half = graph.constant(0.5 * (network.high - network.low))
    middle = graph.constant(0.5 * (network.high + network.low))
    return graph.add("Add", graph.add("Mul", graph.add("Tanh", x), half), middle, output="action")


def _log_factors(
    graph: Graph, network: FactorNetwork, seen: str, memory: str | None, output: str | None
) -> tuple[str, str | None]:
    """See `FactorNetwork.log_factors`; the next memory's name is `output`, if that is told."""
    centred = graph.add("Sub", seen, graph.constant(network.mean))
    z = graph.add("Div", centred, graph.constant(network.deviation))
    ends = np.full(network.observation_size, MOST_DEVIATIONS)
    z = graph.between(z, -ends, ends)
    x = graph.add("Tanh", graph.affine(z, network.weight_in, network.bias_in))
    if network.gru is not None and memory is not None:
        memory = _recur(graph, network.gru, x, memory, output)
        x = graph.add("Concat", memory, x, axis=1)
    x = graph.add("Tanh", graph.affine(x, network.weight_mid, network.bias_mid))
    x = graph.affine(x, network.weight_out, network.bias_out)
    return graph.between(x, network.log_low, network.log_high), memory


def _recur(graph: Graph, gru: Gru, x: str, memory: str, output: str | None) -> str:
    """See `Gru.step`."""
    size = gru.weight_hh.shape[0]
    new = graph.split(graph.affine(x, gru.weight_ih, gru.bias_ih), [size] * 3)
    old = graph.split(graph.affine(memory, gru.weight_hh, gru.bias_hh), [size] * 3)
    reset, keep = (
        graph.add("Sigmoid", graph.add("Add", a, b)) for a, b in zip(new[:2], old[:2], strict=True)
    )
    candidate = graph.add("Tanh", graph.add("Add", new[2], graph.add("Mul", reset, old[2])))
    change = graph.add("Mul", keep, graph.add("Sub", memory, candidate))
    return graph.add("Add", candidate, change, output=output)


def _by_channel(
    graph: Graph, network: ChannelwiseNetwork, memory: str | None
) -> tuple[str, str | None]:
    """See `ChannelwiseNetwork.decide`."""
    each, (sets, features) = network.each, network.inputs.shape
    places = graph.constant(network.inputs.ravel(), np.int64)
    seen = graph.add("Gather", "observation", places, axis=1)
    seen = graph.add("Reshape", seen, graph.constant([-1, features], np.int64))
    if memory is not None:
        memory = graph.add("Reshape", memory, graph.constant([-1, each.memory_size], np.int64))
    wanted, held = _log_factors(graph, each, seen, memory, None)
    wide = graph.constant([-1, sets * each.action_size], np.int64)
    wanted = graph.add("Reshape", wanted, wide)
    if held is not None:
        whole = graph.constant([-1, network.memory_size], np.int64)
        held = graph.add("Reshape", held, whole, output="next_memory")
    shares = graph.constant(sharing(network.outputs, network.action_size))
    return graph.add("MatMul", wanted, shares), held


def _factors(graph: Graph, knobs: Sequence[Knob], action: str) -> None:
    """The factors of the knobs that an action sets, see `kfenv.envs.knobs.Knob`."""
    low, high = np.log([[knob.low, knob.high] for knob in knobs]).T
    rises = graph.add("GreaterOrEqual", action, graph.constant(np.zeros(1)))
    up = graph.add("Mul", action, graph.constant(high))
    down = graph.add("Mul", action, graph.constant(-low))
    graph.add("Exp", graph.add("Where", rises, up, down), output="knobs")
