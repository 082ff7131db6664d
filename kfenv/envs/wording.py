"""Plain text for the environments' pages: filled paragraphs, tables, lists of words, numbers."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from inspect import cleandoc

import numpy as np

WIDTH = 90  # characters of a line
STARTS = re.compile(r" *- |#|\||$")  # of a line that does not continue the one before
TOGETHER = re.compile(r"``[^`]+``|\d [%a-z]+")  # code, and a number with its unit
WHOLE = re.compile(r"#|\||$")  # a heading, a line of a table, an empty one


def wrap(text: str) -> str:
    """Fill paragraphs and list items to the width; headings and tables stay as they are."""
    blocks: list[str] = []
    for line in map(str.rstrip, text.splitlines()):
        if not blocks or STARTS.match(line) or WHOLE.match(blocks[-1]):
            blocks.append(line)
        else:
            blocks[-1] += f" {line.strip()}"
    return "\n".join(block if WHOLE.match(block) else _filled(block) for block in blocks)


def _filled(block: str) -> str:
    indent = block[: len(block) - len(block.lstrip())]
    rest = indent + "  " * block.lstrip().startswith("- ")
    whole = TOGETHER.sub(lambda words: words[0].replace(" ", "\0"), " ".join(block.split()))
    filled = textwrap.fill(
        whole, WIDTH, initial_indent=indent, subsequent_indent=rest,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return filled.replace("\0", " ")


def paragraphs(*texts: str) -> str:
    """Texts, each as indented as its code, with empty lines between."""
    return "\n\n".join(map(cleandoc, texts))


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """A table with a rule below its head."""
    cells = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def listed(words: Iterable[str]) -> str:
    """a, b and c."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


def factor(value: float) -> str:
    """A positive number as one writes it: 0.05, 500, 1e-3, 1e4."""
    exponent = round(np.log10(value))
    return f"1e{exponent}" if abs(exponent) >= 3 and value == 10.0**exponent else f"{value:g}"
