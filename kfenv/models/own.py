"""Models of a user's own in few lines: one function, a list of names, a constant Q.

A function is written for one of two arithmetics, told apart by its arguments:

* with the namespace, for every backend and the compiled engine: ``f(xp)`` gives ``step(x, u, dt)``
  and ``h(xp)`` gives ``measure(x, s)``, each decorated with ``xp.function``, from and to tuples of
  components (see `kfenv.models.namespaces`);
* as plain NumPy, for the filters that need no compiled model: ``f(x, u, dt)`` and ``h(x, s)``
  with arrays x (n, N) of N states at once, u (p, N) and s (k, N). Elementwise arithmetic and
  matrix products serve arrays (n,) and (n, N) alike. A function that serves (n,) alone is called
  once per state, and a warning says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from inspect import Parameter, signature
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kfenv.models.covariances import positive_semidefinite_factor
from kfenv.models.model import Component, Motion, MotionFunctions, Sensor
from kfenv.models.numpy_function import NumpyFunction
from kfenv.models.probe import probe_motion, probe_sensor


def own_motion(
    states: Sequence[Component | str],
    f: Callable,
    Q: ArrayLike,
    inputs: Sequence[str] = (),
    name: str = "own motion",
) -> Motion:
    """A motion model of one's own, tried out at once.

    Args:
        states: the n components of the state; of a plain name the unit is not told, and it is
            no angle. States of a `Component.group` get a knob of their process noise.
        f: where a state is dt later, in one of the two ways above.
        Q: (n, n) covariance of a step's process noise, or (n,) its diagonal, for every step
            the same. For one that depends on state or dt make a `Motion` with its ``noise_factor``.
        inputs: names of the p known inputs u.

    Raises:
        ValueError: if Q is no covariance or f does not do what it should, in one sentence.
    """
    components = tuple(_component(state) for state in states)
    factor = positive_semidefinite_factor("Q", Q, len(components))
    pattern = tuple((int(i), int(j)) for i, j in zip(*np.nonzero(factor), strict=True))
    entries = tuple(float(factor[place]) for place in pattern)
    if _is_numpy(f, 3):
        f = NumpyFunction.tried("f", f, len(components), len(components), len(inputs), dt=True)
    build = partial(_build_motion, f=f, entries=entries)
    motion = Motion(name, components, (), (), pattern, build, tuple(inputs))
    probe_motion(motion)
    return motion


def own_sensor(
    channels: Sequence[Component | str],
    h: Callable,
    states: int,
    inputs: Sequence[str] = (),
    name: str = "own sensor",
) -> Sensor:
    """A sensor of one's own, tried out at once.

    Args:
        channels: the m measured components; of a plain name the unit is not told, and it is no
            angle. Channels of a `Component.group` share a noise knob; without one each has its
            own.
        h: what is measured of a state, in one of the two ways above.
        states: n, of the motion that it goes with.
        inputs: names of the k known inputs s.

    Raises:
        ValueError: if h does not do what it should, in one sentence.
    """
    components = tuple(map(_component, channels))
    components = tuple(replace(c, group=c.group or c.name) for c in components)
    if _is_numpy(h, 2):
        h = NumpyFunction.tried(
            "h", h, states, len(components), len(inputs), angles=[c.angle for c in components]
        )
    sensor = Sensor(name, components, partial(_build_sensor, h=h), tuple(inputs))
    probe_sensor(sensor, states)
    return sensor


def is_compilable(model: Motion | Sensor) -> bool:
    """Whether a model is written with the namespace, so that the engine can run it."""
    return numpy_function(model) is None


def numpy_function(model: Motion | Sensor) -> NumpyFunction | None:
    """The NumPy function that a model is written as, if it is one."""
    keywords = getattr(model.build, "keywords", {})
    return next((value for value in keywords.values() if isinstance(value, NumpyFunction)), None)


def constant_noise(motion: Motion) -> tuple[float, ...] | None:
    """The entries at ``Motion.noise_pattern`` of a motion whose Q is constant, None for others."""
    return getattr(motion.build, "keywords", {}).get("entries")


def _component(told: Component | str) -> Component:
    return told if isinstance(told, Component) else Component(str(told), "")


def _is_numpy(function: Any, arguments: int) -> bool:
    """Whether a function takes so many arguments, and not the namespace alone.

    Raises:
        ValueError: if it is neither.
    """
    count = -1
    if callable(function):
        kinds = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
        told = signature(function).parameters.values()
        count = sum(p.kind in kinds and p.default is Parameter.empty for p in told)
    if count not in (1, arguments):
        told = "f(xp) or f(x, u, dt)" if arguments == 3 else "h(xp) or h(x, s)"
        raise ValueError(f"A model's function must be {told}, got {function!r}.")
    return count == arguments


def _build_motion(xp: ModuleType, f: Any, entries: tuple[float, ...]) -> MotionFunctions:
    step = f.on(xp) if isinstance(f, NumpyFunction) else f(xp)
    if xp.__name__.endswith(".compiled"):  # which makes no tuple of computed length

        @xp.function
        def noise_factor(x, u, dt):
            return entries

    else:

        def noise_factor(x, u, dt):
            return tuple(entry + 0.0 * x[0] for entry in entries)

    return MotionFunctions(step, noise_factor)


def _build_sensor(xp: ModuleType, h: Any) -> Callable:
    return h.on(xp) if isinstance(h, NumpyFunction) else h(xp)
