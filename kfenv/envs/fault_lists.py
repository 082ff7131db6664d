"""Faults in words: what the environments' pages say of them, from their own docstrings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from inspect import cleandoc
from typing import Any

from kfenv.envs.wording import listed
from kfenv.scenarios.faults import Fault


def known_faults(known: Mapping[str, type]) -> str:
    """A list of faults: what each does, and its parameters with their defaults."""
    return "\n".join(_item(name, fault) for name, fault in known.items())


def named_faults(faults: Sequence[Fault], known: Mapping[str, type]) -> str:
    """Faults by name, each with the parameters that differ from its defaults."""
    names = {kind: name for name, kind in known.items()}
    if not faults:
        return "nothing"
    return listed(f"``{names[type(fault)]}``{_changes(fault)}" for fault in faults)


def _changes(fault: Fault) -> str:
    changed = [
        f"{item.name} {_value(getattr(fault, item.name))}"
        for item in fields(fault)
        if getattr(fault, item.name) != item.default
    ]
    return f" ({', '.join(changed)})" if changed else ""


def _item(name: str, fault: type) -> str:
    summary = " ".join(cleandoc(fault.__doc__).split("\n\n")[0].split())
    summary = re.sub(r" \(SPEC [^)]*\)", "", summary.split(". ")[0].rstrip("."))
    meaning = _attributes(fault)
    parameters = "; ".join(
        f"``{item.name}`` ({_value(item.default)}), {meaning[item.name]}" for item in fields(fault)
    )
    return f"- ``{name}``: {summary[0].lower()}{summary[1:]}. {parameters}."


def _attributes(described: type) -> dict[str, str]:
    """What the docstrings of a class and its bases say of its attributes."""
    told: dict[str, str] = {}
    for base in reversed(described.__mro__):
        _, _, text = cleandoc(base.__doc__ or "").partition("Attributes:\n")
        text = re.sub(r"\n {5,}", " ", text.partition("\n\n")[0])
        for names, meaning in re.findall(r"^ +([\w, ]+): (.*?)\.?$", text, re.M):
            told.update(dict.fromkeys(names.split(", "), meaning))
    return told


def _value(value: Any) -> str:
    """A parameter's value; a range is (low, high), which may be one number."""
    if isinstance(value, tuple) and value:
        return " to ".join(dict.fromkeys(f"{end:.3g}" for end in value))
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:g}".replace("e+0", "e") if isinstance(value, float) else repr(value)
