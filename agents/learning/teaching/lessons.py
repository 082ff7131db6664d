"""Learning from a teacher: regression on its log factors, over episodes that the pupil rolls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Event

import numpy as np
import torch
from numpy.random import Generator

from ...contest.rollout import draw_episodes
from ...contest.tuning import tune
from ...contestants.agent import Agent
from ..channelwise import Network
from ..progress import TrainingProgress
from .course import Course, cosine
from .descent import descend
from .rolling import Roll, roll

TUNING_EPISODES = 32  # as many as everyone is tuned on
LEAST_DEVIATION = 1e-3  # of a feature, so that one that never moved is not blown up


def hold_lessons(course: Course, teacher: Agent, stop: Event, shown: bool) -> None:
    """All rounds that are left, a checkpoint after each."""
    settings = course.settings
    if course.done.rounds < settings.rounds:
        teacher = _tuned(course, teacher)
    with TrainingProgress(
        "lessons", settings.rounds, course.done.rounds, shown, unit="rounds"
    ) as bar:
        while course.done.rounds < settings.rounds and not stop.is_set():
            _lesson(course, teacher, bar)
            bar.advance(course.done.rounds)
            course.save()


def _lesson(course: Course, teacher: Agent, bar: TrainingProgress) -> None:
    number, settings = course.done.rounds, course.settings
    rng = course.rng(number)
    jitter = (rng, settings.jitter) if number == 0 else None
    total = sum(part.share for part in course.parts)
    rolls = []
    for part in course.parts:
        episodes = max(2, round(settings.episodes * part.share / total))
        recording = part.draw(course.seed, number, episodes)
        rolls.append(roll(course.network, part, recording, teacher=teacher, jitter=jitter))
    if number == 0:
        seen = np.concatenate([roll.observations[roll.running] for roll in rolls])
        course.network.standardise(seen, LEAST_DEVIATION)
    errors = []

    def advance(loss: float) -> None:
        errors.append(loss)
        bar.note(f"squared log error {loss:.4f}")

    def rate(share: float) -> float:
        first, last = settings.learning_rate, settings.final_learning_rate
        return cosine(first, last, (number + share) / settings.rounds)

    learn(
        course.network, course.optimiser, rolls, settings.epochs, settings.batch_decisions, rng,
        rate, settings.max_gradient_norm, advance,
    )  # fmt: skip
    course.note(number, "lessons/squared_log_error", float(np.mean(errors[-len(errors) // 4 :])))
    course.done = replace(course.done, rounds=number + 1)


def _tuned(course: Course, teacher: Agent) -> Agent:
    """The teacher as it is tuned for a contest."""
    env_id, kwargs = course.config["env_id"], course.env_kwargs
    recording = draw_episodes(env_id, kwargs, "tuning", course.seed, TUNING_EPISODES)
    return tune(teacher, env_id, kwargs, recording, course.settings.tuning_trials, course.seed)


def learn(
    network: Network,
    optimiser: torch.optim.Optimizer,
    rolls: Sequence[Roll],
    epochs: int,
    decisions: int,
    rng: Generator,
    rate: Callable[[float], float],
    clip: float,
    advance: Callable[[float], None],
) -> None:
    """Fit the labels of rolls.

    Args:
        decisions: in a batch, about.
        rate: learning rate, given the share of the epochs that is done.
        clip: longer gradients are shortened to this.
        advance: called with the mean squared error after each batch.
    """
    batches = [batch for roll in rolls for batch in _batches(roll, decisions)]
    total = epochs * len(batches)
    for step in range(total):
        if step % len(batches) == 0:
            batches = [batch for roll in rolls for batch in _batches(roll, decisions, rng)]
            rng.shuffle(batches)
        roll, chosen = batches[step % len(batches)]
        for group in optimiser.param_groups:
            group["lr"] = rate(step / total)
        loss = _error(network, roll, chosen)
        descend(network, optimiser, loss, clip)
        advance(loss.item())


def _batches(
    roll: Roll, decisions: int, rng: Generator | None = None
) -> list[tuple[Roll, np.ndarray]]:
    """The episodes of a roll in parts of about so many decisions."""
    steps, episodes = roll.running.shape
    order = np.arange(episodes) if rng is None else rng.permutation(episodes)
    parts = max(1, round(steps * episodes / decisions))
    return [(roll, np.sort(part)) for part in np.array_split(order, min(parts, episodes))]


def _error(network: Network, roll: Roll, chosen: np.ndarray) -> torch.Tensor:
    """Mean squared error of the log factors that count."""
    told = torch.from_numpy(roll.observations[:, chosen])
    wanted, _ = network(told, network.start(len(chosen)))
    valid = torch.from_numpy(roll.valid[:, chosen])
    labels = torch.from_numpy(roll.labels[:, chosen])
    labels = labels.clamp(network.log_low, network.log_high)
    squared = torch.where(valid, (wanted - labels) ** 2, 0.0)
    return squared.sum() / valid.sum()
