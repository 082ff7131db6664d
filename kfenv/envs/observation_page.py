"""The section of an environment's page that says what the agent sees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kfenv.envs import memory, statistics
from kfenv.envs.channels import AXES, PER_CHANNEL, channel_features
from kfenv.envs.knobs import knobs_of
from kfenv.envs.wording import listed, paragraphs, table
from kfenv.models.yardstick import Yardstick

ORDINALS = ("first", "second", "third")


def observation_space(scenario: Any) -> str:
    """The features."""
    groups = scenario.sensor.groups
    yardstick = scenario.yardstick
    common = statistics.common_size(yardstick.rates)
    size = len(groups) * statistics.PER_GROUP + common + len(knobs_of(groups))
    several = len(scenario.sensor.channels) > len(groups)
    rows = _feature_rows(groups, several, yardstick)
    sums = """The whitened innovation of a group is the sum over its channels that arrived, over
        the root of their number; squares and shares are means over them."""
    return paragraphs(
        f"""
        ``Box(float32)`` of {size} components with all knobs, all dimensionless:
        {statistics.PER_GROUP} for each of the groups {listed(groups)}
        ({listed(ORDINALS[: len(groups)])} index), {common} common ones, and the
        previous action. Nothing in it needs the truth. Windows are exponential; logarithms are
        natural; the space bounds all components by {-statistics.BOUND:g} and
        {statistics.BOUND:g}, the previous action by -1 and 1. The features of the present (the
        first and the last two of a group) are zero where the {"group" if several else "channel"}
        is missing or nothing is pending. {sums if several else ""}""",
        table(("Index", "Meaning", "Bounds"), rows),
        """
        Deviations are roots of the trace of the covariance predicted with nominal knobs.
        ``env.unwrapped.core.feature_names()`` names every component.""",
        f"""
        Each channel with a knob of its own adds {PER_CHANNEL} features behind the common ones. They
        tell of v, what the other channels leave unexplained of its innovation, over that part's
        deviation: {listed(channel_features())}; the first and the last are zero where it is
        missing.""",
        _with_memory(scenario),
    )


def _with_memory(scenario: Any) -> str:
    """What the full observation has more."""
    sensor, rates = scenario.sensor, scenario.yardstick.rates
    more = len(memory.feature_names(sensor, rates=rates))
    accelerated = f", its acceleration {_acceleration(scenario)}" if rates else ""
    largest = max(np.bincount(sensor.group_of_channel))
    return paragraphs(
        f"""
        ``observation="full"`` puts {more} components more before the
        previous action, and {memory.PER_CHANNEL} more for each channel with a knob of its own: a
        memory that tells faults apart, for learners with and without one of their own. n is an
        innovation over the root of its variance, both with nominal knobs; the signed log of x is
        sign(x) log(1 + abs(x)). Means over arrivals are exponential, and stay while nothing
        arrives; those of squares begin at 1, the others at zero. Zero, where the
        {"channels are" if largest > 1 else "channel is"} missing or nothing is pending, is what is
        told of now, of the told noise or of shares. In this order:""",
        f"""
        - of each group in turn {_signs(largest)}; its {listed(memory.group_features(largest > 1))};
        - in common the {listed(memory.common_features(rates))}. The estimate is the predicted one,
          its distance is from {_origin(scenario)}{accelerated};
        - of each channel with a knob of its own the {listed(memory.of_channel())}.""",
    )


def _signs(largest: int) -> str:
    if largest > AXES:
        told = listed(memory.signed_features()[1:])
        return f"the {told}, with the sum of n over the root of its terms' number in place of n"
    return f"{'for each channel ' if largest > 1 else ''}the {listed(memory.signed_features())}"


def _origin(scenario: Any) -> str:
    start = np.full(len(scenario.yardstick), 4e6)
    moves = scenario.local_frame(start)[0].any()
    return "where the filter believed to start" if moves else "the origin of the axes"


def _acceleration(scenario: Any) -> str:
    if len(memory.accelerations(scenario.motion)):
        return "a part of the state"
    return f"the change of the velocity, smoothed over {memory.SMOOTHING:g} s"


def _feature_rows(
    groups: Sequence[str], several: bool, yardstick: Yardstick
) -> list[tuple[str, str, str]]:
    begin = len(groups) * statistics.PER_GROUP
    action = begin + statistics.common_size(yardstick.rates)
    starts = range(0, begin, statistics.PER_GROUP)
    of_group, common = _group_features(several), _common_features(yardstick)
    rows = [(", ".join(str(s + i) for s in starts), *row) for i, row in enumerate(of_group)]
    rows += [(str(begin + i), *row) for i, row in enumerate(common)]
    places = f"{action} to {action + len(knobs_of(groups)) - 1}"
    return [*rows, (places, "the previous action, one component per exposed knob", "-1 to 1")]


def _group_features(several: bool) -> list[tuple[str, str]]:
    first, *others = (f"{window:g} arrivals" for window in statistics.WINDOWS)
    bounds = f"{-statistics.BOUND:g} to {statistics.BOUND:g}"
    arrived = ("share of the group's channels that arrived", "0 to 1")
    return [
        ("whitened innovation w now: sign(w) log(1 + abs(w))", bounds),
        (f"log of the RMS of w over a window of {first}", bounds),
        *((f"the same over {window}", bounds) for window in others),
        (f"lag-1 correlation of w over {statistics.WINDOWS[-1]:g} arrivals", "-1 to 1"),
        arrived if several else ("whether the channel arrived", "0 or 1"),
        ("share of the told noise in the innovation's variance", "0 to 1"),
    ]


def _common_features(yardstick: Yardstick) -> list[tuple[str, str]]:
    scored, bounds = yardstick.name, f"{-statistics.BOUND:g} to {statistics.BOUND:g}"
    rate = "velocity" if scored == "position" else f"{scored} rate"
    rates = (f"log of the predicted {rate} deviation over a tenth of that per s", bounds)
    return [
        ("log(1 + seconds since anything arrived)", f"0 to {statistics.BOUND:g}"),
        (f"log of the predicted {scored} deviation over the error scale", bounds),
        *([rates] if yardstick.rates else []),
    ]
