"""Arguments of inertial navigation, checked at the door."""

from __future__ import annotations

from collections.abc import Sequence

from kfenv.checks import is_number
from kfenv.models.vehicle_constraints import CHANNELS, ZERO_RATE
from kfenv.names import unknown


def check_numbers(scenario: object, name: str, units: tuple[str, ...], zero: bool = False) -> None:
    """Complain if a field does not hold one positive (or zero) number per unit."""
    given = getattr(scenario, name)
    right = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == len(units)
    if not right or not all(is_number(v) and (v > 0.0 or (zero and v == 0.0)) for v in given):
        bound = "numbers, zero or more" if zero else "positive numbers"
        raise ValueError(
            f"{name} must hold {len(units)} {bound} ({', '.join(units)}), got {given!r}."
        )


def check_fix_noise(given: object) -> None:
    """Complain unless there are three deviations, each a positive number or one for each axis."""
    right = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == 3
    if not right or not all(_is_deviation(value) for value in given):
        raise ValueError(
            "gnss_noise must hold three deviations (position in m, velocity in m/s, attitude in "
            f"deg), each a positive number or three of them, one for each axis; got {given!r}."
        )


def _is_deviation(value: object) -> bool:
    """Whether it is a positive number, or three of them."""
    axes = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else (value,)
    return len(axes) in (1, 3) and all(is_number(number) and number > 0.0 for number in axes)


def check_constraints(names: object, has_log: bool, has_biases: bool) -> None:
    """Complain of an unknown constraint, or one that the vehicle or the filter is not for."""
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise ValueError(f"constraints must be a list of {', '.join(CHANNELS)}, got {names!r}.")
    for name in names:
        if name not in CHANNELS:
            raise ValueError(unknown("constraint", name, CHANNELS))
    if names and not has_log:
        raise ValueError("constraints are for a log of a vehicle on wheels: simulated units fly.")
    if ZERO_RATE in names and not has_biases:
        raise ValueError(f"The constraint {ZERO_RATE!r} needs biases=True: it measures them.")


def check_corrections(mounting: object, time_offset: object, has_log: bool) -> None:
    """Complain unless a unit's attitude is three angles and its clock's offset a number."""
    right = isinstance(mounting, Sequence) and not isinstance(mounting, str) and len(mounting) == 3
    if not right or not all(is_number(angle) for angle in mounting):
        raise ValueError(f"mounting must be roll, pitch and yaw in deg, got {mounting!r}.")
    if not is_number(time_offset):
        raise ValueError(f"time_offset must be a number of seconds, got {time_offset!r}.")
    if not has_log and (any(mounting) or time_offset):
        raise ValueError("mounting and time_offset correct a log: give one.")
