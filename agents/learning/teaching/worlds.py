"""Worlds to train in: mixtures of an environment's keywords, wider than any test.

A world is a TOML file with a table ``[[part]]`` for each kind of episode: its ``share``, and
under ``[part.kwargs]`` the keywords that differ from the environment's own.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from kfenv.envs.options import Options
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording, stack
from kfenv.scenarios.scenario import TrackingScenario

from ...contest.rollout import SPLITS, scenario_and_options

TRAINING = 1 + max(SPLITS.values())  # key of the training episodes beside the splits'
FOLDER = files(__package__.rpartition(".")[0]) / "config" / "worlds"


@dataclass(frozen=True)
class Kind:
    """Episodes of one kind.

    Attributes:
        share: of all episodes.
        scenario: what they are drawn from.
        number: place in its world.
    """

    share: float
    scenario: TrackingScenario
    number: int

    def draw(self, seed: int, lesson: int, episodes: int) -> Recording:
        """The episodes of a numbered lesson; no others are like them, in no kind or split."""
        keys = [(TRAINING, self.number, lesson, i) for i in range(episodes)]
        return self.scenario.sample([default_rng(SeedSequence(seed, spawn_key=k)) for k in keys])


@dataclass(frozen=True)
class Part:
    """Kinds that go in lock-step: the same instants, the same filter and knobs.

    Attributes:
        kinds: at least one.
        options: that they are replayed with.
    """

    kinds: tuple[Kind, ...]
    options: Options

    @property
    def share(self) -> float:
        """Of all episodes."""
        return sum(kind.share for kind in self.kinds)

    @property
    def scenario(self) -> TrackingScenario:
        """Of the first kind: all have its motion, its sensor and its scales."""
        return self.kinds[0].scenario

    def draw(self, seed: int, lesson: int, episodes: int) -> Recording:
        """The episodes of a numbered lesson, of every kind by its share."""
        ends = np.cumsum([kind.share for kind in self.kinds]) / self.share
        counts = np.diff(np.round(ends * episodes).astype(int), prepend=0)
        pairs = zip(self.kinds, counts, strict=True)
        return stack([kind.draw(seed, lesson, count) for kind, count in pairs if count])


def build_world(env_id: str, env_kwargs: Mapping[str, Any], world: str | None) -> tuple[Part, ...]:
    """The parts of a world; without one the environment alone.

    Args:
        world: the name of a bundled world, or the path of a TOML file.

    Raises:
        ValueError: if there is no such world, or it is malformed.
    """
    told = [{"share": 1.0}] if world is None else _read(world)
    together: dict[Any, tuple[list[Kind], Options]] = {}
    for number, item in enumerate(told):
        kwargs = dict(env_kwargs) | item.get("kwargs", {})
        scenario, options = scenario_and_options(env_id, kwargs)
        key = scenario.time.tobytes(), str(options)
        kinds, _ = together.setdefault(key, ([], options))
        kinds.append(Kind(item["share"], scenario, number))
    return tuple(Part(tuple(kinds), options) for kinds, options in together.values())


def choose(parts: Sequence[Part], rng: Generator) -> Part:
    """A part by its share."""
    share = np.array([part.share for part in parts])
    return parts[int(rng.choice(len(parts), p=share / share.sum()))]


def bundled_worlds() -> tuple[str, ...]:
    """Names of the worlds that come with kfenv."""
    return tuple(sorted(item.name[:-5] for item in FOLDER.iterdir() if item.name.endswith(".toml")))


def _read(world: str) -> list[dict[str, Any]]:
    path = Path(world)
    if world in bundled_worlds():
        text = (FOLDER / f"{world}.toml").read_text(encoding="utf-8")
    elif path.suffix == ".toml" and path.exists():
        text = path.read_text(encoding="utf-8")
    else:
        raise ValueError(unknown("world", world, bundled_worlds()) + " Or give a TOML file.")
    try:
        parts = tomllib.loads(text).get("part")
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"The world {world} is no TOML ({error}): correct that line.") from None
    if not isinstance(parts, list) or not parts or not all(map(_is_part, parts)):
        raise ValueError(
            f"The world {world} needs tables [[part]], each with a positive share and, if "
            "keywords differ, [part.kwargs], and nothing else."
        )
    return parts


def _is_part(item: Any) -> bool:
    return (
        isinstance(item, dict)
        and item.keys() <= {"share", "kwargs"}
        and isinstance(item.get("share"), int | float)
        and item["share"] > 0.0
        and isinstance(item.get("kwargs", {}), dict)
    )
