"""Valid files spoilt: bytes, lines, numbers, encodings, and the values of archives and JSON."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eEdD][-+]?\d+)?")
ODD = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-308", b"1e400", b"0", b"-0.0", b"-1",
    b"99999999999999999999", b"", b" ", b"0x10", b"1_000", b"1,5", b"True", b"None",
    "\N{ARABIC-INDIC DIGIT FIVE}".encode(), b"1e", b"--1", b"*", b'"', b"\0",
)  # fmt: skip
LINE_ENDS = (b"\r\n", b"\r", b"\n\n", b"\x0b", b"\x0c", b"\xc2\x85", b"\x1a\n", b"")
ENCODINGS = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig")
PLAIN_VALUES = (
    None, True, -1, 0, 3.5, 1e308, 2**70, float("nan"), float("inf"), "", "x", [], {}, [None],
    {"a": 1}, "\ud800",
)  # fmt: skip
KINDS = ("<f8", "<f4", "<i8", "?", "<U5", "<c16")

Mutation = Callable[[Generator, bytes], bytes]


def mutate(rng: Generator, content: bytes) -> bytes:
    """The content with one to three mutations that suit its kind, most often one."""
    for _ in range(1 + rng.poisson(0.3)):
        kinds = [BYTES, BYTES]
        if content.startswith(b"PK"):
            kinds = [BYTES, _archive, _archive]
        elif content.startswith((b"{", b"[")):
            kinds = [BYTES, TEXT, _json, _json]
        elif content:
            kinds = [BYTES, TEXT, TEXT, TEXT]
        kind = kinds[rng.integers(len(kinds))]
        mutation = kind if callable(kind) else kind[rng.integers(len(kind))]
        content = mutation(rng, content)
    return content


def _span(rng: Generator, size: int) -> tuple[int, int]:
    """A short or a long stretch."""
    begin = int(rng.integers(size + 1))
    return begin, min(size, begin + int(10.0 ** rng.uniform(0.0, np.log10(size + 2.0))))


# ----- bytes ------------------------------------------------------------------------------


def _flip(rng: Generator, content: bytes) -> bytes:
    array = np.frombuffer(content, np.uint8).copy()
    if array.size:
        places = rng.integers(array.size, size=1 + rng.poisson(2.0))
        array[places] ^= (1 << rng.integers(8, size=places.size)).astype(np.uint8)
    return array.tobytes()


def _overwrite(rng: Generator, content: bytes) -> bytes:
    begin, _ = _span(rng, len(content))
    new = rng.bytes(1 + int(rng.integers(8)))
    return content[:begin] + new + content[begin + len(new) :]


def _insert(rng: Generator, content: bytes) -> bytes:
    begin, _ = _span(rng, len(content))
    return content[:begin] + rng.bytes(1 + int(rng.integers(8))) + content[begin:]


def _delete(rng: Generator, content: bytes) -> bytes:
    begin, end = _span(rng, len(content))
    return content[:begin] + content[end:]


def _repeat(rng: Generator, content: bytes) -> bytes:
    begin, end = _span(rng, len(content))
    return content[:end] + content[begin:]


def _truncate(rng: Generator, content: bytes) -> bytes:
    return content[: _span(rng, len(content))[0]]


def _empty(rng: Generator, content: bytes) -> bytes:
    return b""


BYTES: tuple[Mutation, ...] = (
    _flip, _flip, _overwrite, _insert, _delete, _repeat, _truncate, _truncate, _empty,
)  # fmt: skip

# ----- lines and numbers ------------------------------------------------------------------


def _lines(change: Callable[[Generator, list[bytes], int, int], list[bytes]]) -> Mutation:
    """A mutation of a stretch of lines."""

    def mutation(rng: Generator, content: bytes) -> bytes:
        lines = content.splitlines(keepends=True)
        begin, end = _span(rng, len(lines))
        return b"".join(lines[:begin] + change(rng, lines, begin, end) + lines[end:])

    return mutation


def _shuffled(rng: Generator, lines: list[bytes], begin: int, end: int) -> list[bytes]:
    return [lines[i] for i in begin + rng.permutation(end - begin)]


def _copied(rng: Generator, lines: list[bytes], begin: int, end: int) -> list[bytes]:
    """A stretch with one from elsewhere before it."""
    first, last = _span(rng, len(lines))
    return lines[first:last] + lines[begin:end]


def _line_ends(rng: Generator, content: bytes) -> bytes:
    return content.replace(b"\n", LINE_ENDS[rng.integers(len(LINE_ENDS))])


def _encode(rng: Generator, content: bytes) -> bytes:
    return content.decode("latin-1").encode(ENCODINGS[rng.integers(len(ENCODINGS))])


def _numbers(new: Callable[[Generator, bytes], bytes]) -> Mutation:
    """A mutation of some numbers, or of one place in every line, as wide as before or not."""

    def mutation(rng: Generator, content: bytes) -> bytes:
        found = list(NUMBER.finditer(content))
        if not found:
            return content
        chosen = _chosen_numbers(rng, content, found)
        padded, parts, begin = rng.random() < 0.5, [], 0
        for number in chosen:
            text = new(rng, number[0])
            parts += [content[begin : number.start()], text]
            parts += [b" " * (len(number[0]) - len(text))] if padded else []
            begin = number.end()
        return b"".join([*parts, content[begin:]])

    return mutation


def _chosen_numbers(rng: Generator, content: bytes, found: list[re.Match]) -> list[re.Match]:
    """One, a few, or the numbers at one place of all lines."""
    if rng.random() < 0.7:
        few = rng.integers(len(found), size=1 + rng.poisson(0.5))
        return [found[i] for i in np.unique(few)]
    place = int(rng.integers(8))
    chosen, line, count = [], -1, 0
    for number in found:
        begin = content.rfind(b"\n", 0, number.start())
        line, count = begin, count + 1 if begin == line else 0
        chosen += [number] if count == place else []
    return chosen


def _odd(rng: Generator, number: bytes) -> bytes:
    return ODD[rng.integers(len(ODD))]


def _scaled(rng: Generator, number: bytes) -> bytes:
    value = float(number.replace(b"D", b"e").replace(b"d", b"e"))
    factor = -1.0 if rng.random() < 0.2 else 10.0 ** rng.uniform(-12.0, 12.0)
    return f"{value * factor:.{len(number)}g}"[: len(number)].encode()


TEXT: tuple[Mutation, ...] = (
    _lines(lambda rng, lines, begin, end: []),
    _lines(lambda rng, lines, begin, end: 2 * lines[begin:end]),
    _lines(_shuffled),
    _lines(_copied),
    _line_ends,
    _encode,
    *3 * (_numbers(_odd), _numbers(_scaled)),
)

# ----- archives and JSON ------------------------------------------------------------------


def _archive(rng: Generator, content: bytes) -> bytes:
    """One array of an archive lost, renamed, or with other values, shape or kind."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception:  # spoilt before
        return content
    if not arrays:
        return content
    name = [*arrays][rng.integers(len(arrays))]
    array = arrays.pop(name)
    choice = rng.integers(4)
    if choice == 1:
        arrays[name + "x"] = array
    elif choice > 1:
        arrays[name] = _other_array(rng, array)
    out = io.BytesIO()
    (np.savez_compressed if rng.random() < 0.1 else np.savez)(out, **arrays)
    return out.getvalue()


