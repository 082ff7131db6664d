"""What a log's innovations tell of a filter, channel by channel, in the user's own units."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from scipy.stats import t as student

from kfenv.envs.options import Options
from kfenv.models.model import Component
from kfenv.scenarios.recording import Recording

from .criteria import squared_errors
from .innovations import instants

Array = NDArray[np.float64]

LAGS = 5
BINS = np.linspace(-5.0, 5.0, 41)  # of innovations in deviations; what lies beyond goes to the ends
QUANTILES = np.linspace(0.005, 0.995, 100)


@dataclass(frozen=True)
class Innovations:
    """Those of B episodes with one static noise (B, T, m), NaN where none arrived; and errors.

    Attributes:
        value, variance: of each channel by itself.
        nis: (B, T) of all channels that arrived together, their correlations included.
        rmse: (B,), m, None where the truth is not known.
    """

    value: Array
    variance: Array
    nis: Array
    rmse: Array | None

    @property
    def joint_nis(self) -> float:
        """Mean NIS of all channels together, per channel that arrived."""
        return float(np.nansum(self.nis) / max(np.sum(~np.isnan(self.value)), 1))

    @property
    def normalised(self) -> Array:
        """In the deviations that the filter expects."""
        return self.value / np.sqrt(self.variance)


@dataclass(frozen=True)
class ChannelReport:
    """One channel's innovations nu, and e = nu / sqrt(S), in its unit (degrees for angles).

    Attributes:
        count: that arrived.
        mean, mean_low, mean_high: of nu, with the 95 % interval over blocks of the log.
        deviation, expected: of nu; what the filter expects, the root mean square of sqrt(S).
        nis, nis_low, nis_high: mean of e^2, and between what chi-square has it in 95 % of logs.
        outlying: share of e beyond four deviations, of which a normal one has six in 1e5.
        lags, lag_bound: correlations of e with the next ones, and 1.96 / sqrt(count).
        histogram: share of e between `BINS`, those beyond counted at the ends.
        quantiles: of e at `QUANTILES`.
    """

    name: str
    group: str
    unit: str
    count: int
    mean: float
    mean_low: float
    mean_high: float
    deviation: float
    expected: float
    nis: float
    nis_low: float
    nis_high: float
    outlying: float
    lags: tuple[float, ...]
    lag_bound: float
    histogram: tuple[float, ...]
    quantiles: tuple[float, ...]

    @property
    def biased(self) -> bool:
        """Whether the mean is beyond its interval, and not small."""
        return not self.mean_low <= 0.0 <= self.mean_high and (
            abs(self.mean) > 0.2 * self.deviation
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"biased": self.biased}


def filter_innovations(
    scenario: Any, options: Options, recording: Recording, left: Array, noise: Array
) -> Innovations:
    """Filter the episodes with one static noise, L (n, n) and r (m,)."""
    value, variance = np.full((2, *recording.measurement.shape), np.nan)
    nis = np.full(value.shape[:2], np.nan)
    mean = np.full((*recording.measurement.shape[:2], recording.mean.shape[1]), np.nan)
    for t, update, _, sound in instants(scenario, options, recording, left[None], noise[None]):
        value[sound, t], variance[sound, t] = update.innovation[sound], update.variance[sound]
        mean[sound, t], nis[sound, t] = update.mean[sound], update.nis[sound]
    if recording.truth is None or not recording.scored_instants.all():
        return Innovations(value, variance, nis, None)
    squared, known = squared_errors(scenario, recording, mean[None])
    rmse = np.sqrt(squared[0].sum(axis=1) / known.sum(axis=1))
    return Innovations(value, variance, nis, rmse)


def channel_report(
    channel: Component, innovations: Innovations, c: int, blocks: NDArray[np.int64]
) -> ChannelReport | None:
    """Of the channel of that index; None where nothing arrived."""
    unit, scale = ("deg", np.degrees(1.0)) if channel.angle else (channel.unit, 1.0)
    value = scale * innovations.value[..., c]
    e = innovations.normalised[..., c]
    here = ~np.isnan(value)
    count = int(here.sum())
    if count == 0:
        return None
    mean, low, high = _mean_with_interval(value, here, blocks)
    nis = float(np.mean(e[here] ** 2))
    bounds = chi2.ppf([0.025, 0.975], count) / count
    histogram, _ = np.histogram(np.clip(e[here], BINS[0], BINS[-1]), BINS)
    return ChannelReport(
        channel.name, channel.group, unit, count, mean, low, high, float(np.std(value[here])),
        float(scale * np.sqrt(np.mean(innovations.variance[..., c][here]))), nis, *bounds.tolist(),
        float(np.mean(np.abs(e[here]) > 4.0)), lag_correlations(e), 1.96 / np.sqrt(count),
        tuple((histogram / count).tolist()), tuple(np.quantile(e[here], QUANTILES).tolist()),
    )  # fmt: skip


def _mean_with_interval(
    value: Array, here: NDArray[np.bool_], blocks: NDArray[np.int64]
) -> tuple[float, float, float]:
    """The mean, with Student's interval of its delete-one-block jackknife."""
    total = np.bincount(blocks[here], value[here], blocks.max() + 1)
    count = np.bincount(blocks[here], minlength=blocks.max() + 1)
    mean, used = total.sum() / count.sum(), count > 0
    n = int(used.sum())
    if n < 2:
        return mean, -np.inf, np.inf
    without = (total.sum() - total[used]) / np.maximum(count.sum() - count[used], 1)
    spread = np.sqrt((n - 1) / n * np.sum((without - without.mean()) ** 2))
    half = student.ppf(0.975, n - 1) * spread
    return float(mean), float(mean - half), float(mean + half)


def lag_correlations(e: Array) -> tuple[float, ...]:
    """Correlations of a channel's innovations (B, T) with those one to five arrivals later."""
    rows = [row[~np.isnan(row)] for row in e]
    square = sum(float(row @ row) for row in rows)
    told = []
    for lag in range(1, LAGS + 1):
        product = sum(float(row[lag:] @ row[:-lag]) for row in rows if len(row) > lag)
        told.append(product / square if square > 0.0 else 0.0)
    return tuple(told)


def expected_quantiles() -> Array:
    """Of a standard normal at `QUANTILES`."""
    return norm.ppf(QUANTILES)
