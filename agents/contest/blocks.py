"""Contests as independent jobs: a trial of an agent's tuning, or an agent on a block of episodes.

Where the blocks begin does not depend on who runs them, and each episode has a generator of its
own: whatever runs the jobs, and in whatever order, the scores are the same to the bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kfenv.scenarios.recording import Recording

from ..contestants.agent import Contestant
from ..contestants.registry import make_agent
from ..jobs.carried import carried
from ..jobs.executor import Workers, run_jobs
from .contest import Contest
from .cost import relative_cost
from .ledger import Ledger, Values
from .rollout import draw_episodes, rollout
from .scores import Scores
from .summary import NOMINAL
from .tuning import Search, parameters_of
from .tuning_costs import ERROR, costs


class Trial(NamedTuple):
    """An agent with the values given meets the tuning episodes; `number` of those asked at once."""

    agent: str
    number: int
    values: Values

    def __str__(self) -> str:
        return f"{self.agent}, tuning"


class Block(NamedTuple):
    """An agent with the values given meets the episodes from `begin` to `end` of a contest."""

    contest: int
    agent: str
    begin: int
    end: int
    values: Values

    def __str__(self) -> str:
        return f"{self.agent}, episodes {self.begin} to {self.end}"


@dataclass(frozen=True)
class Work:
    """What a worker needs to do any job of some contests; files and policies travel with it.

    Attributes:
        contests: of the same agents, tuned in the same place.
        sizes: number of episodes of each.
        agents: by the name or path that the contests know them by.
    """

    contests: tuple[Contest, ...]
    sizes: tuple[int, ...]
    agents: dict[str, Contestant]

    def __call__(self, job: Trial | Block) -> float | tuple[Scores, float | None]:
        """What a trial makes small; or scores, and of a contest's first block the cost."""
        return self._try(job) if isinstance(job, Trial) else self._play(job)

    def prepare(self) -> None:
        """Compile what all agents need."""
        rollout(self.agents[NOMINAL], *self.contests[0].expected_place, self._draw(0, 0, 1))

    def _try(self, job: Trial) -> float:
        contest, agent = self.contests[0], self.agents[job.agent].with_values(job.values)
        place, on = contest.tuning_place, contest.tune_on
        return float(np.mean(costs(on, agent, *place, self._tuning_episodes, contest.seed)))

    @cached_property
    def _tuning_episodes(self) -> Recording:
        contest = self.contests[0]
        return draw_episodes(*contest.tuning_place, "tuning", contest.seed, contest.tuning_episodes)

    def _play(self, job: Block) -> tuple[Scores, float | None]:
        contest, agent = self.contests[job.contest], self.agents[job.agent].with_values(job.values)
        place, seed = contest.expected_place, contest.seed
        recording = self._draw(job.contest, job.begin, job.end)
        block = job.begin, self.sizes[job.contest]
        scores = rollout(agent, *place, recording, seed, block=block)
        if job.begin > 0:
            return scores, None
        return scores, relative_cost(agent, *place, recording, seed, scores.seconds)

    def _draw(self, contest: int, begin: int, end: int) -> Any:
        one = self.contests[contest]
        return draw_episodes(
            one.env_id, one.env_kwargs, one.split, one.seed, one.episodes, (begin, end)
        )


def play(
    contests: Sequence[Contest],
    sizes: Sequence[int],
    folders: Sequence[Path],
    workers: Workers,
    done: Callable[[int, str], Any],
) -> None:
    """Tune the agents of some contests in the first of them, score them in all, and store that.

    Finished tunings and blocks are kept beside the scores, so that resuming repeats none.

    Args:
        contests: of the same agents, tuned in the same place.
        sizes: number of episodes of each.
        folders: of each; the scores that they hold are not computed again.
        done: called with a contest's number and an agent when its scores are stored.
    """
    agents = {name: make_agent(name) for name in contests[0].all_agents}
    work = Work(tuple(map(_carried, contests)), tuple(sizes), agents)
    ledger = Ledger(sizes, folders, {name: agent.name for name, agent in agents.items()})
    searches: dict[str, Search] = {}
    waiting: deque[Trial | Block] = deque()

    def ask(name: str) -> None:
        """Have the next settings tried; if there are none, the best one scored."""
        asked = searches[name].asked
        waiting.extend(Trial(name, number, values) for number, values in enumerate(asked))
        if not asked:
            score(name, agents[name].with_values(searches[name].best).values)

    def score(name: str, values: Values) -> None:
        for contest in ledger.open_contests(name):
            blocks = ledger.missing(contest, name)
            waiting.extend(Block(contest, name, begin, end, values) for begin, end in blocks)
            if not blocks:
                finish(contest, name)

    def finish(contest: int, name: str) -> None:
        ledger.close(contest, name)
        done(contest, name)

    for name, agent in agents.items():
        ledger.tidy(name)
        values = ledger.values(name)
        if values is not None:
            score(name, values)
        elif ledger.open_contests(name):
            searches[name] = _begun(contests[0], agent, ledger.costs(name))
            ask(name)
    for job, result in run_jobs(work, waiting, workers, work.prepare):
        if isinstance(job, Block):
            if ledger.keep(job.contest, job.agent, (job.begin, job.end), job.values, *result):
                finish(job.contest, job.agent)
        elif searches[job.agent].tell(job.number, result):
            ledger.keep_costs(job.agent, searches[job.agent].costs)
            ask(job.agent)


def _begun(contest: Contest, agent: Contestant, known: Sequence[float]) -> Search:
    """The search for an agent's parameters, which has been told the costs that are known."""
    parameters = parameters_of(agent, *contest.tuning_place) if contest.tuning_trials else ()
    near = contest.tune_on != ERROR
    search = Search(parameters, contest.tuning_trials, contest.seed, near)
    while len(known) - len(search.costs) >= len(search.asked) > 0:
        begin = len(search.costs)
        for number in range(len(search.asked)):
            search.tell(number, known[begin + number])
    return search


def _carried(contest: Contest) -> Contest:
    """The same, with the files that its keywords name."""
    own, tuning = contest.env_kwargs, contest.tuning_kwargs
    return replace(contest, env_kwargs=carried(own), tuning_kwargs=carried(tuning))
