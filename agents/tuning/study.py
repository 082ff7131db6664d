"""A log in, numbers out: static noise and rules tuned on one part, looked at on another."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.envs.options import Options
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording

from ..contest.rollout import draw_episodes, scenario_and_options
from ..contestants.optimised import initial_noise_factor
from ..files import goes_on, locked, read_json, write_json
from ..plain import plain
from .blocks import blocks_of
from .criteria import STATIC, Criterion
from .diagnostics import Innovations, channel_report, filter_innovations
from .estimation import estimate
from .noise import NoiseShape
from .rules import tune_rule

Array = NDArray[np.float64]

NOMINAL = "as told"


@dataclass(frozen=True)
class Study:
    """What is tuned on what; equal studies give equal numbers.

    Attributes:
        env_id, env_kwargs: the environment; kwargs must be plain JSON values.
        by: criteria of the static noise; the first is the one that is reported and that rules
            are tuned on.
        shape: "groups", "channels" or "full", see `NoiseShape`.
        rules: agents whose gates and windows are tuned.
        trials: settings that a rule may try for each of its parameters.
        episodes: windows or drawn episodes to tune on.
        test_episodes: others, to look at.
        seed: of what is drawn.
    """

    env_id: str
    env_kwargs: dict[str, Any]
    by: tuple[str, ...] = ("likelihood",)
    shape: str = "groups"
    rules: tuple[str, ...] = ()
    trials: int = 40
    episodes: int = 32
    test_episodes: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        for name in self.by:
            if name not in STATIC:
                raise ValueError(unknown("criterion", name, STATIC))
        for name, least in (("episodes", 1), ("test_episodes", 1), ("trials", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}.")

    @property
    def jobs(self) -> tuple[str, ...]:
        """What is done one after the other, and kept when it is done."""
        return (*(f"static-{name}" for name in self.by), *(f"rule-{name}" for name in self.rules))

    def draw(self, split: str, episodes: int) -> Recording:
        """Episodes of a split."""
        return draw_episodes(self.env_id, self.env_kwargs, split, self.seed, episodes)


def run_study(
    study: Study, output: Path, resume: bool = False,
    started: Callable[[str], None] = lambda job: None,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:  # fmt: skip
    """Tune, look, and write ``report.json`` into a folder.

    What is done is kept, so that resuming repeats none of it.

    Raises:
        FileExistsError: if the folder holds anything and ``resume`` is not set.
        ValueError: if it holds another study, or the log cannot give what is asked.
    """
    scenario, options = scenario_and_options(study.env_id, study.env_kwargs)
    tuning, test = study.draw("tuning", study.episodes), study.draw("test", study.test_episodes)
    shape = NoiseShape.of(study.shape, scenario, tuning)
    _admit(output, study, resume)
    output.mkdir(parents=True, exist_ok=True)
    with locked(output):
        write_json(output / "study.json", _admit(output, study, resume))  # another may have ended
        done = {}
        for job in study.jobs:
            started(job)
            path = output / "jobs" / f"{job}.json"
            if not path.exists():
                path.parent.mkdir(exist_ok=True)
                write_json(path, _do(job, study, shape, options, tuning, test, advance))
            done[job] = read_json(path, dict, "delete it, and --resume does it again")
            advance()
        report = _report(study, shape, tuning, test, done)
        write_json(output / "report.json", report)
    return report


def _do(
    job: str, study: Study, shape: NoiseShape, options: Options, tuning: Recording,
    test: Recording, advance: Callable[[], None],
) -> dict[str, Any]:  # fmt: skip
    """One of the study's jobs, as plain values."""
    kind, _, name = job.partition("-")
    if kind == "static":
        criterion = Criterion(name, shape.scenario, options, tuning, blocks_of(tuning))
        result: Any = estimate(shape, criterion, study.seed, advance)
    else:
        result = tune_rule(
            name, study.env_id, study.env_kwargs, tuning, test, study.by[0], study.trials,
            study.seed, advance,
        )  # fmt: skip
    return {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in asdict(result).items()
    }


def _report(
    study: Study, shape: NoiseShape, tuning: Recording, test: Recording, done: dict[str, Any]
) -> dict[str, Any]:
    """All that is told, as plain values."""
    settings = {NOMINAL: np.zeros(len(shape.names))} | {
        name: np.array(done[f"static-{name}"]["theta"]) for name in study.by
    }
    looked = {name: _look(study, shape, test, theta) for name, theta in settings.items()}
    chosen, scenario = study.by[0], shape.scenario
    return {
        "environment": study.env_id,
        "options": plain(study.env_kwargs),
        "by": list(study.by),
        "shape": study.shape,
        "seed": study.seed,
        "windows": {"tuning": len(tuning), "test": len(test)},
        "intervals": "95 %; static noise: delete-one-block jackknife, one Newton step each, of "
        f"{done[f'static-{chosen}']['blocks']} blocks of the log; rules: block bootstrap over "
        f"{len(tuning)} windows",
        "static": {
            name: _parameters(shape, done[f"static-{name}"]) | _scores(scenario, looked[name])
            for name in study.by
        },
        "nominal": _scores(scenario, looked[NOMINAL]),
        "rules": [done[f"rule-{name}"] for name in study.rules],
        "channels": _channels(scenario, test, looked[chosen]),
        "matrices": matrices(shape, tuning, settings[chosen]),
    }


