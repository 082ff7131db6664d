"""Keyword arguments of the environments, checked at the door."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from kfenv.checks import is_number
from kfenv.envs.knobs import MOST_FADING
from kfenv.envs.rewards import DENSE
from kfenv.names import unknown
from kfenv.scenarios.recording import Recording

OBSERVATIONS = SHORT, FULL = "short", "full"
REWARDS = ("rmse", "log-rmse", *DENSE)
LONGEST_INTERVAL = 1_000_000  # filter steps of a decision
ENGINE = "srukf-joseph-exact"
GAUSSIAN_SUMS = ("gsekf", "gsckf")

# Arguments with a real log, and whom it is for.
LOGS = {
    "plots": "plots are for the radars and BistaticTracking",
    "rinex": "a RINEX log is for GnssTracking",
    "log": "an inertial log is for InsGnss",
}


@dataclass(frozen=True)
class Options:
    """What an environment does with its episodes; see the environments' pages."""

    reward: str = "rmse"
    observation: str = SHORT
    actions: Sequence[str] | None = None
    most_fading: float = MOST_FADING
    recording: Recording | None = None
    decision_interval: int | None = None  # that of the scenario's measurements
    filter: str = ENGINE
    kappa: float = 1.0

    def __post_init__(self) -> None:
        if self.reward not in REWARDS:
            raise ValueError(unknown("reward", self.reward, REWARDS))
        if self.observation not in OBSERVATIONS:
            raise ValueError(unknown("observation", self.observation, OBSERVATIONS))
        interval = self.decision_interval
        whole = isinstance(interval, int) and not isinstance(interval, bool)
        if interval is not None and not (whole and 1 <= interval <= LONGEST_INTERVAL):
            raise ValueError(
                f"decision_interval must be a whole number of filter steps from 1 to "
                f"{LONGEST_INTERVAL:,}, got {interval!r}."
            )
        if self.actions is not None and not isinstance(self.actions, Sequence):
            raise ValueError(
                f"actions must be a list of knob names, or None for all, got {self.actions!r}."
            )
        if not is_number(self.most_fading) or self.most_fading <= 1.0:
            raise ValueError(f"most_fading must be a number above 1, got {self.most_fading!r}.")
        if not isinstance(self.filter, str):
            raise ValueError(f"filter must be the name of a filter, got {self.filter!r}.")
        if not is_number(self.kappa):
            raise ValueError(f"kappa must be a finite number, got {self.kappa!r}.")
        if self.mixture and self.kappa != 1.0:
            raise ValueError(f"The filter {self.filter!r} has no kappa to set: leave it out.")
        if self.recording is not None and not isinstance(self.recording, Recording):
            raise ValueError(
                f"recording must be a kfenv Recording, got {type(self.recording).__name__}."
            )

    @property
    def mixture(self) -> bool:
        """Whether the filter is a Gaussian sum, which has an outlier weight to turn."""
        return self.filter in GAUSSIAN_SUMS


def split_keywords(scenario_class: type, keywords: dict[str, Any]) -> tuple[Any, Options]:
    """Build the scenario and the options that keyword arguments describe.

    Raises:
        TypeError: for a keyword that neither knows.
        ValueError: for a value that one of them refuses.
    """
    of_scenario = [item.name for item in fields(scenario_class)]
    of_options = [item.name for item in fields(Options)]
    for name in keywords:
        if name not in of_scenario and name not in of_options:
            if name in LOGS:
                raise TypeError(f"{scenario_class.__name__} takes no {name}: {LOGS[name]}.")
            raise TypeError(unknown("keyword argument", name, of_scenario + of_options))
    options = Options(**{k: v for k, v in keywords.items() if k in of_options})
    scenario = scenario_class(**{k: v for k, v in keywords.items() if k in of_scenario})
    return scenario, options


def check_recording(recording: Recording, scenario: Any) -> None:
    """Complain if a recording does not fit the scenario's motion and sensor.

    Raises:
        ValueError: naming the dimension that differs.
    """
    longest = scenario.longest_step
    if np.diff(recording.time).max() > longest:
        raise ValueError(
            f"The recording has a gap of {np.diff(recording.time).max():g} s; the motion models "
            f"take steps of up to {longest:g} s: add instants in between whose measurements "
            "are NaN."
        )
    inputs = scenario.dimensions
    pairs = (
        ("states", recording.mean.shape[1], len(scenario.motion.states)),
        ("channels", recording.measurement.shape[2], len(scenario.sensor.channels)),
        ("motion inputs", recording.motion_inputs.shape[2], inputs[0]),
        ("sensor inputs", recording.sensor_inputs.shape[2], inputs[1]),
    )
    for what, have, want in pairs:
        if have != want:
            raise ValueError(
                f"The recording has {have} {what}, but {scenario.name} works with {want}."
            )
