"""Pseudoranges and their rates to twelve satellites (SPEC 4.3)."""

from __future__ import annotations

from functools import partial
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from kfenv.checks import is_number
from kfenv.models.model import Component, Sensor
from kfenv.models.namespaces import dual

Array = NDArray[np.float64]

CHANNELS = 12
BIAS, DRIFT = 9, 10  # places of the clock in the state


def pseudoranges() -> Sensor:
    """A receiver of up to twelve satellites: rho_i = R_i + Cb, rhodot_i = Rdot_i + Cd.

    Channels: rho_1..rho_12 (m, group "pseudorange"), then rhodot_1..rhodot_12 (m/s,
    group "rate"). Expects the axis-major state of `kfenv.models.kinematics` in the
    earth-fixed frame, with the clock of `kfenv.models.gnss.clock` behind it.

    The 72 inputs are, satellite by satellite, its position and velocity x, y, z, vx, vy, vz
    (m, m/s) at transmission in the earth-fixed frame of the reception, as
    `kfenv.models.gnss.orbits.Constellation.seen_from` gives them; any finite numbers
    where a channel has no satellite. Known corrections (satellite clock, troposphere,
    ionosphere) must have been taken off the measurements.
    """
    numbers = range(1, CHANNELS + 1)
    channels = tuple(Component(f"rho_{i}", "m", "pseudorange") for i in numbers) + tuple(
        Component(f"rhodot_{i}", "m/s", "rate") for i in numbers
    )
    inputs = tuple(f"{axis}_{i}" for i in numbers for axis in ("x", "y", "z", "vx", "vy", "vz"))
    return Sensor("pseudoranges", channels, _build, inputs)


def as_printed(dt: float) -> Sensor:
    """The same measurements with the Jacobian of S0's Appendix B: for the reference tier only.

    Appendix B differentiates with respect to the state dt earlier (it is H F rather than
    H), leaves the clock out of that, and has a wrong sign in the acceleration block. The
    engine and the sigma points need no Jacobian and do not differ; the designs
    "srukf-joseph" and "extended" do. It stands here so that its price can be measured
    (SPEC 4.3).

    Args:
        dt: the filter's step, s.

    Raises:
        ValueError: if dt is not a positive number.
    """
    if not is_number(dt) or not dt > 0.0:
        raise ValueError(f"dt must be a positive number of seconds, got {dt!r}.")
    sensor = pseudoranges()
    build = partial(_build_as_printed, dt=float(dt))
    return Sensor("pseudoranges as printed", sensor.channels, build, sensor.inputs)


def _build(xp: ModuleType):
    @xp.function
    def one(x, satellite):
        sx, sy, sz, svx, svy, svz = satellite
        dx, dy, dz = sx - x[0], sy - x[3], sz - x[6]
        distance = xp.sqrt(dx * dx + dy * dy + dz * dz)
        along = dx * (svx - x[1]) + dy * (svy - x[4]) + dz * (svz - x[7])
        return distance + x[BIAS], along / distance + x[DRIFT]

    @xp.function
    def measure(x, s):
        r1, d1 = one(x, s[0:6])
        r2, d2 = one(x, s[6:12])
        r3, d3 = one(x, s[12:18])
        r4, d4 = one(x, s[18:24])
        r5, d5 = one(x, s[24:30])
        r6, d6 = one(x, s[30:36])
        r7, d7 = one(x, s[36:42])
        r8, d8 = one(x, s[42:48])
        r9, d9 = one(x, s[48:54])
        r10, d10 = one(x, s[54:60])
        r11, d11 = one(x, s[60:66])
        r12, d12 = one(x, s[66:72])
        return (
            r1, r2, r3, r4, r5, r6, r7, r8, r9, r10, r11, r12,
            d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, d12,
        )  # fmt: skip

    return measure


def _build_as_printed(xp: ModuleType, dt: float):
    measure = _build(xp)
    if xp is not dual:
        return measure

    def printed(x, s):
        state = np.stack([component.value for component in x], axis=-1)
        values = measure(x, s)
        slopes = printed_jacobian(state, np.stack(s, axis=-1), dt)
        chain = slopes @ np.stack([component.gradient for component in x], axis=-2)
        return tuple(dual.Dual(y.value, chain[..., i, :]) for i, y in enumerate(values))

    return printed


def printed_jacobian(state: Array, inputs: Array, dt: float) -> Array:
    """Appendix B at states (..., 11) and inputs (..., 72): (..., 24, 11), its sign included."""
    satellite = inputs.reshape(*inputs.shape[:-1], CHANNELS, 2, 3)
    offset = satellite[..., 0, :] - state[..., None, 0:9:3]
    relative = satellite[..., 1, :] - state[..., None, 1:9:3]
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    speed = np.sum(offset * relative, axis=-1, keepdims=True) / distance
    H = np.zeros((*offset.shape[:-2], 2, CHANNELS, 11), state.dtype)
    ranges, rates = H[..., 0, :, :], H[..., 1, :, :]
    ranges[..., 0:9:3] = -offset / distance
    ranges[..., 1:9:3] = -offset / distance * dt
    ranges[..., 2:9:3] = -offset / distance * (dt * dt / 2.0)
    bent = speed * offset / distance**2
    rates[..., 0:9:3] = -relative / distance + bent
    rates[..., 1:9:3] = -(offset + relative * dt) / distance + bent * dt
    half = dt * dt / (2.0 * distance)
    rates[..., 2:9:3] = -offset / distance * dt - half * (relative + bent * distance)
    ranges[..., BIAS] = 1.0
    rates[..., DRIFT] = 1.0
    return H.reshape(*H.shape[:-3], 2 * CHANNELS, 11)
