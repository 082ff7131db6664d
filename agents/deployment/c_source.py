"""A policy and its features as C: a header and a source without heap, and a test of both."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kfenv.envs import channels, memory, statistics
from kfenv.envs.loop import Loop
from kfenv.envs.options import FULL
from kfenv.models.yardstick import Yardstick

from ..contestants.channelwise import ChannelwiseNetwork
from ..contestants.networks import MOST_DEVIATIONS, ActionNetwork, FactorNetwork
from .deployable import Deployable
from .golden import Golden, Instant, golden

TEMPLATES = files(__package__) / "templates"
HEADER, SOURCE, TEST, VECTORS = (
    "kfenv_policy.h", "kfenv_policy.c", "kfenv_test.c", "kfenv_golden.h",
)  # fmt: skip
ACTIVATIONS = {"tanh": "(real)tanh(x)", "relu": "x > 0.0 ? x : 0.0"}
OUTPUTS = {
    "ppo": "x[k] > high[k] ? high[k] : x[k] < low[k] ? low[k] : x[k]",
    "sac": "low[k] + 0.5 * (tanh(x[k]) + 1.0) * (high[k] - low[k])",
}
PER_LINE = 8  # numbers


def c_files(deployable: Deployable) -> dict[str, str]:
    """The texts of the files, by name."""
    loop, network = deployable.loop, deployable.policy.network
    parts = _perceptron(network) if isinstance(network, ActionNetwork) else _factors(network)
    known = _sizes(deployable) | _words(deployable) | _constants(loop) | parts
    return {
        HEADER: _filled(HEADER, known),
        SOURCE: _filled(SOURCE, known),
        TEST: _filled(TEST, {}),
        VECTORS: _vectors(golden(deployable)),
    }


def _filled(template: str, known: Mapping[str, Any]) -> str:
    """A template with what is known in place of its @NAMES@."""
    return re.sub(r"@([A-Z_]+)@", lambda m: str(known[m[1]]), (TEMPLATES / template).read_text())


def _sizes(deployable: Deployable) -> dict[str, Any]:
    loop, policy = deployable.loop, deployable.policy
    sensor, rates = loop.scenario.sensor, len(loop.yardstick.rates)
    return {
        "CHANNELS": len(sensor.channels),
        "GROUPS": len(sensor.groups),
        "RATES": rates,
        "ACCELERATIONS": len(memory.accelerations(loop.scenario.motion)) if rates else 0,
        "SINGLE": len(_single(loop)),
        "FEATURES": policy.observation_size,
        "MEMORY": policy.network.memory_size,
        "KNOBS": policy.action_size,
        "INTERVAL": loop.interval,
        "WHITENED_WINDOWS": len(statistics.WINDOWS),
        "BESIDE_WINDOWS": len(channels.WINDOWS),
        "SIGNED_WINDOWS": len(memory.SIGNED),
        "SQUARE_WINDOWS": len(memory.SQUARES),
        "RATIO_WINDOWS": len(memory.RATIOS),
    }


def _words(deployable: Deployable) -> dict[str, str]:
    loop, policy = deployable.loop, deployable.policy
    places = ", ".join(f"KFENV_{_identifier(knob.name)}" for knob in loop.knobs)
    names = ", ".join(f"{c.name} ({c.unit})" for c in loop.scenario.sensor.channels)
    about = f"Trained on {policy.env_id}, digest {policy.digest[:16]}."
    told = {"ABOUT": about, "KNOB_PLACES": places, "CHANNEL_NAMES": names}
    return told | _words_of_yardstick(loop.yardstick, [s.name for s in loop.scenario.motion.states])


def _words_of_yardstick(yardstick: Yardstick, states: Sequence[str]) -> dict[str, str]:
    scored = [component.name for component in yardstick.components]
    rates = [states[place] for place in yardstick.rates]
    if yardstick.weights:
        scored, rates = (
            [f"{weight:.6g} {name}" for weight, name in zip(yardstick.weights, names, strict=False)]
            for names in (scored, rates)
        )
    return {
        "DEVIATION": f"root of the summed variances of {', '.join(scored)}, {yardstick.unit}",
        "RATE_DEVIATION": f"the same of {', '.join(rates)}" if rates else "not used",
        "DISTANCE": f"of {', '.join(scored)} from the axes' origin, from the start in earth-fixed "
        "axes",
        "RATE": f"{', '.join(rates)}, estimated",
    }


def _constants(loop: Loop) -> dict[str, Any]:
    sensor = loop.scenario.sensor
    low, high = np.log([[knob.low, knob.high] for knob in loop.knobs]).T
    return {
        "FULL": int(loop.options.observation == FULL),
        "AXES": channels.AXES,
        "BOUND": _number(statistics.BOUND),
        "MOST": _number(memory.MOST),
        "ERROR_SCALE": _number(loop.scenario.error_scale),
        "SMOOTHING": _number(memory.SMOOTHING),
        "PRODUCTS": _number(memory.PRODUCTS),
        "GROUP_OF": ", ".join(map(str, sensor.group_of_channel)),
        "SIZE_OF": ", ".join(map(str, np.bincount(sensor.group_of_channel))),
        "CHOSEN": ", ".join(map(str, _single(loop))),
        "WHITENED": _numbers(statistics.WINDOWS),
        "BESIDE": _numbers(channels.WINDOWS),
        "SIGNED": _numbers(memory.SIGNED),
        "SQUARES": _numbers(memory.SQUARES),
        "RATIOS": _numbers(memory.RATIOS),
        "LOG_LOW": _numbers(low),
        "LOG_HIGH": _numbers(high),
    }


def _factors(network: FactorNetwork | ChannelwiseNetwork) -> dict[str, str]:
    """Arrays and code of a network of log factors, or of one that looks at several sets."""
    if isinstance(network, ChannelwiseNetwork):
        each, inputs, outputs = network.each, network.inputs, network.outputs
    else:
        each = network
        inputs, outputs = np.arange(each.observation_size), np.arange(each.action_size)
        inputs, outputs = inputs[None], outputs[None]
    own = ("log_low", "log_high", "knob_low", "knob_high")
    named = {name: array for name, array in vars(each).items() if isinstance(array, np.ndarray)}
    named = {name: array for name, array in named.items() if name not in own}
    named |= {"least": each.log_low, "most": each.log_high}
    named |= {"knob_low": network.knob_low, "knob_high": network.knob_high}
    named |= {} if each.gru is None else vars(each.gru)
    sizes = {
        "HIDDEN": each.bias_in.size, "KEPT": each.memory_size, "SETS": len(inputs),
        "SEEN": each.observation_size, "ASKED": each.action_size,
        "CUT": f"((real){_number(MOST_DEVIATIONS)})",
    }  # fmt: skip
    arrays = "".join(f"#define {name} {size}\n" for name, size in sizes.items()) + "\n"
    arrays += _places("seen_by", "SEEN", inputs) + _places("set_by", "ASKED", outputs)
    named["askers"] = np.bincount(outputs.ravel())
    arrays += "".join(_array(name, array) for name, array in named.items())
    return {"ARRAYS": arrays, "NETWORK": _filled("factor_network.c", {})}


def _perceptron(network: ActionNetwork) -> dict[str, str]:
    """Arrays and code of a multilayer perceptron."""
    shapes = [weight.shape for weight in network.weights]
    arrays = _array("low", network.low) + _array("high", network.high)
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        arrays += _array(f"weight_{i}", weight) + _array(f"bias_{i}", bias)
    rows = ",\n".join(f"    {{{n}, {k}, weight_{i}, bias_{i}}}" for i, (n, k) in enumerate(shapes))
    arrays += (
        f"#define WIDEST {max(map(max, shapes))}\n\n"
        "static const struct {\n    int inputs, outputs;\n    const real *weight, *bias;\n"
        f"}} layers[] = {{\n{rows},\n}};\n\n"
    )
    how = {"ACTIVATION": ACTIVATIONS[network.activation], "OUTPUT": OUTPUTS[network.algorithm]}
    return {"ARRAYS": arrays, "NETWORK": _filled("action_network.c", how)}


def _vectors(told: Golden) -> str:
    """Instants, and what the policy makes of them, as a header of static arrays."""
    rows = ",\n".join(f"    {{{_fields(now)}}}" for now in told.instants)
    steps = len(told.instants)
    return (
        f"/* What the policy makes of {steps} steps. Generated by kfenv. */\n"
        f'#include "{HEADER}"\n\n#include <math.h>\n\n#define GOLDEN_STEPS {steps}\n\n'
        f"static const kfenv_instant golden_instants[GOLDEN_STEPS] = {{\n{rows},\n}};\n\n"
        + _table("golden_knobs", "KFENV_KNOBS", told.knobs)
        + _table("golden_observations", "KFENV_FEATURES", told.observations)
    )


def _fields(now: Instant) -> str:
    """An initialiser's fields, without those that a filter does not have."""
    arrays = [np.asarray(value) for value in now]
    texts = (f"{{{_numbers(a)}}}" if a.ndim else _number(a[()]) for a in arrays if a.size)
    return ", ".join(texts)


