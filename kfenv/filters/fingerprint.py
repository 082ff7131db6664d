"""A hash of a function's meaning, so that compiled code is reused only for the same source."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from functools import partial
from types import CodeType, FunctionType, MethodType, ModuleType

import numpy as np


def fingerprint(*objects: object) -> str:
    """Hash functions (with all they call), partial functions and plain constants.

    Two calls agree in different processes exactly if code and constants agree.
    """
    digest = hashlib.sha256()
    seen: set[int] = set()
    for item in objects:
        _feed(digest, item, seen)
    return digest.hexdigest()[:16]


def _names(code: CodeType) -> list[str]:
    """All names that a function and those that it defines look up."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return [*code.co_names, *(name for part in inner for name in _names(part))]


def _feed(digest, item: object, seen: set[int]) -> None:
    if isinstance(item, partial):
        for part in (item.func, item.args, sorted(item.keywords.items())):
            _feed(digest, part, seen)
    elif isinstance(item, FunctionType):
        if id(item) in seen:
            return
        seen.add(id(item))
        _feed(digest, item.__code__, seen)
        _feed(digest, item.__defaults__, seen)
        for cell in item.__closure__ or ():
            _feed(digest, cell.cell_contents, seen)
        for name in _names(item.__code__):
            if name in item.__globals__:
                _feed(digest, item.__globals__[name], seen)
    elif isinstance(item, CodeType):
        digest.update(item.co_code)
        digest.update(repr(item.co_names).encode())
        _feed(digest, item.co_consts, seen)
    elif isinstance(item, MethodType):
        for part in (item.__func__, item.__self__):
            _feed(digest, part, seen)
    elif isinstance(item, np.ndarray):
        digest.update(repr((item.dtype.str, item.shape)).encode())
        digest.update(np.ascontiguousarray(item).tobytes())
    elif is_dataclass(item) and not isinstance(item, type):
        digest.update(type(item).__name__.encode())
        for field in fields(item):
            _feed(digest, getattr(item, field.name), seen)
    elif isinstance(item, ModuleType):
        digest.update(item.__name__.encode())
    elif isinstance(item, tuple | list):
        for part in item:
            _feed(digest, part, seen)
    else:
        digest.update(repr(item).encode())
