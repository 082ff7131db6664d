"""The axis-major aircraft state that the tracking models share (SPEC section 1)."""

from __future__ import annotations

from kfenv.models.model import Component

STATES = tuple(
    Component(prefix + axis, unit)
    for axis in "xyz"
    for prefix, unit in (("", "m"), ("v", "m/s"), ("a", "m/s^2"))
)
POSITION = (0, 3, 6)
VELOCITY = (1, 4, 7)
ACCELERATION = (2, 5, 8)

# Each axis has its own lower 3x3 block; entries row by row.
NOISE_PATTERN = tuple(
    (3 * axis + row, 3 * axis + column)
    for axis in range(3)
    for row in range(3)
    for column in range(row + 1)
)


def check_spectral_density(density: float) -> float:
    """Return the white-jerk power spectral density, or complain.

    Raises:
        ValueError: if it is not a positive number.
    """
    if not density > 0.0 or density == float("inf"):
        raise ValueError(f"spectral_density must be a positive number of m^2/s^5, got {density!r}.")
    return float(density)
