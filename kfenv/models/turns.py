"""Which states and channels of a model are angles, found by a turn more of each state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from kfenv.models.model import Motion, Sensor
from kfenv.models.namespaces import batch

Array = NDArray[np.float64]

TURN, PART = 2.0 * np.pi, 2.0  # rad: after the first an angle is itself again, after the other not
TRIAL = np.array([0.3, 0.5, 0.9])  # states at which the models are tried
ROUNDING = 1e-9


def undeclared_angles(motion: Motion, sensor: Sensor) -> list[str]:
    """What is no declared angle, yet the models tell it apart from a turn more in no way.

    A state is one if a turn more of it changes nothing else, and a part of a turn does: it enters
    by its sine and cosine. A channel is one if such a state turns it by whole turns.
    """
    step, measure = motion.build(batch).step, sensor.build(batch)
    u, s = (_constant(len(names)) for names in (motion.inputs, sensor.inputs))
    dt, found = np.full(len(TRIAL), 0.1), []
    for i, state in enumerate(motion.states):
        try:
            moved = _change(lambda x: step(x, u, dt), len(motion.states), i)
            seen = _change(lambda x: measure(x, s), len(motion.states), i)
        except Exception:  # whatever the user's functions do a turn away
            continue
        if not _turns(np.concatenate([moved, seen], axis=1)):
            continue
        found += [] if state.angle else [f"state {state.name!r}"]
        for channel, change in zip(sensor.channels, seen[0], strict=True):
            if not channel.angle and np.abs(change).min() > 1.0:
                found.append(f"channel {channel.name!r}")
    return list(dict.fromkeys(found))


def _constant(count: int) -> tuple[Array, ...]:
    return tuple(np.full(len(TRIAL), 0.1) for _ in range(count))


def _change(function: Callable, states: int, i: int) -> Array:
    """How values change (2, k, trials) by a turn and by a part of one in state i."""
    at = np.outer(np.linspace(1.0, 1.5, states), TRIAL)
    more = np.zeros((states, 1))
    more[i] = 1.0
    with np.errstate(all="ignore"):
        base, turn, part = (
            np.stack(np.broadcast_arrays(*function(tuple(at + angle * more)), TRIAL)[:-1])
            for angle in (0.0, TURN, PART)
        )
    return np.stack([turn - base, part - base])


def _turns(change: Array) -> bool:
    """Whether by a turn all change by whole turns, and by a part some do not in proportion."""
    whole, shares = change[0] / TURN, change[1] / PART
    return bool(
        (np.abs(whole - np.round(whole)) < ROUNDING).all()
        and (np.abs(shares - np.round(whole)) > ROUNDING).any()
    )
