"""How far agents drift while a real log's fixes are withheld: horizontally and vertically."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..contestants.registry import make_agent
from .rollout import draw_episodes, rollout, scenario_and_options
from .tuning import tune
from .tuning_costs import ERROR

Array = NDArray[np.float64]

AFTER = (5.0, 10.0, 15.0)  # s


def outage_errors(
    env_id: str, env_kwargs: dict[str, Any], name: str, times: Sequence[float],
    tuning: tuple[int, int] = (0, 0), seed: int = 0, on: str = ERROR,
) -> Array:  # fmt: skip
    """Horizontal and vertical errors (N, 3, 2), m, of an agent 5, 10 and 15 s into N outages.

    Args:
        env_id, env_kwargs: an environment with a log.
        name: of the agent.
        times: of the last fix before each outage, s of the log's clock.
        tuning: trials for each parameter, and outages in the part for training to tune on.
        seed: of the tuning.
        on: what tuning makes small, see `kfenv.agents.contest.tuning_costs.costs`.

    Raises:
        ValueError: if there is no log, or an outage is not within it.
    """
    scenario, _ = scenario_and_options(env_id, env_kwargs)
    if getattr(scenario, "log", None) is None:
        raise ValueError(
            f"{env_id} has outages on a schedule only with a log: give log=[IMU,GNSS]."
        )
    if scenario.outage < AFTER[-1]:
        raise ValueError(
            f"duration={scenario.duration:g} leaves outages of {scenario.outage:g} s, and "
            f"{AFTER[-1]:g} s are told: set duration to 25 or more."
        )
    agent, (trials, episodes) = make_agent(name), tuning
    if trials > 0:
        drawn = draw_episodes(env_id, env_kwargs, "tuning", seed, episodes)
        agent = tune(agent, env_id, env_kwargs, drawn, trials, seed, on=on)
    scores = rollout(agent, env_id, env_kwargs, scenario.outages_at(times), seed, trace=True)
    off = _at(scores.time, scores.off, scenario.duration - scenario.outage + np.array(AFTER))
    return np.stack([np.hypot(off[..., 0], off[..., 1]), np.abs(off[..., 2])], axis=-1)


def _at(time: Array, series: Array, instants: Array) -> Array:
    """A series (D, N, 3) between its times (D,), (N, k, 3)."""
    right = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    share = (instants - time[right - 1]) / (time[right] - time[right - 1])
    between = series[right - 1] + share[:, None, None] * (series[right] - series[right - 1])
    return between.swapaxes(0, 1)
