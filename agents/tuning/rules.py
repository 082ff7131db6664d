"""Gates and windows of the classical rules, with intervals from blocks of the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.recording import Recording

from ..contest.rollout import make_core, play, scenario_and_options
from ..contest.tuning import tune
from ..contest.tuning_costs import costs
from ..contestants.agent import Agent
from ..contestants.registry import make_agent

Array = NDArray[np.float64]

RESAMPLES = 2000
FIRED = 1.01  # noise over its least, above which a gate has fired


@dataclass(frozen=True)
class Rule:
    """A tuned rule.

    Attributes:
        name: of the agent.
        values: chosen of its parameters, with what 95 % of resampled logs choose.
        low, high: ends of that.
        cost, nominal_cost: mean on the episodes for the test, of the rule and of the fixed filter.
        fired: share of decisions in which it raised the noise of a group; None for a rule
            without a gate or threshold, whose noise has no resting value.
    """

    name: str
    values: dict[str, float]
    low: dict[str, float]
    high: dict[str, float]
    cost: float
    nominal_cost: float
    fired: float | None


def tune_rule(
    name: str, env_id: str, env_kwargs: dict[str, Any], tuning: Recording, test: Recording,
    on: str, trials: int, seed: int, advance: Callable[[], None] = lambda: None,
) -> Rule:  # fmt: skip
    """Tune an agent on some episodes and look at it on others.

    The intervals are from the block bootstrap: the episodes, which are blocks of the log, are
    drawn anew with replacement, and the best of the settings tried is taken for each draw.

    Raises:
        ValueError: for a contestant that is no agent with parameters.
    """
    agent = make_agent(name)
    if not isinstance(agent, Agent) or not agent.parameters:
        raise ValueError(
            f"{name} has no gate or window to tune: name a rule, such as 'huber-gate' or "
            "'pooled-noise'."
        )
    tried: list[tuple[dict[str, float], Array]] = []
    place = env_id, env_kwargs
    chosen = tune(
        agent, *place, tuning, trials, seed, advance, on,
        lambda values, each: tried.append((values, each)),
    )  # fmt: skip
    names = [p.name for p in agent.parameters]
    settings = np.array([[values[p] for p in names] for values, _ in tried])
    picked = settings[_best_of_resampled(np.array([each for _, each in tried]), seed)]
    low, high = np.quantile(picked, [0.025, 0.975], axis=0)
    return Rule(
        name, {p: chosen.values[p] for p in names},
        dict(zip(names, low.tolist(), strict=True)), dict(zip(names, high.tolist(), strict=True)),
        float(np.mean(costs(on, chosen, *place, test, seed))),
        float(np.mean(costs(on, make_agent("fixed"), *place, test, seed))),
        _fired(chosen, *place, test, seed),
    )  # fmt: skip


def _best_of_resampled(cost: Array, seed: int) -> NDArray[np.int64]:
    """The index of the least mean of costs (settings, episodes) in each resampling."""
    rng, episodes = np.random.default_rng(seed), cost.shape[1]
    weight = rng.multinomial(episodes, np.full(episodes, 1.0 / episodes), RESAMPLES)
    return np.argmin(weight @ cost.T, axis=1)


def _fired(
    agent: Agent, env_id: str, env_kwargs: dict[str, Any], test: Recording, seed: int
) -> float | None:
    """Share of the decisions in which any group's noise is above its least."""
    if not {"gate", "threshold"} & set(agent.values) or "noise" not in agent.values:
        return None
    scenario, options = scenario_and_options(env_id, env_kwargs)
    core = make_core(agent, scenario, options, test, "rmse")
    noise, resting = slice(2, 2 + len(scenario.sensor.groups)), FIRED * agent.values["noise"]
    fired = [(core.factors[:, noise] > resting).any(axis=1) for _ in play(agent, core, test, seed)]
    return float(np.mean(fired))
