"""Models tried out on a state before any filter runs, and what fails said in one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

import kfenv
from kfenv.models.model import Component, Motion, Sensor
from kfenv.models.namespaces import batch, dual

TRIALS = 3  # states at once: a branch on a component then fails
PACKAGE = str(Path(kfenv.__file__).parent)


def probe_motion(motion: Motion) -> None:
    """Complain if a motion model's step does not do what it should.

    Raises:
        ValueError: naming what is wrong and the remedy.
    """
    u, dt = _inputs(len(motion.inputs)), np.full(TRIALS, 0.1)
    _probe("f", lambda xp: motion.build(xp).step, motion.states, "states", motion.states, (u, dt))


def probe_sensor(sensor: Sensor, states: int) -> None:
    """Complain if a sensor does not do what it should with so many states.

    Raises:
        ValueError: naming what is wrong and the remedy.
    """
    s = _inputs(len(sensor.inputs))
    x = tuple(Component(f"x[{i}]", "") for i in range(states))
    _probe("h", sensor.build, sensor.channels, "channels", x, (s,))


def _inputs(count: int) -> tuple[np.ndarray, ...]:
    return tuple(np.full(TRIALS, 0.1) for _ in range(count))


def _probe(
    name: str, build: Callable, wanted: tuple[Component, ...], what: str,
    states: tuple[Component, ...], rest: tuple,
) -> None:  # fmt: skip
    """Run it on arrays and on duals, which between them refuse what the compiled engine would."""
    decorated: list[Callable] = []
    try:
        function = build(_marking(decorated))
        at = np.outer(np.linspace(1.0, 1.5, len(states)), np.linspace(0.3, 0.9, TRIALS))
        with np.errstate(all="ignore"):
            told = function(tuple(at), *rest)
            _check_result(name, told, wanted, what)
            build(dual)(dual.seed(at.T), *rest)
    except Refusal as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # whatever the user's function does
        raise ValueError(_explained(name, error, len(states), len(rest[0]))) from error
    if function not in decorated and not hasattr(function, "__self__"):
        raise ValueError(
            f"{name}(xp) gives a function without a decorator, which the engine cannot compile: "
            "write @xp.function above it, as above every function inside."
        )


class Refusal(ValueError):
    """A sentence that needs no more explanation."""


def _marking(decorated: list[Callable]) -> ModuleType:
    """The namespace of arrays, whose decorator notes what it was put on."""
    xp = ModuleType(batch.__name__)
    xp.__dict__.update({name: getattr(batch, name) for name in batch.__all__})

    def function(f: Callable) -> Callable:
        decorated.append(f)
        return f

    xp.function = function
    return xp


def _check_result(name: str, told: object, wanted: tuple[Component, ...], what: str) -> None:
    names = ", ".join(component.name for component in wanted)
    if not isinstance(told, tuple):
        raise Refusal(
            f"{name} returns a {type(told).__name__}, expected a tuple of {len(wanted)} "
            f"components ({names}); of a single one write (value,)."
        )
    if len(told) != len(wanted):
        raise Refusal(
            f"{name} returns {len(told)} components for {len(wanted)} {what} ({names}): return "
            "one for each."
        )


def _explained(name: str, error: Exception, states: int, inputs: int) -> str:
    """A sentence on what a user's function did."""
    text, where = str(error), _where(error)
    known = ", ".join(sorted({*batch.__all__} - {"function"}))
    missing = re.search(r"module '.*namespaces\.\w+' has no attribute '(\w+)'", text)
    if missing:
        return f"{name}{where} asks the namespace for {missing[1]}, and it has {known}."
    if "'module'" in text or "ModuleType" in text:
        numpy = "f(x, u, dt)" if name == "f" else "h(x, s)"
        return (
            f"{name}{where} of one argument is given the namespace and makes the function; of "
            f"plain NumPy it would be {numpy}."
        )
    if "truth value" in text or "'>' not supp" in text or "'<' not supp" in text:
        return (
            f"{name}{where} branches on a component, which stands for many filters at once: take "
            "xp.maximum, xp.minimum, or arithmetic in place of `if`."
        )
    if re.search(r"only (length-1|size-1|0-dim)|must be real number", text):
        return (
            f"{name}{where} gives a component to a function for single numbers, such as those of "
            f"`math`: take the namespace's ({known})."
        )
    if "ufunc" in text or "Dual" in text:
        return (
            f"{name}{where} gives a component to NumPy, which the compiled engine cannot: take + - "
            f"* / and the namespace's functions ({known})."
        )
    if "unpack" in text or isinstance(error, IndexError):
        return (
            f"{name}{where} asks for other components than it is given, which are {states} states "
            f"and {inputs} inputs: {text}."
        )
    return f"{name}{where} fails on a trial state ({type(error).__name__}: {text}): correct it."


def _where(error: Exception) -> str:
    """The line of the user's code that failed."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith(PACKAGE):
            place = f" (line {trace.tb_lineno} of {Path(file).name})"
        trace = trace.tb_next
    return place
