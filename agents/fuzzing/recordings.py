"""Recordings far from what a scenario draws and yet valid: scales, gaps, outliers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

import kfenv
from kfenv.filters.protocol import Knobs
from kfenv.models.model import Motion, Sensor
from kfenv.scenarios.recording import Recording

from ..contest.rollout import scenario_and_options

Array = NDArray[np.float64]
Spoil = Callable[[Generator, dict[str, Any]], None]

DURATION, DRAWN = 4.0, 8  # s and number of the episodes that others are made from
OFTEN = 0.25  # share of the cases that meet one kind of spoiling


def models(env_id: str) -> tuple[Motion, Sensor]:
    """What the filters of an environment work with."""
    scenario, _ = scenario_and_options(env_id, {})
    return scenario.motion, scenario.sensor


@cache
def _drawn(env_id: str) -> Recording:
    kwargs = {"duration": DURATION, "faults": "random"}
    scenario, _ = scenario_and_options(env_id, kwargs)
    return scenario.sample([default_rng(seed) for seed in range(DRAWN)])


def draw_recording(rng: Generator, batch: int, steps: int) -> tuple[str, Recording]:
    """An environment's id, and so many episodes that its filters may meet."""
    env_id = kfenv.ENVIRONMENTS[rng.integers(len(kfenv.ENVIRONMENTS))]
    drawn = _drawn(env_id)
    steps = min(steps, len(drawn.time))
    chosen = rng.integers(len(drawn), size=batch)
    arrays = {"time": drawn.time[:steps].copy(), "mean": drawn.mean[chosen]}
    arrays["factor"] = drawn.factor[chosen]
    for name in ("measurement", "noise", "motion_inputs", "sensor_inputs"):
        arrays[name] = getattr(drawn, name)[chosen, :steps]
    for spoil in SPOILS:
        if rng.random() < OFTEN:
            spoil(rng, arrays)
    return env_id, Recording(**arrays)


def draw_knobs(rng: Generator, batch: int) -> Knobs:
    """Constant knobs: most within what the environments allow, a few far beyond."""
    powers = (3.0, 12.0)[int(rng.random() < 0.1)]
    fading = 10.0 ** rng.uniform(-0.3 * powers, powers, batch)
    return Knobs(fading, 10.0 ** rng.uniform(-powers, powers, batch))


def as_case(recording: Recording, knobs: Knobs) -> dict[str, Array]:
    """The arrays of both, by name."""
    told = {field.name: getattr(recording, field.name) for field in fields(recording)[:7]}
    return told | knobs._asdict()


def from_case(case: dict[str, Any]) -> tuple[Recording, Knobs]:
    """What `as_case` took apart."""
    arrays = {field.name: case[field.name] for field in fields(Recording)[:7]}
    return Recording(**arrays), Knobs(case["fading"], case["process_scale"])


def without_measurements(recording: Recording) -> Recording:
    """The same with nothing that arrives."""
    return replace(recording, measurement=np.full_like(recording.measurement, np.nan))


# ----- kinds of spoiling, each of arrays in place -----------------------------------------


def _power(rng: Generator, most: float, *shape: int) -> Array:
    """Factors of up to ten to the power of `most` either way."""
    return 10.0 ** rng.uniform(-most, most, shape)


def _time(rng: Generator, a: dict[str, Any]) -> None:
    steps = np.clip(0.1 * _power(rng, 4.0, len(a["time"]) - 1), 1e-6, 1.0)
    a["time"][1:] = np.cumsum(steps)


def _few(rng: Generator, a: dict[str, Any]) -> None:
    share = (0.1, 0.5, 0.95, 1.0)[rng.integers(4)]
    a["measurement"][rng.random(a["measurement"].shape) < share] = np.nan


def _channels(rng: Generator, a: dict[str, Any]) -> None:
    batch, _, channels = a["measurement"].shape
    gone = rng.random((batch, 1, channels)) < rng.random()
    np.copyto(a["measurement"], np.nan, where=gone)


def _outliers(rng: Generator, a: dict[str, Any]) -> None:
    shape = a["measurement"].shape
    size = a["noise"] * _power(rng, 3.0, 1, 1, shape[2]) * 10.0 ** rng.uniform(0.0, 9.0)
    struck = rng.random(shape) < rng.choice((0.01, 0.3))
    a["measurement"] += np.where(struck, size * rng.standard_normal(shape), 0.0)


def _noise(rng: Generator, a: dict[str, Any]) -> None:
    batch, _, channels = a["noise"].shape
    a["noise"] *= _power(rng, rng.choice((2.0, 9.0)), batch, 1, channels)


def _mean(rng: Generator, a: dict[str, Any]) -> None:
    size = 10.0 ** rng.uniform(0.0, rng.choice((2.0, 6.0)), (len(a["mean"]), 1))
    deviation = np.linalg.norm(a["factor"], axis=2)
    a["mean"] += size * deviation * rng.standard_normal(a["mean"].shape)


def _plain_mean(rng: Generator, a: dict[str, Any]) -> None:
    zero = rng.random(a["mean"].shape) < rng.random()
    a["mean"][zero] = 0.0


def _scale(rng: Generator, a: dict[str, Any]) -> None:
    batch, n = a["mean"].shape
    a["factor"] *= _power(rng, rng.choice((2.0, 9.0)), batch, n, 1)


def _correlation(rng: Generator, a: dict[str, Any]) -> None:
    batch, n = a["mean"].shape
    mixing = np.tril(rng.standard_normal((batch, n, n)) * _power(rng, 4.0, batch, 1, 1), -1)
    diagonal = np.diagonal(a["factor"], axis1=1, axis2=2)
    a["factor"] = a["factor"] + mixing * diagonal[:, None, :]


def _inputs(rng: Generator, a: dict[str, Any]) -> None:
    a["motion_inputs"] = a["motion_inputs"] * _power(rng, 2.0, len(a["mean"]), 1, 1)


def _constant(rng: Generator, a: dict[str, Any]) -> None:
    """The same measurement again and again."""
    a["measurement"][:] = a["measurement"][:, :1]


SPOILS: tuple[Spoil, ...] = (
    _time, _few, _channels, _outliers, _noise, _mean, _plain_mean, _scale, _correlation, _inputs,
    _constant,
)  # fmt: skip
