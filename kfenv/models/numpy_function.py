"""A model's function on NumPy arrays, and what the namespaces make of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from kfenv.models.namespaces.dual import Dual

Array = NDArray[np.float64]

TRIAL = np.array([0.3, 0.5, 0.9])  # states at which a function is tried out
STEP = 6e-6  # of a central difference, relative: the cube root of rounding


@dataclass(frozen=True)
class NumpyFunction:
    """f(x, u, dt) or h(x, s), from arrays (n, N) to (m, N).

    Attributes:
        name: ``"f"`` or ``"h"``, for complaints.
        call: the user's.
        size: m.
        together: whether it takes N states at once; otherwise it is called N times.
        timed: whether it takes dt.
        angles: which of its values are angles; () for none.
    """

    name: str
    call: Callable
    size: int
    together: bool
    timed: bool = False
    angles: tuple[bool, ...] = ()

    @classmethod
    def tried(
        cls, name: str, call: Callable, states: int, size: int, inputs: int, dt: bool = False,
        angles: Sequence[bool] = (),
    ) -> NumpyFunction:  # fmt: skip
        """The function, found out whether it takes several states at once.

        Args:
            states, size, inputs: n, m and the number of inputs.

        Raises:
            ValueError: if it fails for one state, or gives another number of values.
        """
        x = np.outer(np.linspace(1.0, 1.5, states), TRIAL)
        rest = (np.full((inputs, len(TRIAL)), 0.1), *((0.1,) if dt else ()))
        alone = cls(name, call, size, False, dt, tuple(angles))
        with np.errstate(all="ignore"):
            one_by_one = alone.many(x, *rest)
            try:
                at_once = cls(name, call, size, True, dt, tuple(angles))
                same = np.allclose(at_once.many(x, *rest), one_by_one, equal_nan=True)
            except Exception:  # whatever the user's function does with arrays
                same = False
        if same:
            return at_once
        warnings.warn(
            f"{name} takes one state alone, so it is called for each state of each filter in turn, "
            f"which is slow: write it for arrays x (n, N), with np.where in place of `if` and "
            "np.sin in place of math.sin.",
            stacklevel=4,
        )
        return alone

    def many(self, x: Array, u: Array, dt: Array | float | None = None) -> Array:
        """Values (m, N) of states x (n, N) with inputs (p, N), and dt (N,) or one number.

        Raises:
            ValueError: if the user's function fails, or gives another number of values.
        """
        if self.together:
            values = self._called(x, u, dt)
        else:
            steps = np.broadcast_to(0.0 if dt is None else dt, x.shape[1])
            columns = [self._called(x[:, i], u[:, i], float(steps[i])) for i in range(x.shape[1])]
            values = np.stack(columns, axis=1)
        return np.broadcast_to(values, (self.size, x.shape[1]))

    def _called(self, x: Array, u: Array, dt: Array | float | None) -> Array:
        rest = (u, dt) if self.timed else (u,)
        try:
            values = np.asarray(self.call(x, *rest), np.float64)
        except Exception as error:  # whatever the user's function does
            raise ValueError(
                f"{self.name} fails for a state of shape {x.shape} and inputs of shape {u.shape} "
                f"({type(error).__name__}: {error}): correct it."
            ) from error
        if values.ndim == 0 and self.size == 1:
            values = values[None]
        if values.ndim != x.ndim or len(values) != self.size:
            what = "states" if self.timed else "channels"
            raise ValueError(
                f"{self.name} gives an array of shape {values.shape} for a state of shape "
                f"{x.shape}; there are {self.size} {what}: return one value for each."
            )
        return values

    def on(self, xp: ModuleType) -> Callable:
        """The component function for a module of `kfenv.models.namespaces`.

        Raises:
            ValueError: for a backend that NumPy functions cannot serve.
        """
        arithmetic = xp.__name__.rpartition(".")[2]
        if arithmetic in ("batch", "scalar"):
            return self._values if arithmetic == "batch" else self._floats
        if arithmetic == "dual":
            return self._slopes
        raise ValueError(
            f"{self.name} is written as a NumPy function, which the compiled engine cannot "
            "run: for the engine, its banks and training through the filter write it "
            f"with the namespace, as {self.name}(xp)."
        )

    def _values(self, x, u, dt=None):
        shape = np.broadcast_shapes(*(part.shape for part in x))
        value = self.many(*self._flat(shape, x, u), _common(dt, shape))
        return tuple(value.reshape(self.size, *shape))

    def _floats(self, x, u, dt=None):
        told = self.many(np.array(x, float)[:, None], np.array(u, float).reshape(-1, 1), dt)
        return tuple(told[:, 0].tolist())

    def _slopes(self, x, u, dt=None):
        """Duals by central differences; the state's components are duals, the rest arrays."""
        at = np.stack([part.value for part in x])
        shape, gradients = at.shape[1:], np.stack([part.gradient for part in x])
        h = STEP * np.maximum(1.0, np.abs(at))
        value = np.stack(self._values(tuple(at), u, dt))
        total = np.zeros((self.size, *gradients.shape[1:]))
        for i in range(len(x)):
            moved = [at.copy() for _ in range(2)]
            moved[0][i] += h[i]
            moved[1][i] -= h[i]
            high, low = (np.stack(self._values(tuple(states), u, dt)) for states in moved)
            slope = self._wrapped(high - low) / (2.0 * h[i])
            total += slope[..., None] * gradients[i]
        return tuple(Dual(v.reshape(shape), g) for v, g in zip(value, total, strict=True))

    def _wrapped(self, difference: Array) -> Array:
        if any(self.angles):
            turns = np.floor(difference / (2.0 * pi) + 0.5)
            keep = np.reshape(self.angles, (-1, *[1] * (difference.ndim - 1)))
            difference = difference - np.where(keep, 2.0 * pi * turns, 0.0)
        return difference

    def _flat(self, shape: tuple[int, ...], *parts: tuple) -> list[Array]:
        """Tuples of components as arrays (k, N)."""
        size = int(np.prod(shape))
        return [
            np.stack([np.broadcast_to(p, shape).reshape(size) for p in part])
            if len(part) else np.empty((0, size))
            for part in parts
        ]  # fmt: skip


def _common(dt: Array | float | None, shape: tuple[int, ...]) -> Array | float | None:
    """A time step as one number where all are the same, else flat (N,)."""
    if dt is None or np.ndim(dt) == 0:
        return dt
    first = np.ravel(dt)[0]
    return float(first) if np.all(dt == first) else np.broadcast_to(dt, shape).ravel()
