"""An acceleration that comes and goes: a first-order Markov process (Singer 1970)."""

from __future__ import annotations

from functools import partial
from math import factorial, sqrt
from types import ModuleType

from kfenv.checks import is_number
from kfenv.models.kinematics import NOISE_PATTERN, POSITION, STATES, VELOCITY
from kfenv.models.model import Motion, MotionFunctions

LEAST_TIME = 1.0  # s
TERMS = 14  # of the series in dt / time constant: 1e-13 at 1
COVARIANCE_TERMS = 18


def markov_acceleration(deviation: float = 1.5, time_constant: float = 10.0) -> Motion:
    """A vehicle that speeds up, slows down and turns now and then: a' = -a / tau + w.

    Between two fixes half a minute apart its speed grows by chance rather than by an
    acceleration carried on, as that of `constant_acceleration` would; at rest it is as good as
    in motion. Singer, Estimating optimal tracking filter performance for manned
    maneuvering targets, IEEE Trans. AES-6 (1970), eqs. 10 to 18: the series of
    his transition and covariance, which lose no digits at a short step. Keep dt <= 1 s.

    Args:
        deviation: of the acceleration along each axis, m/s^2.
        time_constant: tau, s, 1 or more.

    Raises:
        ValueError: if the deviation is not positive or the time constant below 1 s.
    """
    if not is_number(deviation) or not deviation > 0.0:
        raise ValueError(f"deviation must be a positive number of m/s^2, got {deviation!r}.")
    if not is_number(time_constant) or not time_constant >= LEAST_TIME:
        raise ValueError(
            f"time_constant must be a number of seconds, {LEAST_TIME:g} or more, got "
            f"{time_constant!r}."
        )
    build = partial(
        _build, decay=1.0 / time_constant, root_density=deviation * sqrt(2.0 / time_constant)
    )
    return Motion("markov-acceleration", STATES, POSITION, VELOCITY, NOISE_PATTERN, build)


def _build(xp: ModuleType, decay: float, root_density: float) -> MotionFunctions:
    # A unit of acceleration after dt, and what it adds to speed (per dt) and place (per dt^2)
    series = tuple(tuple(1.0 / factorial(k + m) for k in range(TERMS)) for m in range(3))
    covariance = _covariance_series()

    @xp.function
    def summed(coefficients, y):
        total = 0.0 * y
        for k in range(len(coefficients)):
            total = total * y + coefficients[len(coefficients) - 1 - k]
        return total

    a_series, v_series, p_series = series

    @xp.function
    def step(x, u, dt):
        px, vx, ax, py, vy, ay, pz, vz, az = x
        y = -decay * dt
        kept, sped, moved = summed(a_series, y), summed(v_series, y), summed(p_series, y)
        s, d = sped * dt, moved * dt * dt
        return (
            px + dt * vx + d * ax, vx + s * ax, kept * ax,
            py + dt * vy + d * ay, vy + s * ay, kept * ay,
            pz + dt * vz + d * az, vz + s * az, kept * az,
        )  # fmt: skip

    c11, c12, c13, c22, c23, c33 = covariance

    @xp.function
    def noise_factor(x, u, dt):
        y = -decay * dt + 0.0 * x[0]  # of the state's shape, whatever the backend
        q11, q12, q13 = summed(c11, y), summed(c12, y), summed(c13, y)
        q22, q23, q33 = summed(c22, y), summed(c23, y), summed(c33, y)
        l11 = xp.sqrt(q11)
        l21, l31 = q12 / l11, q13 / l11
        l22 = xp.sqrt(q22 - l21 * l21)
        l32 = (q23 - l31 * l21) / l22
        l33 = xp.sqrt(q33 - l31 * l31 - l32 * l32)
        s = root_density * xp.sqrt(dt + 0.0 * x[0])
        sv, sp = s * dt, s * dt * dt
        axis = (sp * l11, sv * l21, sv * l22, s * l31, s * l32, s * l33)
        return axis + axis + axis

    return MotionFunctions(step, noise_factor)


def _covariance_series() -> tuple[tuple[float, ...], ...]:
    """Power series in -dt / tau of the covariance at unit density, in units of dt as above.

    The integral over tau in [0, 1] of phi_i phi_j, where phi_m is the sum of
    y^k tau^(k + m) / (k + m)!, m being 2, 1 and 0 for place, speed and acceleration.
    """
    pairs = ((2, 2), (2, 1), (2, 0), (1, 1), (1, 0), (0, 0))
    return tuple(
        tuple(
            sum(
                1.0 / (factorial(i + m) * factorial(k - i + n) * (k + m + n + 1))
                for i in range(k + 1)
            )
            for k in range(COVARIANCE_TERMS)
        )
        for m, n in pairs
    )
