"""What may happen to the noise, for the contestants that know the faults but not when they strike.

Every factor of a noise's deviation stands on one logarithmic grid, so that a product of
factors is a sum of whole numbers: the power of `RATIO`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log, prod, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kfenv.scenarios.faults import Glint, Jamming, NoiseMisreport, Range, resolve_faults
from kfenv.scenarios.gnss.faults import MultipathBurst
from kfenv.scenarios.inertial.faults import Interference, Outliers

RATIO = 15.5 ** (1 / 12)  # a twelfth of the way from 2 to 31: a factor is met within 12 %
POWERS_PER_LEVEL = 3


@dataclass(frozen=True)
class FaultModel:
    """Noise as a Markov chain of levels, with outliers and a wrong scale on top.

    A channel's actual deviation is the told one times RATIO ** (level + glint + misreport).
    The level is common to all channels, a glint hits one measurement as a whole, and each
    channel has a misreport of its own that stays for the episode.

    Attributes:
        levels: powers, the first 0: undisturbed.
        up: rate at which a disturbed level begins, 1/s, each of them alike.
        down: rate at which it ends, 1/s.
        glint: power of an outlier.
        glint_share: of the measurements in an episode that has outliers.
        glint_chance: that an episode has any.
        misreport: powers, all alike at the beginning.
    """

    levels: tuple[int, ...] = (0,)
    up: float = 0.0
    down: float = 0.0
    glint: int = 0
    glint_share: float = 0.0
    glint_chance: float = 0.0
    misreport: tuple[int, ...] = (0,)

    @classmethod
    def of(cls, scenario: Any) -> FaultModel:
        """The model of a scenario's faults.

        Bursts (`Jamming`, `MultipathBurst`) make the levels, outliers (`Glint`, `Outliers`,
        `Interference`) the glint: of several kinds the geometric mean factor. Errors that
        are no noise, and faults of one's own making, are not in it.
        """
        faults = resolve_faults(scenario.faults, scenario.presets, scenario.known_faults)
        return cls(
            **_bursts(faults, scenario.duration), **_outliers(faults), misreport=_misreport(faults)
        )

    def with_glint_share(self, share: float) -> FaultModel:
        """The model with another share of outliers, if it has any."""
        return replace(self, glint_share=share) if self.glint_share > 0.0 else self


def factors(powers: tuple[int, ...] | NDArray[np.int64]) -> NDArray[np.float64]:
    """The factors of a noise's deviation that the powers stand for."""
    return RATIO ** np.asarray(powers, dtype=float)


def power(factor: float) -> int:
    """The power nearest to a factor."""
    return round(log(factor) / log(RATIO))


def _bursts(faults: tuple, duration: float) -> dict[str, Any]:
    bursts = [fault for fault in faults if isinstance(fault, Jamming | MultipathBurst)]
    if not bursts:
        return {}
    low = power(min(fault.factor[0] for fault in bursts))
    high = power(max(fault.factor[1] for fault in bursts))
    raised = np.linspace(low, high, max(1, round((high - low) / POWERS_PER_LEVEL)) + 1)
    number = sum(np.mean(getattr(fault, "bursts", 1)) for fault in bursts)
    length = np.mean([fault.duration for fault in bursts])
    return {
        "levels": tuple(dict.fromkeys((0, *(round(level) for level in raised)))),
        "up": float(number / duration),
        "down": float(1.0 / length),
    }


def _outliers(faults: tuple) -> dict[str, Any]:
    kinds = [kind for fault in faults for kind in _outlier(fault)]
    if not kinds:
        return {}
    chance = 1.0 - prod(1.0 - chance for chance, _, _ in kinds)
    share = sum(chance * share for chance, share, _ in kinds) / chance
    mean = np.mean([log(factor) for _, _, factor in kinds])
    return {
        "glint": power(float(np.exp(mean))), "glint_share": min(share, 1.0),
        "glint_chance": chance,
    }  # fmt: skip


def _outlier(fault: Any) -> list[tuple[float, float, float]]:
    """A fault's chance, share and factor of outliers, if it has any."""
    if isinstance(fault, Glint) and fault.probability * fault.fraction > 0.0:
        return [(fault.probability, fault.fraction, fault.factor)]
    if isinstance(fault, Outliers) and fault.share > 0.0:
        return [(1.0, fault.share, sqrt(fault.variance_ratio))]
    if isinstance(fault, Interference):
        return [(1.0, float(np.mean(fault.share)), _middle(fault.factor))]
    return []


def _misreport(faults: tuple) -> tuple[int, ...]:
    """Actual over told deviation is the inverse of the fault's factor."""
    low = high = 0
    for fault in faults:
        if isinstance(fault, NoiseMisreport):
            low, high = low - power(fault.factor[1]), high - power(fault.factor[0])
    return tuple(range(low, high + 1))


def _middle(pair: Range) -> float:
    return sqrt(pair[0] * pair[1])