def _look(study: Study, shape: NoiseShape, test: Recording, theta: Array) -> Innovations:
    _, options = scenario_and_options(study.env_id, study.env_kwargs)
    left, noise = shape.factors(theta[None])
    return filter_innovations(shape.scenario, options, test, left[0], noise[0])


def _parameters(shape: NoiseShape, done: dict[str, Any]) -> dict[str, Any]:
    """Each parameter's value, interval, and what is wrong with it."""
    rows = {}
    for i, name in enumerate(shape.names):
        told = [_value(done[key][i], shape.logarithmic[i]) for key in ("theta", "low", "high")]
        rows[name] = {
            "value": told[0], "low": told[1], "high": told[2], "moved": done["moved"][i],
            "at_edge": done["at_edge"][i],
            "what": "deviation" if name.endswith("_noise") and "process" not in name else
            "variance" if shape.logarithmic[i] else "coupling",
        }  # fmt: skip
    return {"parameters": rows, "cost": done["cost"], "nominal_cost": done["nominal_cost"]}


def _value(theta: float | None, logarithmic: bool) -> float | None:
    if theta is None:  # an end of an interval that the data do not tell
        return None
    return float(np.exp(theta)) if logarithmic else float(theta)


def _scores(scenario: Any, looked: Innovations) -> dict[str, Any]:
    """NIS of all channels together and of each group; RMSE where the truth is known."""
    square, group = looked.normalised**2, np.array(scenario.sensor.group_of_channel)
    nis: dict[str, float | None] = {"all": looked.joint_nis}
    for g, name in enumerate(scenario.sensor.groups):
        arrived = square[..., group == g]
        arrived = arrived[~np.isnan(arrived)]
        nis[name] = float(arrived.mean()) if len(arrived) else None
    scores: dict[str, Any] = {"nis": nis}
    if looked.rmse is not None:
        scores["rmse_median"] = float(np.median(looked.rmse))
        scores["rmse_geometric_mean"] = float(np.exp(np.mean(np.log(looked.rmse))))
        scores["rmse"] = looked.rmse.tolist()
    return scores


def _channels(scenario: Any, test: Recording, looked: Innovations) -> list[dict[str, Any]]:
    blocks = blocks_of(test)
    told = [
        channel_report(channel, looked, c, blocks)
        for c, channel in enumerate(scenario.sensor.channels)
    ]
    return [report.as_dict() for report in told if report is not None]


def matrices(shape: NoiseShape, tuning: Recording, theta: Array) -> dict[str, Any]:
    """Q of the first step and R at the median told deviations, SI units and radians."""
    left, noise = (array[0] for array in shape.factors(theta[None]))
    arrived = ~np.isnan(tuning.measurement)
    told = np.array([
        np.median(tuning.noise[..., c][arrived[..., c]]) if arrived[..., c].any() else np.nan
        for c in range(len(noise))
    ])  # fmt: skip
    factor = left @ initial_noise_factor(shape.scenario, tuning)[0]  # of the first window
    return {
        "dt": float(tuning.times[0, 1] - tuning.times[0, 0]),
        "states": [f"{s.name} ({s.unit})" for s in shape.scenario.motion.states],
        "channels": [f"{c.name} ({c.unit})" for c in shape.scenario.sensor.channels],
        "Q": (factor @ factor.T).tolist(),
        "R": ((told * noise) ** 2).tolist(),
    }


def _admit(output: Path, study: Study, resume: bool) -> dict[str, Any]:
    """What the folder is to say of this study; complains if it holds another."""
    own = {item.name: getattr(study, item.name) for item in fields(study)}
    content = json.loads(json.dumps(own | {"env_kwargs": plain(study.env_kwargs)}))
    path = output / "study.json"
    if goes_on(output, resume):
        held = read_json(path, dict, "name another folder") if path.exists() else {}
        grows: Sequence[str] = ("by", "rules")
        if any(held.get(k) != v for k, v in content.items() if k not in grows) or (
            held.get("by", [None])[0] != content["by"][0]
        ):
            raise ValueError(
                f"The folder {output} holds another study: name another folder, or repeat the "
                "options that it was begun with."
            )
    return content
