"""Words for complaints: that a name is unknown, and what a file holds in its place."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LISTED = 12  # names that still make a sentence
QUOTED = 60  # letters of a file that do
UNPRINTABLE = "\N{REPLACEMENT CHARACTER}"


def unknown(what: str, name: object, known: Iterable[str]) -> str:
    """A sentence that names the culprit, the nearest known name, and all known or those alike."""
    known = list(known)
    close = get_close_matches(str(name), known, n=1, cutoff=0.5)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return f"Unknown {what} {name!r}.{hint} Known: {_listed(str(name), known)}."


def _listed(name: str, known: list[str]) -> str:
    """All known names, or of many the most alike."""
    if len(known) <= LISTED:
        return ", ".join(known)
    alike = get_close_matches(name, known, n=LISTED, cutoff=0.0)
    return f"{', '.join(alike)} and {len(known) - LISTED} others"


def excerpt(text: str) -> str:
    """The beginning of what a file holds, in one line of letters that can be printed."""
    shown = "".join(letter if letter.isprintable() else UNPRINTABLE for letter in text[:QUOTED])
    return shown if len(text) <= QUOTED else f"{shown} ..."
