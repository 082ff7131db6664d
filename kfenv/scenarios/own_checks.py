"""What a user's own model is asked before an episode is drawn: one sentence for each mistake."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch
from kfenv.models.probe import probe_sensor
from kfenv.models.turns import undeclared_angles
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]


def find_model(name: str, given: Any, kind: type) -> Any:
    """A model, or that which ``"module:name"`` leads to: it, or a function that makes it.

    Raises:
        ValueError: if it is none.
    """
    found = given
    if isinstance(given, str):
        module, _, attribute = given.partition(":")
        try:
            found = getattr(import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(
                f"{name}={given!r} leads nowhere ({error}): give MODULE:NAME of a module that "
                "Python finds."
            ) from None
        found = found() if callable(found) else found
    if not isinstance(found, kind):
        raise ValueError(
            f"{name} must be a {kind.__name__}, as `kfenv.models.own` makes it, or MODULE:NAME of "
            f"one, got {given!r}."
        )
    return found


def check_scored(motion: Motion, scored: Any, scored_rates: Sequence[str], scale: Any) -> None:
    """Complain if what is scored, or its scale, does not suit the model.

    Raises:
        ValueError: naming it and the remedy.
    """
    names = [state.name for state in motion.states]
    if isinstance(scored, Sensor):
        probe_sensor(scored, len(names))
        components = scored.channels
        if scored.inputs:
            raise ValueError("scored must be a sensor without inputs: only the state is known.")
    else:
        if not scored or isinstance(scored, str):
            raise ValueError(
                f"scored must name the states whose error counts, out of {', '.join(names)}, as "
                f"a tuple, or be a sensor of what counts; got {scored!r}."
            )
        for name in (*scored, *scored_rates):
            if name not in names:
                raise ValueError(unknown("state to be scored", name, names))
        components = [motion.states[names.index(name)] for name in scored]
    if scored_rates and len(scored_rates) != len(components):
        raise ValueError(
            f"scored_rates must name a state for each of the {len(components)} scored, or none, "
            f"got {scored_rates!r}."
        )
    numbers = [scale] if is_number(scale) or scale is None else list(scale)
    if not all(is_number(value) and value > 0.0 for value in numbers):
        raise ValueError(
            "scale must be the error that is just good enough, a positive number, or one for each "
            f"that is scored; got {scale!r}."
        )
    if not is_number(scale) and len(numbers) != len(components):
        raise ValueError(f"scale has {len(numbers)} numbers for {len(components)} scored.")
    units = {component.unit for component in components}
    if is_number(scale) and len(units) > 1:
        told = ", ".join(f"{c.name} ({c.unit})" for c in components)
        raise ValueError(f"scale must be one number for each of {told}, whose units differ.")


def check_recorded(recording: Any, motion: Motion, sensor: Sensor) -> None:
    """Complain if a recording is none, or an angle in it was not declared as one.

    Raises:
        ValueError: naming it and the remedy.
    """
    if not isinstance(recording, Recording):
        raise ValueError(
            f"recording must be a kfenv Recording, got {type(recording).__name__}: see "
            "`kfenv.scenarios.own.recording_of`."
        )
    fits = recording.measurement.shape[2] == len(sensor.channels)
    if fits and recording.truth is not None and recording.truth.shape[2] == len(motion.states):
        told = np.moveaxis(recording.sensor_inputs, -1, 0)
        exact = sensor.build(batch)(tuple(np.moveaxis(recording.truth, -1, 0)), tuple(told))
        shape = recording.measurement.shape[:2]
        check_angles(sensor, np.stack([np.broadcast_to(c, shape) for c in exact], axis=-1))


def check_angles(sensor: Sensor, exact: Array) -> None:
    """Complain of a channel that jumps by a turn in exact measurements (B, T, m), yet is no angle.

    Raises:
        ValueError: naming it and the remedy.
    """
    for channel, values in zip(sensor.channels, np.moveaxis(exact, -1, 0), strict=True):
        jump = np.abs(np.diff(values, axis=1)).max(initial=0.0)
        if channel.unit == "rad" and not channel.angle and abs(jump - 2.0 * np.pi) < 1.0:
            raise ValueError(
                f"The channel {channel.name!r} jumps by a turn and is not declared an angle: make "
                f"it Component({channel.name!r}, 'rad', angle=True)."
            )


def warn_of_angles(motion: Motion, sensor: Sensor) -> None:
    """Warn of states and channels that behave as angles and are not declared so."""
    found = undeclared_angles(motion, sensor)
    if found:
        are = "are angles" if len(found) > 1 else "is an angle"
        warnings.warn(
            f"The {', the '.join(found)} {are}, since a turn more changes nothing, and not "
            "declared so: make it Component(NAME, 'rad', angle=True), or its differences are not "
            "wrapped.",
            stacklevel=2,
        )
