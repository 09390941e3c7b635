"""What a person sees: events, a live status line and errors on stderr; reports on stdout."""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import FileError

MOST_ENTRIES: Final = 20
"""Entries of a list that a report for a person shows."""


class Console:
    """Lines for the person who watches a process.

    Parameters
    ----------
    name
        Stands before each line.
    quiet
        Whether to say nothing but errors.
    """

    def __init__(self, name: str, *, quiet: bool = False) -> None:
        self._name = name
        self._quiet = quiet
        self._live = sys.stderr.isatty() and not quiet
        self._shown = False

    def say(self, line: str) -> None:
        """Print a line that stays."""
        if not self._quiet:
            self._clear()
            print(f"{self._name}: {line}", file=sys.stderr, flush=True)

    def status(self, line: str) -> None:
        """Replace the live status line, where a terminal can show one."""
        if self._live:
            print(f"\r\x1b[2K{self._name}: {line}", end="", file=sys.stderr, flush=True)
            self._shown = True

    def finish(self) -> None:
        """Take the status line away."""
        self._clear()

    def _clear(self) -> None:
        if self._shown:
            print("\r\x1b[2K", end="", file=sys.stderr, flush=True)
            self._shown = False


def complain(message: str) -> None:
    """Print an error as one line on stderr."""
    print(f"hapticnet: {' '.join(message.split())}", file=sys.stderr)


def deliver(report: Mapping[str, Any], *, as_json: bool, file: Path | None) -> None:
    """Print a report on stdout, as JSON or for a person, and write it to `file` as JSON where one is named."""
    text = json.dumps(report, indent=2)
    if file is not None:
        write_text(file, text + "\n")
    if as_json:
        print(text, flush=True)
    else:
        for line in _lines(report):
            print(line)
        sys.stdout.flush()


def write_text(path: Path, text: str) -> None:
    """Write a file, making its folder where it is missing; a FileError says why it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def _lines(report: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return a report as aligned lines; what is nested is indented, what was not measured is left out."""
    width = max((len(key) for key in report), default=0)
    lines = []
    for key, value in report.items():
        if isinstance(value, Mapping):
            if value:
                lines += [f"{indent}{key}:", *_lines(value, indent + "  ")]
        elif isinstance(value, list):
            for number, entry in enumerate(value[:MOST_ENTRIES], start=1):
                lines += [f"{indent}{key} {number}:", *_lines(entry, indent + "  ")]
            if len(value) > MOST_ENTRIES:
                lines.append(f"{indent}… and {len(value) - MOST_ENTRIES} more {key} (--json shows all)")
        elif value is not None:
            lines.append(f"{indent}{key:<{width}}  {_plain(value)}")
    return lines


def _plain(value: object) -> str:
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.6g}"
    return str(value)
