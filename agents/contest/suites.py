"""Frozen suites: what is contested on what, with which tuning, and by which episodes one knows it.

A suite is an environment in which agents are tuned and tested, and other cases of it that
nobody was tuned to. A changed simulation draws other episodes: the hash tells, and the suite
then needs another version and results of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from kfenv.names import unknown

IN_DISTRIBUTION = "test"
FLIGHT = "a real flight"  # what a case of one is about

# What the presets "random" stand for, to be changed by parts.
BURSTS = {"jamming": {}, "signal_loss": {}, "glint": {}, "noise_misreport": {}}
RADAR = {"rain": {}} | BURSTS
GNSS = {
    "jamming": {"bursts": [0, 2]}, "clock_degradation": {}, "pll_failure": {}, "range_step": {},
    "range_ramp": {}, "multipath_burst": {}, "noise_misreport": {},
}  # fmt: skip
INERTIAL = {
    "jamming": {"bursts": [0, 1], "duration": [3.0, 10.0], "factor": [2.0, 10.0]},
    "signal_loss": {}, "glint": {}, "noise_misreport": {},
    "interference": {"factor": [3.0, 500.0**0.5]},
    "acceleration_step": {}, "rate_step": {"size": [0.5, 3.0]},
}  # fmt: skip

HARD_JAMMING = {"jamming": {"factor": [31.0, 100.0]}}
HARSH_GLINT = {"glint": {"fraction": 0.2, "factor": 20.0}}
LONG_BURSTS = {"jamming": {"duration": [40.0, 60.0]}} | HARSH_GLINT


@dataclass(frozen=True)
class Case:
    """Episodes of one kind.

    Attributes:
        what: differs from what agents were tuned to.
        kwargs: keywords of the environment that differ from the suite's.
        episodes: number of them.
    """

    what: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    episodes: int = 200


@dataclass(frozen=True)
class Suite:
    """Named contests with one tuning.

    Attributes:
        version: rises when the recordings or the cases change.
        recordings: hash of the first episodes of every case, `suite_run.hash_of`.
        env_id, kwargs: where agents are tuned, and tested on `episodes`.
        others: cases out of distribution, by name.
        seed: of all episodes; `kfenv.agents.contest.rollout.SPLITS` keeps them apart.
        tuning_episodes, tuning_trials: the budget, as of a `Contest`.
    """

    version: int
    recordings: str
    env_id: str
    kwargs: Mapping[str, Any]
    others: Mapping[str, Case]
    episodes: int = 500
    seed: int = 0
    tuning_episodes: int = 32
    tuning_trials: int = 60

    @property
    def cases(self) -> dict[str, Case]:
        """All cases, in distribution first."""
        return {IN_DISTRIBUTION: Case("as tuned", episodes=self.episodes), **self.others}


RADAR_CASES = {
    "harder-jamming": Case("jamming of 31 to 100 times", {"faults": RADAR | HARD_JAMMING}),
    "no-faults": Case("no faults", {"faults": "none"}),
    "long-bursts": Case(
        "jamming of 40 to 60 s, glint of 20 times on a fifth", {"faults": RADAR | LONG_BURSTS}
    ),
    "smooth-flights": Case("smooth and fast flights", {"flights": "smooth"}),
    "published": Case("the published case", {"faults": "paper"}),
}

SUITES = {
    "radar-2hz": Suite(
        1, "15601105d08f894e", "kfenv/RadarTracking-v0",
        {"rate": 2.0, "faults": "random"}, RADAR_CASES,
    ),
    "radar-10hz": Suite(
        1, "974b688dfac24fe0", "kfenv/RadarTracking-v0",
        {"rate": 10.0, "faults": "random"}, RADAR_CASES, tuning_episodes=16, tuning_trials=12,
    ),
    "radar-validation": Suite(
        1, "83f46af7512eca54", "kfenv/RadarValidation-v0", {"rate": 2.0, "faults": "random"},
        {
            "harder-jamming": Case("jamming of 31 to 100 times", {"faults": BURSTS | HARD_JAMMING}),
            "long-bursts": Case(
                "jamming of 40 to 60 s, glint of 20 times on a fifth",
                {"faults": BURSTS | LONG_BURSTS},
            ),
            "published": Case("the published case", {"faults": "paper"}),
            "published-10hz": Case(
                "the published case at 10 Hz", {"faults": "paper", "rate": 10.0}
            ),
        },
        tuning_trials=20,
    ),
    "bistatic": Suite(
        1, "fd7344f21a6341d9", "kfenv/BistaticTracking-v0", {"faults": "random"},
        {
            "harder-jamming": Case("jamming of 31 to 100 times", {"faults": BURSTS | HARD_JAMMING}),
            "no-faults": Case("no faults", {"faults": "none"}),
            "long-bursts": Case(
                "jamming of 20 to 30 s, glint of 20 times on a fifth",
                {"faults": BURSTS | {"jamming": {"duration": [20.0, 30.0]}} | HARSH_GLINT},
            ),
            "published": Case("the published case", {"faults": "paper"}),
        },
    ),
    "gnss": Suite(
        1, "6ca49991418ee785", "kfenv/GnssTracking-v0", {"faults": "random"},
        {
            "harder-jamming": Case(
                "jamming of 31 to 100 times",
                {"faults": GNSS | {"jamming": {"bursts": [0, 2], "factor": [31.0, 100.0]}}}, 100,
            ),
            "no-faults": Case("no faults", {"faults": "none"}, 100),
            "long-bursts": Case(
                "multipath of 10 to 60 times and a jittering clock, 30 to 60 s each",
                {"faults": GNSS | {
                    "multipath_burst": {"duration": [30.0, 60.0], "factor": [10.0, 60.0]},
                    "clock_degradation": {"duration": [30.0, 60.0]},
                }}, 100,
            ),
            "harder-spoofing": Case(
                "range steps of 50 to 200 m, ramps of 1 to 4 m/s",
                {"faults": GNSS | {
                    "range_step": {"size": [50.0, 200.0]}, "range_ramp": {"rate": [1.0, 4.0]},
                }}, 100,
            ),
            "published": Case("the published case", {"faults": "paper"}, 100),
        },
        episodes=200, tuning_episodes=16, tuning_trials=12,
    ),
    "ins-gnss": Suite(
        1, "983283a3c3841ae3", "kfenv/InsGnss-v0", {"faults": "random"},
        {
            "harder-jamming": Case(
                "a jamming burst of 10 to 31 times",
                {"faults": INERTIAL | {
                    "jamming": {"bursts": [1, 1], "duration": [3.0, 10.0], "factor": [10.0, 31.0]},
                }}, 60,
            ),
            "no-faults": Case("no faults", {"faults": "none"}, 60),
            "long-bursts": Case(
                "interference of 15 to 30 s, glint of 20 times on a fifth",
                {"faults": INERTIAL | HARSH_GLINT | {
                    "interference": {"duration": [15.0, 30.0], "factor": [3.0, 500.0**0.5]},
                }}, 60,
            ),
            "published": Case("the published case", {"faults": "paper"}, 60),
        },
        episodes=100, tuning_episodes=16, tuning_trials=8,
    ),
}  # fmt: skip


def find_suite(name: str) -> Suite:
    """The suite of that name.

    Raises:
        ValueError: if there is none.
    """
    if name not in SUITES:
        raise ValueError(unknown("suite", name, SUITES))
    return SUITES[name]
