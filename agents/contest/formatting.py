"""How tables write the results of a contest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import expm1
from typing import Any


def short(number: float) -> str:
    """Three digits, or a whole number where that needs more."""
    return f"{number:.3g}" if abs(number) < 1000.0 or abs(number) >= 1e5 else f"{number:.0f}"


def consistency(mean: float | None) -> str:
    """A mean of NEES or NIS per degree of freedom."""
    if mean is None:
        return "-"
    if not 0.01 <= mean <= 999.0:
        return "<0.01" if mean < 0.01 else ">999"
    return f"{mean:.2g}" if mean < 9.95 else f"{mean:.0f}"


def nis(means: Mapping[str, float | None]) -> str:
    """That of each group, or of all channels together where a filter does not tell more."""
    everything, *groups = means.values()
    told = [mean for mean in groups if mean is not None]
    return "/".join(consistency(mean) for mean in (groups if told else [everything]))


def cost(relative: float | None) -> str:
    """CPU time relative to the bare engine's."""
    return "-" if relative is None else short(relative)


def improvement(result: Mapping[str, Any]) -> str:
    """How far the error is below the nominal filter's, in per cent, with its interval."""
    keys = ("improvement_over_fixed", "ci_low", "ci_high")
    return with_interval([result[key] for key in keys], lambda share: f"{100.0 * share:+.0f}")


def ratio(result: Mapping[str, Any]) -> str:
    """How much larger the error is than the rival's, in per cent, with its interval."""
    keys = ("log_ratio", "log_ratio_ci_low", "log_ratio_ci_high")
    return with_interval([result[key] for key in keys], lambda log: f"{100.0 * expm1(log):+.0f}")


def with_interval(numbers: Sequence[float | None], written: Callable[[float], str]) -> str:
    """A number with the ends of its interval, as far as there are any."""
    middle, *ends = ("-" if number is None else written(number) for number in numbers)
    return middle if numbers[1] is None else f"{middle} ({', '.join(ends)})"
