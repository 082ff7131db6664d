"""Checks that arguments share."""

from __future__ import annotations

from math import isfinite
from numbers import Real


def is_number(value: object) -> bool:
    """Whether a value is one finite real number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
