"""Tuning of agents' parameters, the same for all: same episodes, same number of trials."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kfenv.envs.knobs import choose_knobs
from kfenv.scenarios.recording import Recording

from ..contestants.agent import Contestant, Parameter
from .rollout import scenario_and_options
from .yardsticks import ERROR, Array, costs


def tune(
    agent: Contestant,
    env_id: str,
    env_kwargs: dict[str, Any],
    recording: Recording,
    trials: int,
    seed: int,
    advance: Callable[[], None] = lambda: None,
    on: str = ERROR,
    tried: Callable[[dict[str, float], Array], None] = lambda values, costs: None,
) -> Contestant:
    """The agent with the parameters of least mean cost over the tuning episodes.

    On the logarithms of the parameters: a third of the trials are spread over their
    ranges, the rest are CMA-ES from the best of these and the defaults; where there is
    only one parameter, Brent's bounded search. Both may stop early. The mean log weighs
    all episodes alike, however large their errors. An error hardly tells how large covariances
    are, only their ratios: the NIS of an agent tuned on it may be far from 1. A likelihood does.

    Args:
        recording: the tuning episodes.
        trials: how many settings may be tried for each parameter.
        advance: called after each trial.
        on: see `kfenv.agents.contest.yardsticks.costs`; the error by default.
        tried: called with the values of each trial and the episodes' costs.
    """
    scenario, options = scenario_and_options(env_id, env_kwargs)
    own = scenario.motion.groups
    knobs = choose_knobs(None, scenario.sensor.groups, options.mixture, state_groups=own)
    parameters = agent.tunable(scenario, knobs)
    trials *= len(parameters)
    if trials < 1:
        return agent
    low = np.log([p.low for p in parameters])
    span = np.log([p.high for p in parameters]) - low
    start = (np.log([p.default for p in parameters]) - low) / span
    best = (np.inf, start)

    def cost(x: np.ndarray) -> float:
        nonlocal best
        candidate = agent.with_values(_values(parameters, low + span * x))
        each = costs(on, candidate, env_id, env_kwargs, recording, seed)
        tried(candidate.values, each)
        value = float(np.mean(each))
        if value < best[0]:
            best = (value, np.array(x))
        advance()
        return value

    cost(start)
    spread = (trials - 1) // 3 if len(start) > 1 else 0
    for x in np.random.default_rng(seed).uniform(size=(spread, len(start))):
        cost(x)
    _search(cost, best[1], trials - 1 - spread, seed)
    return agent.with_values(_values(parameters, low + span * best[1]))


def _values(parameters: tuple[Parameter, ...], logarithms: np.ndarray) -> dict[str, float]:
    return {p.name: float(np.exp(v)) for p, v in zip(parameters, logarithms, strict=True)}


def _search(cost: Callable, start: np.ndarray, trials: int, seed: int) -> None:
    """Minimise over the unit box with the given number of evaluations."""
    if trials < 1:
        return
    if len(start) == 1:
        from scipy.optimize import minimize_scalar

        minimize_scalar(
            lambda x: cost(np.array([x])), bounds=(0.0, 1.0), method="bounded",
            options={"maxiter": trials},
        )  # fmt: skip
        return
    import cma

    inside = np.clip(start, 0.02, 0.98)
    options = {"bounds": [0.0, 1.0], "seed": seed + 1, "verbose": -9, "maxfevals": trials}
    search = cma.CMAEvolutionStrategy(inside, 0.15, options)
    while trials > 0 and not search.stop():
        candidates = search.ask()[:trials] if trials < search.popsize else search.ask()
        costs = [cost(candidate) for candidate in candidates]
        trials -= len(candidates)
        if len(candidates) == search.popsize:
            search.tell(candidates, costs)
