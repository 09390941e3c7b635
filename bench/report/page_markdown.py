"""Markdown for the page of results: tables, and numbers as a reader wants them."""

from collections.abc import Iterable, Sequence
from typing import Any

Row = dict[str, Any]


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose first column is text and whose others are numbers."""
    lines = [" | ".join(headings), " | ".join(["---", *["--:"] * (len(headings) - 1)]), *map(" | ".join, rows)]
    return "\n".join(f"| {line} |" for line in lines)


def number(value: float | None, spec: str, factor: float = 1.0) -> str:
    """Return a number, or a dash where there is none."""
    return "–" if value is None else format(factor * value, spec)


def listed(items: Sequence[str]) -> str:
    """Return items as a sentence has them."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else "none"


def span(values: Sequence[float], spec: str, factor: float = 1.0) -> str:
    """Return the least and the largest of some values, once where they read the same."""
    ends = [format(factor * value, spec) for value in (min(values), max(values))]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def picture(name: str, caption: str) -> str:
    """Return a figure of docs/figures."""
    return f"![{caption}](figures/{name})"
