"""Knobs of the process noise of single groups of states, beside the one of all states."""

from __future__ import annotations

from collections.abc import Sequence

from kfenv.models.model import Motion


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
