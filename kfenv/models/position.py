"""A position measured along three axes, as solved from reflections of GPS signals (SPEC E5)."""

from __future__ import annotations

from types import ModuleType

from kfenv.models.model import Component, Sensor


def position() -> Sensor:
    """x, y and z themselves, each with noise of its own.

    Expects the axis-major state of `kfenv.models.kinematics`.
    """
    return Sensor("position", tuple(Component(axis, "m", axis) for axis in "xyz"), _build)


def _build(xp: ModuleType):
    @xp.function
    def measure(x, s):
        return x[0], x[3], x[6]

    return measure
