"""Refinement: updates through the filter, on episodes that the network has just rolled."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from threading import Event

import numpy as np

from ..progress import TrainingProgress
from .checkpoint import Progress
from .course import Course, Curriculum, cosine
from .descent import descend
from .rolling import Roll, roll
from .through_filter import Chunk, Refinery, chunks
from .worlds import choose

TIMED = 12  # updates after which a budget in minutes becomes a number of updates


class Budget:
    """Of updates through the filter: a number, or minutes that become one.

    Attributes:
        total: None as long as it is not known.
    """

    def __init__(self, curriculum: Curriculum, done: Progress) -> None:
        self._minutes, self._first, self._begun = curriculum.minutes, done.updates, time.monotonic()
        self.total = done.total if curriculum.updates is None else curriculum.updates
        if self.total is None and not curriculum.minutes:
            self.total = 0

    def is_spent(self, updates: int) -> bool:
        """Whether so many updates are all; the first ones tell how long one takes."""
        made = updates - self._first
        if self.total is None and made >= TIMED:
            spent = time.monotonic() - self._begun
            self.total = max(updates, math.ceil(60.0 * self._minutes * made / spent))
        return self.total is not None and updates >= self.total


def refine(course: Course, stop: Event, shown: bool) -> None:
    """All updates that are left, a checkpoint now and then."""
    budget = Budget(course.curriculum, course.done)
    if budget.total == 0:
        return
    if course.done.updates == 0:  # the lessons' momentum is of another loss
        course.renew_optimiser()
    saved = course.done.updates
    with TrainingProgress("refinement", budget.total or 1, saved, shown, unit="updates") as bar:
        while not stop.is_set() and not budget.is_spent(course.done.updates):
            for chunk in _next_chunks(course):
                if stop.is_set() or budget.is_spent(course.done.updates):
                    break
                _update(course, chunk, budget.total or math.inf, bar)
            if budget.total is not None:
                bar.retotal(budget.total)
            course.done = replace(course.done, rolls=course.done.rolls + 1, total=budget.total)
            if course.done.updates - saved >= course.settings.checkpoint_every:
                saved = course.done.updates
                course.save()


def _next_chunks(course: Course) -> list[Chunk]:
    """The chunks of newly rolled episodes of one part."""
    number, settings = course.settings.rounds + course.done.rolls, course.settings
    rng = course.rng(number)
    part = choose(course.parts, rng)
    recording = part.draw(course.seed, number, settings.refined_episodes)
    interval = part.options.decision_interval or part.scenario.steps_per_measurement
    decisions = -(-recording.time.shape[-1] // interval)
    first = int(rng.integers(1, settings.chunk + 1))
    cuts = chunks(decisions, settings.chunk, min(first, decisions))
    rolled = roll(course.network, part, recording, keep={begin for begin, _ in cuts})
    on = len(rolled.running)
    return [Chunk(rolled, a, min(b, on)) for a, b in cuts if a < on]


def _update(course: Course, chunk: Chunk, total: float, bar: TrainingProgress) -> None:
    settings, share = course.settings, course.done.updates / total
    rate = cosine(settings.refining_rate, settings.final_refining_rate, share)
    for group in course.optimiser.param_groups:
        group["lr"] = rate
    late = share >= 1.0 - settings.consistent_share
    refinery = _refinery(course, chunk.roll, settings.consistency if late else 0.0)
    loss = refinery.loss(course.network, chunk)
    length = descend(course.network, course.optimiser, loss, settings.max_refining_norm)
    course.done = replace(course.done, updates=course.done.updates + 1)
    if chunk.begin == 0:
        errors = np.sqrt(chunk.roll.squared_error)
        middle = float(np.exp(np.mean(np.log(errors))))
        course.note(course.done.updates, "refinement/geometric_mean_error", middle)
        course.note(course.done.updates, "refinement/gradient_norm", length)
        bar.note(f"geometric mean error {middle:.4g} m")
    bar.advance(course.done.updates)


def _refinery(course: Course, rolled: Roll, consistency: float) -> Refinery:
    core, largest = rolled.core, course.settings.largest_error
    return Refinery(core.scenario, core.options.kappa, consistency, largest)
