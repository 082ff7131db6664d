"""How the time of a real log is shared out, and what a filter misses where no truth is known.

A log's time is divided, in its order, into a part to train and tune on, one to validate
and one to test on, so that no agent is tested on what it was tuned on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Shares of the log's time; "tuning" is for training too
PARTS = {"tuning": (0.0, 0.3), "validation": (0.3, 0.5), "test": (0.5, 1.0)}

# Without a truth the filter misses the last of every six stretches of 10 s (less in a window
# below a minute), or of a measurement each
WITHHELD, EVERY = 10.0, 6


def withheld(time: Array, least: float, most: float = WITHHELD) -> NDArray[np.bool_]:
    """Instants (..., T) of windows at which the filter gets nothing, so that it can be judged.

    Args:
        time: (..., T) since each window began, s.
        least, most: of a stretch, s.
    """
    stretch = np.maximum(np.minimum(most, time[..., -1:] / EVERY), least)
    return np.floor(time / stretch + 1e-6) % EVERY == EVERY - 1


def no_room(path: str, whole: float, part: str, duration: float, what: str) -> ValueError:
    """The complaint that a log of `whole` seconds is too short."""
    low, high = PARTS[part]
    return ValueError(
        f"{path}: the part for {part} ({100 * (high - low):.0f} % of {whole:g} s) "
        f"has no room for {what} of {duration:g} s; give a longer log or a shorter duration."
    )
