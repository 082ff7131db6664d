"""Knobs of the process noise of single groups of states, beside the one of all states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from kfenv.filters.results import Prediction
from kfenv.models.model import Motion

Array = NDArray[np.float64]


def places_of_states(motion: Motion, groups: Sequence[str]) -> dict[int, int]:
    """For each state in a group the place of its group's knob in `knobs_of`.

    Args:
        groups: of the sensor.
    """
    own = motion.groups
    return {
        i: 2 + len(groups) + own.index(state.group)
        for i, state in enumerate(motion.states)
        if state.group
    }


def turn_states(prediction: Prediction, factors: Array, places: Mapping[int, int]) -> Prediction:
    """A prediction whose process noise the knobs of single groups of states have turned.

    Args:
        factors: of all knobs, (B, A).
        places: see `places_of_states`.
    """
    if not places:
        return prediction
    deviation = np.ones(prediction.mean.shape)
    for state, place in places.items():
        deviation[:, state] = np.sqrt(factors[:, place])
    return prediction._replace(noise=prediction.noise * deviation[:, :, None])
