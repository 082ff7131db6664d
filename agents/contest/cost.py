"""What contestants cost: CPU time relative to the bare engine's, within one run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kfenv.envs.loop import make_filter
from kfenv.envs.options import ENGINE
from kfenv.filters.replay import replay
from kfenv.scenarios.recording import Recording

from ..contestants.agent import Contestant
from .rollout import rollout, scenario_and_options
from .watch import WatchedFilter

LEAST = 20  # episodes: with fewer in lock-step Python's own time counts for more than theirs
REPEATS = 2
ENOUGH = 3.0  # s of CPU time, after which nothing is repeated once more


def relative_cost(
    contestant: Contestant,
    env_id: str,
    env_kwargs: dict[str, Any],
    recording: Recording,
    seed: int,
    first: float,
) -> float | None:
    """CPU time of filtering and deciding over that of the engine's predictions and updates.

    Both on the same episodes in lock-step, in this process and in turn, so that the ratio
    tells little of the machine; the least of several times, so that it tells little of its
    load; the first may compile. Scoring is not counted, and looking at the innovation only for
    who sees it.

    Args:
        first: CPU time of a roll-out that is over, s.

    Returns:
        The ratio; None if the episodes are too few to tell.
    """
    if len(recording) < LEAST:
        return None
    own, bare = [first], [_bare(env_id, env_kwargs, recording)]
    while len(own) < 2 or (len(own) <= REPEATS and sum(own[1:]) < ENOUGH):
        own.append(rollout(contestant, env_id, env_kwargs, recording, seed).seconds)
        bare.append(_bare(env_id, env_kwargs, recording))
    return min(own) / min(bare)


def _bare(env_id: str, env_kwargs: dict[str, Any], recording: Recording) -> float:
    """CPU time of the engine's predictions and updates, s."""
    scenario, options = scenario_and_options(env_id, env_kwargs)
    bare = make_filter(scenario, replace(options, filter=ENGINE))
    watched = WatchedFilter(bare, scenario.sensor, len(recording))
    replay(watched, None, recording, keep=False)
    return watched.watch.seconds
