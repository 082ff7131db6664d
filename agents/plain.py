"""Keyword arguments as plain JSON; objects in words that tell in any process if they changed."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from kfenv.filters.fingerprint import fingerprint

LONGEST = 200  # characters of an object's own words


def plain(value: Any) -> Any:
    """The value with dictionaries, lists, texts and numbers alone."""
    return json.loads(json.dumps(value, default=_in_words))


def _in_words(value: Any) -> Any:
    """Paths and small arrays as plain values; objects in their words, or by their fingerprint."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.size < LONGEST):
        return value.tolist()
    words = repr(value)
    if " at 0x" not in words and len(words) <= LONGEST:
        return words
    return f"{getattr(value, '__name__', type(value).__name__)} {fingerprint(value)}"
