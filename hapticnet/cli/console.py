"""What a person sees: events, a live status line and errors on stderr; reports on stdout."""

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

from hapticnet.errors import FileError, SettingsError
from hapticnet.files import check_replaceable, replacing, takes_a_stream

if TYPE_CHECKING:
    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.settings import ChannelSettings

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
        self._live = not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._shown = False

    def say(self, line: str) -> None:
        """Print a line that stays."""
        if not self._quiet:
            self._clear()
            _to_stderr(f"{self._name}: {line}\n")

    def status(self, line: str) -> None:
        """Replace the live status line, where a terminal can show one."""
        if self._live:
            _to_stderr(f"\r\x1b[2K{self._name}: {line}")
            self._shown = True

    def finish(self) -> None:
        """Take the status line away."""
        self._clear()

    def _clear(self) -> None:
        if self._shown:
            _to_stderr("\r\x1b[2K")
            self._shown = False


def complain(message: str) -> None:
    """Print an error as one line on stderr."""
    _to_stderr(f"hapticnet: {' '.join(message.split())}\n")


def deliver(report: Mapping[str, Any], *, as_json: bool, file: Path | None) -> None:
    """Print a report on stdout, as JSON or for a person, and write it to `file` as JSON where one is named.

    Raises
    ------
    FileError
        If stdout or the file cannot be written; the other one is written all the same.
    """
    text = json.dumps(report, indent=2) + "\n"
    try:
        if sys.stdout is None:
            return
        sys.stdout.write(text if as_json else "\n".join(_lines(report)) + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        abandon(sys.stdout)
        raise FileError(f"stdout cannot be written: {error.strerror}") from error
    finally:
        if file is not None:
            write_text(file, text)


def channel_account(settings: "ChannelSettings", channel: "Emulator[Any]") -> dict[str, Any]:
    """Return what an emulated channel did, for a report."""
    from dataclasses import asdict

    return {"settings": settings.describe(), **asdict(channel.counters)}


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all; a FileError says why it cannot be written."""
    with replacing(path) as file:
        file.write(text)


def check_outputs(*outputs: Path | None, inputs: Iterable[Path | None] = ()) -> None:
    """Find out before a run whether its results can be written after it; makes folders where they are missing.

    Raises
    ------
    SettingsError
        If two of them are one file, or one would be written over an input.
    FileError
        If one cannot be written.
    """
    taken = {os.path.realpath(path): "is read by this run" for path in inputs if path is not None}
    for path in outputs:
        if path is not None:
            place = os.path.realpath(path)
            if place in taken and not takes_a_stream(path):
                raise SettingsError(f"{path} {taken[place]}, and would be written over; name another file")
            taken[place] = "is to be written twice"
            check_replaceable(path)


def check_new(*outputs: Path | None, force: bool) -> None:
    """Raise SettingsError if one of the outputs exists already, unless it may be overwritten."""
    for path in outputs:
        if path is not None and not force and path.is_file():
            raise SettingsError(f"{path} exists; name another, or add --force to overwrite it")


def _to_stderr(text: str) -> None:
    """Write for a person who may have gone: a closed stderr must not end a run that others depend on."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:  # nobody reads it any more
        abandon(sys.stderr)
    except (ValueError, AttributeError):  # closed by whoever started us
        pass


def abandon(stream: TextIO) -> None:
    """Let what a stream still holds go nowhere, or Python would fail at exit, when it writes out the rest."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


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