def _table(name: str, width: str, rows: Iterable[ArrayLike]) -> str:
    body = ",\n".join(f"    {{{_numbers(row)}}}" for row in rows)
    return f"static const double {name}[GOLDEN_STEPS][{width}] = {{\n{body},\n}};\n\n"


def _places(name: str, width: str, rows: NDArray[np.int64]) -> str:
    body = ",\n".join(f"    {{{', '.join(map(str, row))}}}" for row in rows)
    return f"static const int {name}[SETS][{width}] = {{\n{body},\n}};\n\n"


def _array(name: str, array: ArrayLike) -> str:
    """A constant array, a matrix row by row."""
    numbers = [f"{_number(value)}f" for value in np.asarray(array, np.float32).ravel()]
    lines = (", ".join(numbers[i : i + PER_LINE]) for i in range(0, len(numbers), PER_LINE))
    body = ",\n    ".join(lines)
    return f"static const real {name}[{len(numbers)}] = {{\n    {body},\n}};\n\n"


def _numbers(values: ArrayLike) -> str:
    """Numbers, a matrix's rows in braces."""
    array = np.asarray(values)
    if array.ndim > 1:
        return ", ".join(f"{{{_numbers(row)}}}" for row in array)
    return ", ".join(_number(value) for value in array)


def _number(value: Any) -> str:
    """A number that C reads to the same bits; of float32 no more digits than it takes."""
    if np.isnan(value):
        return "NAN"
    text = str(value) if isinstance(value, np.floating) else str(np.float64(value))
    return text if any(sign in text for sign in ".e") else f"{text}.0"


def _single(loop: Loop) -> list[int]:
    """The channels that have a knob of their own, in the order of the knobs."""
    names, knobs = ([part.name for part in parts] for parts in (
        loop.scenario.sensor.channels, loop.knobs))  # fmt: skip
    return [names.index(name) for name in knobs if name in names]


def _identifier(name: str) -> str:
    return re.sub(r"\W", "_", name).upper()
