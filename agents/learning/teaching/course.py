"""A training run by lessons and refinement: its network, its optimiser, how far it has come."""

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

from ...contestants.learned import Learned
from ...contestants.policy import write_policy
from ...files import write_json
from ..channelwise import Network, new_network, trainable
from ..runs import layout
from ..settings import TaughtSettings
from .checkpoint import Progress, load_checkpoint, save_checkpoint
from .worlds import TRAINING, Part

BETAS = (0.9, 0.98)
BOUNDS = {FADING: (0.5, 10.0), PROCESS_NOISE.name: (1e-2, 1e3)}


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


class Course:
    """A run.

    Attributes:
        folder, config, settings, curriculum, env_kwargs, parts, seed: what it was asked for.
        network, optimiser: as training has changed them.
        done: how far it has come.
    """

    def __init__(
        self, folder: Path, config: dict[str, Any], settings: TaughtSettings,
        curriculum: Curriculum, env_kwargs: Mapping[str, Any], parts: tuple[Part, ...], seed: int,
    ) -> None:  # fmt: skip
        self.env_kwargs = env_kwargs  # the config holds its objects in words
        self.folder, self.config, self.settings = folder, config, settings
        self.curriculum, self.parts, self.seed = curriculum, parts, seed
        self.network = self._new_network()
        self.renew_optimiser()
        self.done = Progress()
        if (folder / "checkpoint.npz").exists():
            self.done = load_checkpoint(folder, self.network, self.optimiser)
        self._started = time.monotonic()
        self._board = SummaryWriter(str(folder / "tensorboard"))

    def renew_optimiser(self) -> None:
        """Forget its momentum."""
        self.optimiser = torch.optim.Adam(self.network.parameters(), betas=BETAS)

    def save(self, finished: bool = False) -> None:
        """Write checkpoint, policy and record, each whole or not at all."""
        self.done = replace(self.done, seconds=self._seconds())
        self._started = time.monotonic()
        save_checkpoint(self.folder, self.network, self.optimiser, self.done)
        record = asdict(self.done) | {"finished": finished}
        write_policy(self.folder / "policy.npz", self.network.arrays(), self._about(record))
        write_json(self.folder / "training.json", record)

    def _new_network(self) -> Network:
        core = self._core()
        if self.curriculum.init is not None:
            start = Learned(self.curriculum.init)
            start.check_fits(core)
            return trainable(start.policy)
        torch.manual_seed(self.seed)
        bounds = np.array([_bounds(knob) for knob in core.knobs])
        return new_network(core, bounds, self.settings.units, self.settings.memory)

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

    def rng(self, number: int) -> Generator:
        """For all that is random in a numbered lesson or roll, but its episodes."""
        return default_rng(SeedSequence(self.seed, spawn_key=(TRAINING, len(self.parts), number)))

    def close(self) -> None:
        """End what TensorBoard reads."""
        self._board.close()

    def _seconds(self) -> float:
        return self.done.seconds + time.monotonic() - self._started

    def note(self, place: int, name: str, value: float) -> None:
        """Keep a figure of its course."""
        self._board.add_scalar(name, value, place)
        row = {"what": name, "place": place, "value": value, "seconds": round(self._seconds(), 1)}
        self.done.curve.append(row)


def _bounds(knob: Knob) -> tuple[float, float]:
    """Log factors that a network may set: beyond these no filter here was ever better."""
    low, high = BOUNDS.get(knob.name, NOISE_RANGE)
    return math.log(max(low, knob.low)), math.log(min(high, knob.high))


def cosine(first: float, last: float, share: float) -> float:
    """A step size that falls along a cosine as the share of the work that is done rises."""
    return last + 0.5 * (first - last) * (1.0 + math.cos(math.pi * min(share, 1.0)))
