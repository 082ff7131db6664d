"""Tuning of agents' parameters, the same for all: same episodes, same number of trials."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from kfenv.envs.knobs import choose_knobs
from kfenv.scenarios.recording import Recording

from ..contestants.agent import Contestant, Parameter
from .rollout import scenario_and_options
from .tuning_costs import ERROR, Array, costs

Steps = Generator[list[Array], list[float], None]

WIDE, NEAR = 0.15, 0.02  # first steps of the evolution, over the parameters' logarithmic ranges


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
    ranges, the rest are CMA-ES from the best of these and the defaults, in small steps if that
    is the defaults (but for the error, whose search frozen suites know); where there is
    only one parameter, Brent's bounded search. Both may stop early. The mean log weighs
    all episodes alike, however large their errors. An error hardly tells how large covariances
    are, only their ratios: the NIS of an agent tuned on it may be far from 1. A likelihood does.

    Args:
        recording: the tuning episodes.
        trials: how many settings may be tried for each parameter.
        advance: called after each trial.
        on: see `kfenv.agents.contest.tuning_costs.costs`; the error by default.
        tried: called with the values of each trial and the episodes' costs.
    """
    search = Search(parameters_of(agent, env_id, env_kwargs), trials, seed, on != ERROR)
    while search.asked:
        for number, values in enumerate(search.asked):
            candidate = agent.with_values(values)
            each = costs(on, candidate, env_id, env_kwargs, recording, seed)
            tried(candidate.values, each)
            advance()
            search.tell(number, float(np.mean(each)))
    return agent.with_values(search.best)


def parameters_of(
    agent: Contestant, env_id: str, env_kwargs: dict[str, Any]
) -> tuple[Parameter, ...]:
    """What tuning may choose of an agent in an environment."""
    scenario, options = scenario_and_options(env_id, env_kwargs)
    own = scenario.motion.groups
    knobs = choose_knobs(None, scenario.sensor.groups, options.mixture, state_groups=own)
    return agent.tunable(scenario, knobs)


class Search:
    """A tuning that asks for the costs of several settings at once, and is told them in any order.

    Args:
        parameters: to be chosen.
        trials: how many settings may be tried for each.
        seed: equal ones ask for the same, if they are told the same.
        near: whether to look near the defaults if nothing far away is better.

    Attributes:
        asked: settings whose costs are asked for; none when the search is over.
        best: the setting of least cost so far; empty where there is nothing to choose.
        costs: of all settings that were asked for before, in their order.
    """

    def __init__(
        self, parameters: tuple[Parameter, ...], trials: int, seed: int, near: bool = False
    ) -> None:
        self._parameters, self._near = parameters, near
        self._low = np.log([p.low for p in parameters])
        self._span = np.log([p.high for p in parameters]) - self._low
        self.best: dict[str, float] = {}
        self.costs: list[float] = []
        self._steps = self._search(trials * len(parameters), seed)
        self._ask(None)

    def tell(self, number: int, cost: float) -> bool:
        """Take the cost of a setting by its number; whether others are then asked for, or none."""
        self._told[number] = cost
        if len(self._told) < len(self.asked):
            return False
        told = [self._told[i] for i in range(len(self.asked))]
        for x, one in zip(self._points, told, strict=True):
            if one < self._least[0]:
                self._least, self.best = (one, np.array(x)), self._values(x)
        self.costs += told
        self._ask(told)
        return True

    def _ask(self, told: list[float] | None) -> None:
        """Go on to the next settings, knowing the costs of the last ones."""
        self._told = {}
        try:
            self._points = self._steps.send(told)
        except StopIteration:
            self._points = []
        self.asked = [self._values(x) for x in self._points]

    def _search(self, trials: int, seed: int) -> Steps:
        """Yields points of the unit box, and is sent their costs."""
        if trials < 1:
            return
        defaults = np.log([p.default for p in self._parameters])
        start = (defaults - self._low) / self._span
        self._least, self.best = (np.inf, start), self._values(start)
        spread = (trials - 1) // 3 if len(start) > 1 else 0
        yield [start, *np.random.default_rng(seed).uniform(size=(spread, len(start)))]
        if len(start) == 1:
            yield from _brent(trials - 1)
        else:
            near = self._near and np.array_equal(self._least[1], start)
            width = NEAR if near else WIDE
            yield from _evolve(self._least[1], trials - 1 - spread, seed, width)

    def _values(self, x: Array) -> dict[str, float]:
        logarithms = self._low + self._span * x
        names = [p.name for p in self._parameters]
        return {n: float(np.exp(v)) for n, v in zip(names, logarithms, strict=True)}


def _brent(trials: int) -> Steps:
    """Minimise over [0, 1] with the given number of evaluations, one at a time.

    SciPy calls for costs where they are yielded here, so its search is begun again with each one
    that is known; it takes the same course.
    """
    from scipy.optimize import minimize_scalar

    known: dict[float, float] = {}
    while trials > 0:
        try:
            minimize_scalar(
                lambda x: known[float(x)], bounds=(0.0, 1.0), method="bounded",
                options={"maxiter": trials},
            )  # fmt: skip
        except KeyError as unknown:
            point = unknown.args[0]
            [known[point]] = yield [np.array([point])]
        else:
            return


def _evolve(start: Array, trials: int, seed: int, width: float) -> Steps:
    """Minimise over the unit box with the given number of evaluations, a generation at a time.

    Args:
        width: deviation of the first generation.
    """
    if trials < 1:
        return
    import cma

    # A generator of its own, since several searches take turns; the numbers are those of cma's.
    randn = np.random.RandomState(seed + 1).randn
    inside = np.clip(start, 0.02, 0.98)
    options = {"bounds": [0.0, 1.0], "randn": randn, "verbose": -9, "maxfevals": trials}
    search = cma.CMAEvolutionStrategy(inside, width, options)
    while trials > 0 and not search.stop():
        candidates = search.ask()[:trials] if trials < search.popsize else search.ask()
        costs = yield candidates
        trials -= len(candidates)
        if len(candidates) == search.popsize:
            search.tell(candidates, costs)
