"""What a policy expects and promises, for people and for programs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from kfenv.envs.knobs import FADING, OUTLIER_WEIGHT, PROCESS_NOISE, Knob
from kfenv.envs.loop import Loop
from kfenv.envs.statistics import BOUND
from kfenv.envs.wording import factor, table

from ..contestants.channelwise import ChannelwiseNetwork
from ..contestants.networks import MOST_DEVIATIONS, ActionNetwork
from ..contestants.policy import NumpyPolicy
from .deployable import Deployable

FORMAT = "kfenv-contract-1"


def contract(deployable: Deployable) -> dict[str, Any]:
    """The contract of a policy, plain JSON."""
    policy, loop = deployable.policy, deployable.loop
    return {
        "format": FORMAT,
        "policy": {"digest": policy.digest, "kind": policy.network.kind},
        "trained_on": {"env_id": policy.env_id, "env_kwargs": policy.env_kwargs},
        "decision": _decision(loop),
        "filter": _filter(loop),
        "observation": _observation(policy, loop),
        "memory": {
            "size": policy.network.memory_size,
            "start": 0.0,
            "meaning": "hand each decision the memory that the one before gave; zeros at first",
        },
        "action": "for a knob from low to high: factor = high^a for a >= 0, low^-a for a < 0",
        "knobs": [
            {"name": k.name, "low": k.low, "high": k.high, "multiplies": multiplies(k, loop)}
            for k in loop.knobs
        ],
    }


def page(told: dict[str, Any]) -> str:
    """The contract as Markdown."""
    decision, memory, trained = told["decision"], told["memory"], told["trained_on"]
    knobs = [
        (k["name"], f"{factor(k['low'])} to {factor(k['high'])}", k["multiplies"])
        for k in told["knobs"]
    ]
    channels = [
        (c["name"], c["unit"], c["group"], "yes" if c["angle"] else "no")
        for c in told["filter"]["channels"]
    ]
    features = [
        (str(i), f["name"], f"{f['low']:g} to {f['high']:g}", _normalised(f))
        for i, f in enumerate(told["observation"])
    ]
    sections = (
        f"# A policy that tunes a Kalman filter\n\nTrained on `{trained['env_id']}` with "
        f"`{json.dumps(trained['env_kwargs'])}`; digest `{told['policy']['digest'][:16]}`.",
        "## When it decides\n\n" + decision["meaning"],
        f"## The filter\n\nStates: {_states(told)}. Errors are scaled by "
        f"{told['filter']['error_scale']:g}.\n\n"
        + table(("Channel", "Unit", "Group", "Wrapped"), channels),
        "## Knobs\n\n" + table(("Knob", "Factor", "Multiplies"), knobs) + f"\n\nAn action a is "
        f"the logarithm of that: {told['action']}.",
        f"## Memory\n\n{memory['size']} numbers: {memory['meaning']}."
        if memory["size"] else "## Memory\n\nNone.",
        "## Observation\n\nAll components are pure numbers; innovations are formed with nominal "
        "knobs, and logarithms are natural. The network itself normalises: hand it the raw "
        "components.\n\n" + table(("Index", "Meaning", "Bounds", "Normalised in it"), features),
    )  # fmt: skip
    return "\n\n".join(sections) + "\n"


def multiplies(knob: Knob, loop: Loop) -> str:
    """What a knob's factor multiplies."""
    sensor, motion = loop.scenario.sensor, loop.scenario.motion
    process = f"_{PROCESS_NOISE.name}"
    if knob.name == FADING:
        return "the propagated covariance F P F^T, at instants of the sensor's"
    if knob.name == PROCESS_NOISE.name:
        return "the covariance Q of the process noise"
    if knob.name == OUTLIER_WEIGHT.name:
        return "the odds that a Gaussian sum gives an outlier"
    if knob.name.removesuffix(process) in motion.groups and knob.name.endswith(process):
        states = [s.name for s in motion.states if s.group == knob.name.removesuffix(process)]
        return f"the process noise's covariance of {', '.join(states)}, on top of {process[1:]}"
    if knob.name in [channel.name for channel in sensor.channels]:
        return f"the told standard deviation of {knob.name}, on top of its group's knob"
    group = knob.name.removesuffix("_noise")
    channels = [channel.name for channel in sensor.channels if channel.group == group]
    return f"the told standard deviation of {', '.join(channels)}"


def _decision(loop: Loop) -> dict[str, Any]:
    steps, rate = loop.interval, loop.scenario.rate
    return {
        "filter_steps": steps,
        "usual_seconds": steps / rate,
        "meaning": f"Before the update, every {steps} filter steps (usually {steps / rate:g} s): "
        "predict, form the innovation with nominal knobs, observe, decide, and update with the "
        "knobs, which hold until the next decision.",
    }


def _filter(loop: Loop) -> dict[str, Any]:
    motion, sensor = loop.scenario.motion, loop.scenario.sensor
    return {
        "motion": motion.name,
        "states": [{"name": s.name, "unit": s.unit} for s in motion.states],
        "sensor": sensor.name,
        "channels": [
            {"name": c.name, "unit": c.unit, "group": c.group, "angle": c.angle}
            for c in sensor.channels
        ],
        "error_scale": loop.scenario.error_scale,
    }


def _observation(policy: NumpyPolicy, loop: Loop) -> list[dict[str, Any]]:
    names, knobs = loop.feature_names(), len(loop.knobs)
    mean, deviation = _standardised(policy)
    bounds = [BOUND] * (len(names) - knobs) + [1.0] * knobs
    rows = []
    for name, bound, centre, spread in zip(names, bounds, mean, deviation, strict=True):
        row: dict[str, Any] = {"name": name, "unit": "1", "low": -bound, "high": bound}
        if spread is not None:
            row |= {"mean": centre, "deviation": spread, "cut_at_deviations": MOST_DEVIATIONS}
        rows.append(row)
    return rows


def _standardised(policy: NumpyPolicy) -> tuple[list[Any], list[Any]]:
    """Mean and deviation by which the network standardises each feature, None where it does not."""
    network = policy.network
    if isinstance(network, ActionNetwork):
        nothing = [None] * policy.observation_size
        return nothing, nothing
    if isinstance(network, ChannelwiseNetwork):
        mean, deviation = np.zeros((2, policy.observation_size))
        mean[network.inputs], deviation[network.inputs] = network.each.mean, network.each.deviation
        return mean.tolist(), deviation.tolist()
    return network.mean.tolist(), network.deviation.tolist()


def _normalised(row: dict[str, Any]) -> str:
    if "mean" not in row:
        return "no"
    return f"(x - {row['mean']:.4g}) / {row['deviation']:.4g}, cut at {row['cut_at_deviations']:g}"


def _states(told: dict[str, Any]) -> str:
    return ", ".join(f"{state['name']} ({state['unit']})" for state in told["filter"]["states"])