def _other_array(rng: Generator, array: np.ndarray) -> np.ndarray:
    if array.dtype.kind == "U" and array.ndim == 0:
        return np.array(_text_of(rng, str(array)))
    kind, choice = KINDS[rng.integers(len(KINDS))], rng.integers(6)
    if choice == 0:
        return array[..., None]
    if choice == 1:
        return array.ravel()[: rng.integers(array.size + 1)]
    if choice == 2:
        return np.zeros(array.shape, kind)
    if array.dtype.kind not in "fi" or not array.size:
        return np.concatenate([array.ravel(), array.ravel()])
    array = array.copy()
    values = np.array([np.nan, np.inf, -np.inf, 1e30, -1.0, 0.0])
    with np.errstate(invalid="ignore"):
        array.flat[rng.integers(array.size, size=3)] = rng.choice(values).astype(array.dtype)
    return array


def _text_of(rng: Generator, text: str) -> str:
    if text.startswith(("{", "[")):
        return _json(rng, text.encode()).decode("utf-8", "surrogatepass")
    return text[: rng.integers(len(text) + 1)] + "x"


def _json(rng: Generator, content: bytes) -> bytes:
    """One value of a JSON text lost, or another one in its place."""
    try:
        tree = json.loads(content)
    except ValueError:  # spoilt before
        return content
    places = [*_places(tree)]
    if not places:
        return content
    node, key = places[rng.integers(len(places))]
    if rng.random() < 0.3:
        del node[key]
    else:
        node[key] = PLAIN_VALUES[rng.integers(len(PLAIN_VALUES))]
    return json.dumps(tree).encode()


def _places(node: Any):
    """All (container, key) in a tree."""
    keys = node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in list(keys):
        yield node, key
        yield from _places(node[key])
