"""Rules that leave single satellites out: what a receiver's integrity monitoring does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from kfenv.models.gnss.pseudorange import CHANNELS

from ..agent import Array, Briefing, Parameter, knob_actions
from .innovation import NOISE, PROCESS_NOISE
from .satellites import RANGES, RATES, SatelliteRule, unexplained

EXCLUDED = 500.0  # noise factor of a satellite that is left out
MOST = 3  # satellites that one epoch may leave out
LEAST = 5  # satellites that must remain
WILD = 3.0  # deviations that a mean takes of one innovation


class Raim(SatelliteRule):
    """Fault detection and exclusion at each epoch by itself (Parkinson and Axelrad 1988).

    The innovations of all satellites are tested together against the chi-square quantile that
    only a share `tail` exceeds; while they fail, the satellite with the greatest w (Baarda
    1968) of range or rate is left out, three at most. Where that does not help nobody is left
    out, and the noise of all is raised until the test is passed.
    """

    parameters = (Parameter("tail", 1e-30, 0.5, 1e-3), NOISE, PROCESS_NOISE)

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        freedom = np.maximum(np.arange(2 * CHANNELS + 1) - 2, 1)  # two for the clock
        self._limit = chi2.isf(self.values["tail"], freedom) / freedom

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        arrived, scale = ~np.isnan(info["innovation"]), self.values["noise"]
        excluded = np.zeros(arrived.shape, bool)
        ratio, size = self._test(info, excluded)
        whole = ratio
        for _ in range(MOST):
            remain = np.sum(arrived[:, RANGES] & ~excluded[:, RANGES], axis=1)
            failed = np.flatnonzero((ratio > 1.0) & (remain > LEAST))
            if not len(failed):
                break
            worst = np.argmax(np.maximum(size[:, RANGES], size[:, RATES]), axis=1)[failed]
            excluded[failed, worst] = excluded[failed, CHANNELS + worst] = True
            ratio, size = self._test(info, excluded)
        raised = np.where(ratio > 1.0, np.sqrt(np.maximum(whole, 1.0)), 1.0)[:, None]
        left_out = excluded & (ratio <= 1.0)[:, None]
        factor = np.where(arrived, np.where(left_out, EXCLUDED, scale * raised), np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)

    def _test(self, info: Mapping[str, Any], excluded: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Chi-square per degree of freedom over its limit (B,), and |w| (B, 24) of those used."""
        arrived = ~np.isnan(info["innovation"])
        used, factor = arrived & ~excluded, np.where(excluded, EXCLUDED, self.values["noise"])
        residual, deviation = unexplained(info, np.where(arrived, factor, 1.0))
        weighted = np.where(used, info["innovation"] * residual / deviation**2, 0.0)
        count = used.sum(axis=1)
        mean = weighted.sum(axis=1) / np.maximum(count - 2, 1)
        return mean / self._limit[count], np.where(used, np.abs(residual) / deviation, 0.0)


class SatelliteGate(SatelliteRule):
    """A satellite left out while the mean of its innovations is beyond a gate.

    w of each channel beside the others, over the median size of its group's where that is
    above one, and at most three of it; their exponential mean over `window` epochs is compared
    with `gate` of its deviations, and readmitted below half of that, so that a slow ramp adds
    up and a burst of noise blames nobody. The others' noise follows their median size.
    """

    parameters = (
        Parameter("window", 1.0, 60.0, 5.0),
        Parameter("gate", 1.5, 20.0, 3.0),
        Parameter("noise_window", 1.0, 60.0, 3.0),
        PROCESS_NOISE,
    )

    def reset(self, briefing: Briefing) -> None:
        super().reset(briefing)
        self._mean = np.zeros((briefing.batch, 2 * CHANNELS))
        self._scale = np.ones((briefing.batch, 2 * CHANNELS))
        self._excluded = np.zeros((briefing.batch, CHANNELS), bool)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> Array:
        arrived = ~np.isnan(info["innovation"])
        w = self._sizes(info, arrived)
        window, gate = self.values["window"], self.values["gate"]
        median = self._medians(w)
        bounded = np.clip(np.nan_to_num(w) / np.maximum(median, 1.0), -WILD, WILD)
        self._mean += np.where(arrived, (bounded - self._mean) / window, 0.0)
        self._scale *= np.clip(median, 0.1, 10.0) ** (1.0 / self.values["noise_window"])
        self._scale = np.clip(self._scale, 0.05, 100.0)
        size = np.abs(self._mean) * np.sqrt(2.0 * window - 1.0)
        size = np.maximum(size[:, RANGES], size[:, RATES])
        self._excluded = size > np.where(self._excluded, 0.5 * gate, gate)
        excluded = np.tile(self._excluded, 2)
        factor = np.where(arrived, np.where(excluded, EXCLUDED, self._scale), np.nan)
        return knob_actions(self.briefing, 1.0, self.values["process_noise"], factor)

    def _sizes(self, info: Mapping[str, Any], arrived: NDArray[np.bool_]) -> Array:
        """w (B, 24), that of an excluded channel with the noise that it would have."""
        factor = np.where(np.tile(self._excluded, 2), EXCLUDED, self._scale)
        residual, deviation = unexplained(info, np.where(arrived, factor, 1.0))
        own = deviation**2 - (factor**2 - self._scale**2) * info["noise"] ** 2
        return residual / np.sqrt(np.maximum(own, (self._scale * info["noise"]) ** 2))

    def _medians(self, w: Array) -> Array:
        """Of |w| over the deviation's, for each channel its group's; 1 where too few are used."""
        used = ~np.isnan(w) & ~np.tile(self._excluded, 2)
        medians = np.ones(w.shape)
        for part in (RANGES, RATES):
            rows = np.flatnonzero(used[:, part].sum(axis=1) >= LEAST)
            sizes = np.where(used, np.abs(w), np.nan)[rows, part]
            medians[rows, part] = np.nanmedian(sizes, axis=1, keepdims=True) / 0.6745
        return medians
