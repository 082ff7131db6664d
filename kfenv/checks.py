"""Checks that arguments share."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from numbers import Real
from typing import Any

LARGEST = 1e20  # what a file may tell: whatever is counted, it is less, and its square a number


def is_number(value: object) -> bool:
    """Whether a value is one finite real number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)


def gathered(*checks: Callable[[], Any]) -> list[Any]:
    """What the checks return; if any complain, all complaints in one, line by line.

    Raises:
        ValueError: with the messages of all that raised one.
    """
    results, told = [], []
    for check in checks:
        try:
            results.append(check())
        except ValueError as error:
            told += [line for line in str(error).splitlines() if line not in told]
    if told:
        raise ValueError("\n".join(told))
    return results
