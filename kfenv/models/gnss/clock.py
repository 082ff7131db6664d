"""A receiver's clock beside its motion: bias and drift, 11 states (SPEC 1, 3.4)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import ModuleType

from kfenv.checks import is_number
from kfenv.models.model import Component, Motion, MotionFunctions

CLOCK_STATES = (Component("clock bias", "m"), Component("clock drift", "m/s"))


def with_clock(
    motion: Motion, spectral_density: float = 0.1, white_frequency: float = 0.0
) -> Motion:
    """The motion with clock bias Cb (m) and drift Cd (m/s) behind its states.

    Cb' = Cd, Cd' = w. Discrete noise: q_c [[dt^3/3, dt^2/2], [dt^2/2, dt]], which S0
    eq 49 leaves out, and white frequency noise S_f dt on Cb.

    Args:
        motion: e.g. `kfenv.models.variable_turn.variable_turn`, of any number of states.
        spectral_density: q_c of the drift's white driving noise, (m/s)^2/s.
        white_frequency: S_f, m^2/s.

    Raises:
        ValueError: if q_c is not positive or S_f is negative.
    """
    if not is_number(spectral_density) or not spectral_density > 0.0:
        raise ValueError(
            f"The clock's spectral_density must be a positive number of (m/s)^2/s, got "
            f"{spectral_density!r}."
        )
    if not is_number(white_frequency) or white_frequency < 0.0:
        raise ValueError(
            f"white_frequency must be a number of m^2/s, 0 or more, got {white_frequency!r}."
        )
    n = len(motion.states)
    return Motion(
        f"{motion.name} with clock",
        motion.states + CLOCK_STATES,
        motion.position,
        motion.velocity,
        (*motion.noise_pattern, (n, n), (n + 1, n), (n + 1, n + 1)),
        partial(
            _build,
            base=motion.build,
            n=n,
            density=float(spectral_density),
            white_frequency=float(white_frequency),
        ),
        motion.inputs,
    )


def _build(
    xp: ModuleType,
    base: Callable[[ModuleType], MotionFunctions],
    n: int,
    density: float,
    white_frequency: float,
) -> MotionFunctions:
    move, move_noise = base(xp)

    @xp.function
    def step(x, u, dt):
        return (*move(x[:n], u, dt), x[n] + dt * x[n + 1], x[n + 1])

    @xp.function
    def noise_factor(x, u, dt):
        dt_like = dt + 0.0 * x[0]  # of the state's shape, whatever the backend
        bias = density * dt_like * dt * dt / 3.0 + white_frequency * dt_like
        l11 = xp.sqrt(bias)
        l21 = 0.5 * density * dt * dt / l11
        l22 = xp.sqrt(density * dt_like - l21 * l21)
        return (*move_noise(x[:n], u, dt), l11, l21, l22)

    return MotionFunctions(step, noise_factor)
