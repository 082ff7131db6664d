"""Trains a network by lessons from an agent that knows more, then through the filter.

The output folder holds

    config.json     all that is needed to repeat the run
    checkpoint.npz  network and optimiser as plain arrays, and how far the run has come
    policy.npz      the policy, for `kfenv.agents.contestants.policy`
    training.json   how far the run has come, and its course
    tensorboard/    the same for TensorBoard
    .lock           the id of the process that trains, while it does
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.random import Generator, SeedSequence, default_rng
from torch.utils.tensorboard import SummaryWriter

from kfenv.envs.core import Core
from kfenv.envs.knobs import FADING, NOISE_RANGE, PROCESS_NOISE, Knob

from ..contest.rollout import draw_episodes
from ..contest.tuning import tune
from ..contestants.agent import Agent, RecordingFilter
from ..contestants.learned import Learned
from ..contestants.policy import write_policy
from ..contestants.registry import make_agent
from ..files import locked, write_json
from .export import layout
from .lessons import descend, learn, standardise
from .networks import RecurrentNetwork
from .progress import TrainingProgress
from .refinement import Chunk, Refinery, chunks
from .rolling import Roll, roll
from .runs import TrainingInterrupted, admit, describe_run, stop_as_event, torch_threads
from .settings import TaughtSettings, read_settings
from .taught_checkpoints import Progress, load_checkpoint, save_checkpoint
from .worlds import TRAINING, Part, build_world, choose

TUNING_EPISODES = 32  # as many as everyone is tuned on
BETAS = (0.9, 0.98)
BOUNDS = {FADING: (0.5, 10.0), PROCESS_NOISE.name: (1e-2, 1e3)}
TIMED = 12  # updates after which a budget in minutes becomes a number of updates


@dataclass(frozen=True)
class Curriculum:
    """What a network is taught by and how long.

    Attributes:
        teacher: an agent by name, or a policy's path; None for no lessons.
        world: what it is trained in, see `build_world`; None for the environment alone.
        minutes: of refinement through the filter, turned into a number of updates that the
            record tells.
        updates: that number itself, to repeat a run bit by bit; then minutes do not count.
        init: a policy to go on from.
    """

    teacher: str | None = "clairvoyant"
    world: str | None = None
    minutes: float = 0.0
    updates: int | None = None
    init: str | None = None


def teach(
    env_id: str,
    curriculum: Curriculum,
    *,
    seed: int,
    output: str | Path,
    env_kwargs: Mapping[str, Any] | None = None,
    config_path: str | Path | None = None,
    progress: bool = True,
    resume: bool = False,
    **overrides: Any,
) -> Path:
    """Train and return the path of the policy.

    Args:
        env_id: an environment of kfenv whose episodes carry the truth.
        seed: the same seed gives the same policy, on the same machine and libraries; but with
            a budget in minutes only if it comes to the same number of updates.
        output: a new or empty folder, or with `resume` that of an earlier run.
        env_kwargs: of the environment; it is observed in full unless told otherwise.
        config_path, overrides: settings that differ from the bundled ones.

    Raises:
        TrainingInterrupted: Ctrl-C or SIGTERM; the checkpoint is saved.
        FileExistsError: if `output` holds files already and `resume` is not set.
        ValueError: for an argument or a setting that is wrong.
    """
    settings = read_settings("taught", config_path, None, **overrides)
    teacher = None if curriculum.teacher is None else _teacher(curriculum.teacher)
    kwargs = {"observation": "full"} | dict(env_kwargs or {})
    if teacher is not None and teacher.single_channels:
        kwargs = {"actions": list(teacher.own_options["actions"])} | kwargs
    if curriculum.init is not None:
        kwargs = Learned(curriculum.init).given_options | kwargs
    parts = build_world(env_id, kwargs, curriculum.world)
    config = describe_run(env_id, kwargs, "taught", settings, seed)
    config["curriculum"] = asdict(curriculum)
    folder = Path(output)
    admit(folder, config, resume)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder), torch_threads(settings.torch_threads), stop_as_event() as stop:
        write_json(folder / "config.json", config)
        course = Course(folder, config, settings, curriculum, parts, seed)
        course.run(teacher, stop, progress)
    return folder / "policy.npz"


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


class Course:
    """A run: the network, its optimiser, and how far it has come."""

    def __init__(
        self, folder: Path, config: dict[str, Any], settings: TaughtSettings,
        curriculum: Curriculum, parts: tuple[Part, ...], seed: int,
    ) -> None:  # fmt: skip
        self.folder, self.config, self.settings = folder, config, settings
        self.curriculum, self.parts, self.seed = curriculum, parts, seed
        self.network = self._new_network()
        self.optimiser = torch.optim.Adam(self.network.parameters(), betas=BETAS)
        self.done = Progress()
        if (folder / "checkpoint.npz").exists():
            self.done = load_checkpoint(folder, self.network, self.optimiser)
        self.started = time.monotonic()
        self.board = SummaryWriter(str(folder / "tensorboard"))

    def run(self, teacher: Agent | None, stop: Any, shown: bool) -> None:
        """Lessons, then refinement, from where the run has come to."""
        try:
            if teacher is not None and self.curriculum.init is None:
                self._lessons(teacher, stop, shown)
            if not stop.is_set():
                self._refine(stop, shown)
            self.save(finished=not stop.is_set())
        finally:
            self.board.close()
        if stop.is_set():
            raise TrainingInterrupted(
                f"stopped after {self.done.rounds} rounds of lessons and {self.done.updates} "
                f"updates through the filter; the checkpoint is in {self.folder}: give the same "
                "command with --resume (resume=True) to go on"
            )

    def save(self, finished: bool = False) -> None:
        """Write checkpoint, policy and record, each whole or not at all."""
        self.done = replace(self.done, seconds=self._seconds())
        self.started = time.monotonic()
        save_checkpoint(self.folder, self.network, self.optimiser, self.done)
        record = asdict(self.done) | {"finished": finished}
        write_policy(self.folder / "policy.npz", self.network.arrays(), self._about(record))
        write_json(self.folder / "training.json", record)

    # ----- lessons --------------------------------------------------------------------

    def _lessons(self, teacher: Agent, stop: Any, shown: bool) -> None:
        settings = self.settings
        if self.done.rounds < settings.rounds:
            teacher = self._tuned(teacher)
        with TrainingProgress(
            "lessons", settings.rounds, self.done.rounds, shown, unit="rounds"
        ) as bar:
            while self.done.rounds < settings.rounds and not stop.is_set():
                self._lesson(teacher, bar)
                bar.advance(self.done.rounds)
                self.save()

    def _lesson(self, teacher: Agent, bar: TrainingProgress) -> None:
        number, settings = self.done.rounds, self.settings
        rng = self._rng(number)
        jitter = (rng, settings.jitter) if number == 0 else None
        total = sum(part.share for part in self.parts)
        rolls = []
        for part in self.parts:
            episodes = max(2, round(settings.episodes * part.share / total))
            recording = part.draw(self.seed, number, episodes)
            rolls.append(roll(self.network, part, recording, teacher=teacher, jitter=jitter))
        if number == 0:
            standardise(self.network, rolls)
        errors = []

        def advance(loss: float) -> None:
            errors.append(loss)
            bar.note(f"squared log error {loss:.4f}")

        def rate(share: float) -> float:
            first, last = settings.learning_rate, settings.final_learning_rate
            return _cosine(first, last, (number + share) / settings.rounds)

        learn(
            self.network, self.optimiser, rolls, settings.epochs, settings.batch_decisions, rng,
            rate, settings.max_gradient_norm, advance,
        )  # fmt: skip
        self._note(number, "lessons/squared_log_error", float(np.mean(errors[-len(errors) // 4 :])))
        self.done = replace(self.done, rounds=number + 1)

    def _tuned(self, teacher: Agent) -> Agent:
        """The teacher as it is tuned for a contest."""
        env_id, kwargs = self.config["env_id"], self.config["env_kwargs"]
        recording = draw_episodes(env_id, kwargs, "tuning", self.seed, TUNING_EPISODES)
        return tune(teacher, env_id, kwargs, recording, self.settings.tuning_trials, self.seed)

    # ----- through the filter ---------------------------------------------------------

    def _refine(self, stop: Any, shown: bool) -> None:
        budget = Budget(self.curriculum, self.done)
        if budget.total == 0:
            return
        if self.done.updates == 0:  # the lessons' momentum is of another loss
            self.optimiser = torch.optim.Adam(self.network.parameters(), betas=BETAS)
        saved = self.done.updates
        with TrainingProgress("refinement", budget.total or 1, saved, shown, unit="updates") as bar:
            while not stop.is_set() and not budget.is_spent(self.done.updates):
                for chunk in self._next_chunks():
                    if stop.is_set() or budget.is_spent(self.done.updates):
                        break
                    self._update(chunk, budget.total or math.inf, bar)
                if budget.total is not None:
                    bar.retotal(budget.total)
                self.done = replace(self.done, rolls=self.done.rolls + 1, total=budget.total)
                if self.done.updates - saved >= self.settings.checkpoint_every:
                    saved = self.done.updates
                    self.save()

    def _next_chunks(self) -> list[Chunk]:
        """The chunks of newly rolled episodes of one part."""
        number, settings = self.settings.rounds + self.done.rolls, self.settings
        rng = self._rng(number)
        part = choose(self.parts, rng)
        recording = part.draw(self.seed, number, settings.refined_episodes)
        interval = part.options.decision_interval or part.scenario.steps_per_measurement
        decisions = -(-len(recording.time) // interval)
        first = int(rng.integers(1, settings.chunk + 1))
        cuts = chunks(decisions, settings.chunk, min(first, decisions))
        rolled = roll(self.network, part, recording, keep={begin for begin, _ in cuts})
        on = len(rolled.running)
        return [Chunk(rolled, a, min(b, on)) for a, b in cuts if a < on]

    def _update(self, chunk: Chunk, total: float, bar: TrainingProgress) -> None:
        settings, share = self.settings, self.done.updates / total
        rate = _cosine(settings.refining_rate, settings.final_refining_rate, share)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        late = share >= 1.0 - settings.consistent_share
        refinery = self._refinery(chunk.roll, settings.consistency if late else 0.0)
        loss = refinery.loss(self.network, chunk)
        length = descend(self.network, self.optimiser, loss, settings.max_refining_norm)
        self.done = replace(self.done, updates=self.done.updates + 1)
        if chunk.begin == 0:
            errors = np.sqrt(chunk.roll.squared_error)
            middle = float(np.exp(np.mean(np.log(errors))))
            self._note(self.done.updates, "refinement/geometric_mean_error", middle)
            self._note(self.done.updates, "refinement/gradient_norm", length)
            bar.note(f"geometric mean error {middle:.4g} m")
        bar.advance(self.done.updates)

    def _refinery(self, rolled: Roll, consistency: float) -> Refinery:
        core = rolled.core
        largest = self.settings.largest_error * core.scenario.error_scale
        motion, sensor = core.scenario.motion, core.scenario.sensor
        return Refinery(motion, sensor, core.options.kappa, consistency, largest)

    # ----- what it works with ---------------------------------------------------------

    def _new_network(self) -> RecurrentNetwork:
        core = self._core()
        if self.curriculum.init is not None:
            start = Learned(self.curriculum.init)
            start.check_fits(core)
            return RecurrentNetwork.from_policy(start.policy)
        torch.manual_seed(self.seed)
        low, high = zip(*(_bounds(knob) for knob in core.knobs), strict=True)
        size, settings = core.observation_size, self.settings
        return RecurrentNetwork(
            np.zeros(size), np.ones(size), low, high, settings.units, settings.memory
        )

    def _core(self) -> Core:
        part = self.parts[0]
        return Core(part.scenario, part.options, 1, part.scenario.time, has_truth=True)

    def _about(self, record: Mapping[str, Any]) -> dict[str, Any]:
        """What the policy says of itself."""
        core, own = self._core(), ("env_id", "env_kwargs")
        trained = {key: value for key, value in record.items() if key != "curve"}
        rest = {key: value for key, value in self.config.items() if key not in own}
        about = {key: self.config[key] for key in own} | layout(core)
        return about | {"metadata": rest | {"trained": trained}}

    def _rng(self, number: int) -> Generator:
        """For all that is random in a numbered lesson or roll, but its episodes."""
        return default_rng(SeedSequence(self.seed, spawn_key=(TRAINING, len(self.parts), number)))

    def _seconds(self) -> float:
        return self.done.seconds + time.monotonic() - self.started

    def _note(self, place: int, name: str, value: float) -> None:
        self.board.add_scalar(name, value, place)
        row = {"what": name, "place": place, "value": value, "seconds": round(self._seconds(), 1)}
        self.done.curve.append(row)


def _bounds(knob: Knob) -> tuple[float, float]:
    """Log factors that a network may set: beyond these no filter here was ever better."""
    low, high = BOUNDS.get(knob.name, NOISE_RANGE)
    return math.log(max(low, knob.low)), math.log(min(high, knob.high))


def _teacher(name: str) -> Agent:
    teacher = make_agent(name)
    if isinstance(teacher, RecordingFilter) or not isinstance(teacher, Agent):
        raise ValueError(f"{name} turns no knobs, so it cannot teach: name an agent or a policy.")
    return teacher


def _cosine(first: float, last: float, share: float) -> float:
    return last + 0.5 * (first - last) * (1.0 + math.cos(math.pi * min(share, 1.0)))
