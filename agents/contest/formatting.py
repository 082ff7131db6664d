"""How tables write the results of a contest."""

from __future__ import annotations

from collections.abc import Mapping
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
    middle, low, high = (f"{100.0 * result[key]:+.0f}" for key in keys)
    return f"{middle} ({low}, {high})"


def ratio(result: Mapping[str, Any]) -> str:
    """How much larger the error is than the rival's, in per cent, with its interval."""
    keys = ("log_ratio", "log_ratio_ci_low", "log_ratio_ci_high")
    middle, low, high = (f"{100.0 * expm1(result[key]):+.0f}" for key in keys)
    return f"{middle} ({low}, {high})"
