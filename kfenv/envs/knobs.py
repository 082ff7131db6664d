"""Knobs: what an action turns, on a logarithmic scale whose zero is the nominal filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kfenv.names import unknown

Array = NDArray[np.float64]

MEASUREMENT_NOISE = "measurement_noise"
CHANNEL_NOISE = "channel_noise"


@dataclass(frozen=True)
class Knob:
    """A positive factor set by one component a of the action in [-1, 1].

    The factor is high^a for a >= 0 and low^-a for a < 0: logarithmic on either side,
    and exactly 1 at zero.

    Attributes:
        name: ``"fading"``, ``"process_noise"``, ``"<group>_noise"``,
            ``"<group>_process_noise"`` of a group of states, ``"outlier_weight"`` or that of a
            channel.
        low, high: the factors at -1 and 1, 0 < low < 1 < high.
    """

    name: str
    low: float
    high: float


# Fading and process noise multiply covariances, measurement noise a standard deviation,
# and the outlier weight the odds weight / (1 - weight) that a Gaussian sum gives an outlier.
# A learner explores up to `MOST_FADING`, and the published rules, which ask for thousands
# where fixes are outliers (SPEC 6, E6), get `WIDEST_FADING`.
FADING, LEAST_FADING, MOST_FADING, WIDEST_FADING = "fading", 0.5, 10.0, 1e4
PROCESS_NOISE = Knob("process_noise", 1e-3, 1e4)
NOISE_RANGE = (0.05, 500.0)
OUTLIER_WEIGHT = Knob("outlier_weight", 1e-3, 1e3)


def knobs_of(
    groups: Sequence[str],
    mixture: bool = False,
    most_fading: float = MOST_FADING,
    state_groups: Sequence[str] = (),
) -> tuple[Knob, ...]:
    """The knobs of a filter whose sensor has these channel groups, but for single channels'.

    Args:
        state_groups: of the motion; such a knob multiplies the states' process noise on top of
            the one of all states.
        mixture: whether it is a Gaussian sum, whose outlier weight is the last knob.
        most_fading: upper end of the fading knob.
    """
    noise = tuple(Knob(f"{group}_noise", *NOISE_RANGE) for group in groups)
    fading = Knob(FADING, LEAST_FADING, most_fading)
    low, high = PROCESS_NOISE.low, PROCESS_NOISE.high
    states = tuple(Knob(f"{group}_{PROCESS_NOISE.name}", low, high) for group in state_groups)
    return (fading, PROCESS_NOISE, *noise, *states, *((OUTLIER_WEIGHT,) if mixture else ()))


def knobs_of_channels(channels: Sequence[str]) -> tuple[Knob, ...]:
    """A knob for each channel, which multiplies what its group's knob makes of its noise."""
    return tuple(Knob(channel, *NOISE_RANGE) for channel in channels)


def choose_knobs(
    names: Sequence[str] | None,
    groups: Sequence[str],
    mixture: bool = False,
    channels: Sequence[str] = (),
    most_fading: float = MOST_FADING,
    state_groups: Sequence[str] = (),
) -> tuple[Knob, ...]:
    """The knobs that an environment exposes, in the order of `knobs_of`, then of the channels.

    Args:
        names: knob names, ``"measurement_noise"`` standing for all groups and
            ``"channel_noise"`` for all channels; None for all of `knobs_of`.
        groups, mixture, most_fading, state_groups: as in `knobs_of`.
        channels: names of the channels.

    Raises:
        ValueError: for an unknown name, or if none is left.
    """
    knobs = knobs_of(groups, mixture, most_fading, state_groups)
    if names is None:
        return knobs
    if isinstance(names, str):
        names = (names,)
    shared = [knob.name for knob in knobs]
    knobs += knobs_of_channels(channels)
    several = {
        MEASUREMENT_NOISE: [f"{group}_noise" for group in groups],
        CHANNEL_NOISE: list(channels),
    }
    wanted: set[str] = set()
    for name in names:
        if name not in (*shared, *channels, *several):
            raise ValueError(unknown("action", name, [*shared, *several]))
        wanted.update(several.get(name, [name]))
    if not wanted:
        raise ValueError("actions names no knob: give at least one, or leave it out for all.")
    return tuple(knob for knob in knobs if knob.name in wanted)


def actions_for(factors: Array, knobs: Sequence[Knob]) -> Array:
    """The actions (..., K) that set the given factors (..., K), clipped to the knobs' ranges."""
    logarithm = np.log(factors)
    high = np.log([knob.high for knob in knobs])
    low = np.log([knob.low for knob in knobs])
    return np.clip(np.where(logarithm >= 0.0, logarithm / high, -logarithm / low), -1.0, 1.0)
