"""A model's function and its transposed slopes as source text, from what `traced` recorded.

Reverse differentiation, written out: the slopes of a function's values become those of its
state. The text is of lanes (`kfenv.models.namespaces.lanes`) in the arithmetic of `compiled`,
for the array ``w`` of `sweep`, of which ``v`` is a block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .traced import Expression

# What the slope g of a value v adds to those of its arguments a and b
SLOPES = {
    "+": ("{g}", "{g}"),
    "-": ("{g}", "-{g}"),
    "*": ("{g} * {b}", "{g} * {a}"),
    "/": ("{g} / {b}", "-{g} / {b} * {v}"),
    "sqrt": ("0.5 * {g} / {v}",),
    "sin": ("{g} * cos({a})",),
    "cos": ("-{g} * sin({a})",),
    "exp": ("{g} * {v}",),
    "log": ("{g} / {a}",),
    "atan2": ("{g} / ({a} * {a} + {b} * {b}) * {b}", "-{g} / ({a} * {a} + {b} * {b}) * {a}"),
    "maximum": ("where_greater({b}, {a}, 0.0, {g})", "where_greater({b}, {a}, {g}, 0.0)"),
    "minimum": ("where_greater({a}, {b}, 0.0, {g})", "where_greater({a}, {b}, {g}, 0.0)"),
}


class Recorded(NamedTuple):
    """A model's function: symbols of its state and inputs, and what it makes of them."""

    state: tuple[Expression, ...]
    inputs: tuple[Expression, ...]
    results: tuple[Any, ...]


class Rows(NamedTuple):
    """Where numbers lie in a block of `sweep`, one every `stride` rows; if so, point by point."""

    first: int
    stride: int = 1
    by_point: bool = False

    def __getitem__(self, k: int) -> str:
        row = str(self.first + k * self.stride)
        return f"{row} + j" if self.by_point else row


class Source:
    """Functions as they are written.

    Attributes:
        lines: so far.
        tables: of polynomials, by the names that the text has for them.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.tables: dict[str, NDArray[np.float64]] = {}
        self._names: dict[str, str] = {}

    def begin(self, name: str, points: int) -> None:
        """Begin a function of ``w`` that goes through all blocks and their points j."""
        self.lines += [f"def {name}(w):", "  for b in range(w.shape[0]):", "    v = w[b]"]
        self.lines += [f"    for j in range({points}):"]
        self._names.clear()

    def add(self, line: str) -> None:
        """Write a line more of it."""
        self.lines.append(f"      {line}")

    def name(self, text: str) -> str:
        """What an expression is called from now on; the same one is computed once."""
        if text not in self._names:
            self._names[text] = f"v{len(self._names)}"
            self.add(f"{self._names[text]} = {text}")
        return self._names[text]

    def polynomial(self, x: str, y: str, table: NDArray[np.float64], *place: int) -> str:
        """What a polynomial's value and slopes are called, together."""
        known = [name for name, one in self.tables.items() if one is table]
        name = known[0] if known else f"TABLE{len(self.tables)}"
        self.tables[name] = table
        node, row = (f"plain({number})" for number in place)
        return self.name(f"polynomial({name}, {node}, {row}, {x}, {y})")


def record(call: Callable, states: int, inputs: int, timed: bool) -> Recorded:
    """Call a model's function on symbols; if it is `timed`, the last input is dt."""
    x = tuple(Expression("symbol", i) for i in range(states))
    u = tuple(Expression("symbol", k) for k in range(inputs))
    return Recorded(x, u, tuple(call(x, u[:-1], u[-1]) if timed else call(x, u)))


def write_values(
    source: Source, name: str, told: Recorded, points: int, state: Rows, inputs: Rows, values: Rows
) -> None:
    """Write a function that computes the values at all points."""
    source.begin(name, points)
    names = _computed(source, told, state, inputs)
    for k, result in enumerate(told.results):
        source.add(f"store(v, {values[k]}, lift({_text(result, names)}))")


def write_pullback(
    source: Source, name: str, told: Recorded, points: int, state: Rows, inputs: Rows,
    of_values: Rows, of_state: Rows,
) -> None:  # fmt: skip
    """Write one that turns the slopes of the values at all points into those of the state."""
    source.begin(name, points)
    names = _computed(source, told, state, inputs)
    slopes = _pulled(source, told, names, of_values)
    for i, component in enumerate(told.state):
        total = " + ".join(slopes[component] or ["0.0"])
        source.add(f"store(v, {of_state[i]}, lift({total}))")


def _needed(results: Iterable[Any]) -> list[Expression]:
    """All that results are computed of, in order."""
    found: set[Expression] = set()
    waiting = list(results)
    while waiting:
        node = waiting.pop()
        if isinstance(node, Expression) and node not in found:
            found.add(node)
            waiting += node.arguments
    return sorted(found, key=lambda node: node.number)


def _computed(source: Source, told: Recorded, state: Rows, inputs: Rows) -> dict[Expression, str]:
    """Write all that the results are computed of, in order; the names of it."""
    names = {node: f"load(v, {state[i]})" for i, node in enumerate(told.state)}
    names |= {node: f"load(v, {inputs[k]})" for k, node in enumerate(told.inputs)}
    for node in _needed(told.results):
        kind, parts = node.operation, node.arguments
        if kind == "symbol":
            text = names[node]
        elif kind == "polynomial":
            text = f"{source.polynomial(*(names[part] for part in parts[:2]), *parts[2:])}[0]"
        elif kind.isidentifier():
            text = f"{kind}({', '.join(_text(part, names) for part in parts)})"
        else:
            text = f" {kind} ".join(_text(part, names) for part in parts)
        names[node] = source.name(text)
    return names


def _text(value: Any, names: dict[Expression, str]) -> str:
    """A name, or a number in brackets."""
    return names[value] if isinstance(value, Expression) else f"({value!r})"


def _pulled(
    source: Source, told: Recorded, names: dict[Expression, str], of_values: Rows
) -> dict[Expression, list[str]]:
    """Write the way from the slopes of the results to those of the state; the terms of each."""
    nodes, slopes = _needed(told.results), {component: [] for component in told.state}
    for node in nodes:  # those alone that depend on the state
        if any(isinstance(part, Expression) and part in slopes for part in node.arguments):
            slopes[node] = []
    for k, result in enumerate(told.results):
        if isinstance(result, Expression) and result in slopes:
            slopes[result].append(source.name(f"load(v, {of_values[k]})"))
    for node in reversed(nodes):
        if slopes.get(node) and node.operation != "symbol":
            g = source.name(" + ".join(slopes[node]))
            for part, slope in zip(node.arguments, _slopes(source, node, g, names), strict=False):
                if isinstance(part, Expression) and part in slopes:
                    slopes[part].append(source.name(slope))
    return slopes


def _slopes(
    source: Source, node: Expression, g: str, names: dict[Expression, str]
) -> tuple[str, ...]:
    """What a node's slope g adds to those of its arguments."""
    kind, parts = node.operation, node.arguments
    a, b = ([_text(part, names) for part in parts[:2]] * 2)[:2]
    if kind == "**":
        return (f"{g} * {float(parts[1])} * {a} ** {parts[1] - 1}",)
    if kind == "polynomial":
        told = source.polynomial(a, b, *parts[2:])
        return f"{g} * {told}[1]", f"{g} * {told}[2]"
    return tuple(told.format(g=g, v=names[node], a=a, b=b) for told in SLOPES[kind])
