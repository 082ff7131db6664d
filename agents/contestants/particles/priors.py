"""How a scenario's faults on the noise are drawn, as hazards of what comes next."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.faults import Glint, Jamming, NoiseMisreport, resolve_faults
from kfenv.scenarios.recording import Recording

Array = NDArray[np.float64]
LENGTHS = 400  # of bursts, over which the density of starts is averaged


@dataclass(frozen=True)
class NoisePriors:
    """What `Jamming`, `Glint` and `NoiseMisreport` say of an episode, exactly.

    Bursts of one `Jamming` start independently; where they overlap, the later one's age is
    kept and the stronger one's factor.

    Attributes:
        start: (T, N + 1) chance that a burst starts at an instant, by the number so far.
        ending: shortest and longest burst, s.
        factor: range of a burst's factor.
        glint_chance, glint_share, glint_factor: of `Glint`.
        misreport: range of the log of actual over told deviation.
    """

    start: Array
    ending: tuple[float, float]
    factor: tuple[float, float]
    glint_chance: float
    glint_share: float
    glint_factor: float
    misreport: tuple[float, float]

    @classmethod
    def of(cls, scenario: Any, recording: Recording) -> NoisePriors:
        """Of a scenario's faults, on a recording's instants.

        Raises:
            ValueError: if it has two faults of a kind, or a burst's start is fixed.
        """
        faults = resolve_faults(scenario.faults, scenario.presets, scenario.known_faults)
        jamming = _only(faults, Jamming) or Jamming(bursts=(0, 0))
        glint = _only(faults, Glint) or Glint(probability=0.0)
        misreport = _only(faults, NoiseMisreport) or NoiseMisreport(factor=(1.0, 1.0))
        if jamming.start is not None:
            raise ValueError("The particle filter knows bursts whose start is drawn: leave it out.")
        low, high = np.log(misreport.factor)
        return cls(
            start_chances(recording.time, jamming), tuple(jamming.duration),
            tuple(jamming.factor), glint.probability, glint.fraction, glint.factor, (-high, -low),
        )  # fmt: skip


def start_chances(time: Array, jamming: Jamming) -> Array:
    """Chance (T, N + 1) that a burst starts in the step up to an instant, k having started.

    Each starts uniformly where it has room. Of N bursts, as likely as any other number, k have
    started by now with probability proportional to C(N, k) later^(N - k), `later` being the
    chance that one of them starts after now.
    """
    lengths = np.linspace(*jamming.duration, LENGTHS)
    room = np.maximum(time[-1] - time[0] - lengths, 1e-9)
    later = np.clip(1.0 - (time[:, None] - time[0]) / room, 0.0, 1.0).mean(axis=1)
    before = np.concatenate([[1.0], later[:-1]])
    least, most = (int(number) for number in jamming.bursts)
    numbers = np.arange(least, most + 1)
    chances = np.zeros((len(time), most + 1))
    for k in range(most + 1):
        ways = np.array([comb(number, k) for number in numbers])
        left = np.maximum(numbers - k, 0)
        weight = ways * before[:, None] ** left
        total = weight.sum(axis=1)
        remaining = (weight @ left) / np.where(total > 0.0, total, 1.0)
        one = np.where(before > 0.0, (before - later) / np.where(before > 0.0, before, 1.0), 0.0)
        chances[:, k] = np.minimum(remaining * one, 1.0)
    return chances


def _only(faults: tuple, kind: type) -> Any:
    found = [fault for fault in faults if isinstance(fault, kind)]
    if len(found) > 1:
        raise ValueError(f"The particle filter knows one {kind.__name__} a scenario: merge them.")
    return found[0] if found else None
