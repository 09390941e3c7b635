"""Output of commands: events, a live status line and errors on stderr; reports on stdout."""

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
"""Entries shown of a list in a report for a person."""


class Console:
    """Messages of a process to the person who watches it.

    Parameters
    ----------
    name
        Prefix of each line.
    quiet
        Whether to print only errors.
    """

    def __init__(self, name: str, *, quiet: bool = False) -> None:
        self._name = name
        self._quiet = quiet
        self._live = not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._shown = False

    def say(self, line: str) -> None:
        """Print a permanent line."""
        if not self._quiet:
            self._clear()
            _to_stderr(f"{self._name}: {line}\n")

    def status(self, line: str) -> None:
        """Replace the live status line, if stderr is a terminal."""
        if self._live:
            _to_stderr(f"\r\x1b[2K{self._name}: {line}")
            self._shown = True

    def finish(self) -> None:
        """Remove the status line."""
        self._clear()

    def _clear(self) -> None:
        if self._shown:
            _to_stderr("\r\x1b[2K")
            self._shown = False


def complain(message: str) -> None:
    """Print an error as one line on stderr."""
    _to_stderr(f"hapticnet: {' '.join(message.split())}\n")


def deliver(report: Mapping[str, Any], *, as_json: bool, file: Path | None) -> None:
    """Print a report on stdout, as JSON or for a person, and write it to `file` as JSON.

    The JSON also has the provenance: version, date, machine and command.

    Raises
    ------
    FileError
        If stdout or the file cannot be written; the other one is still written.
    """
    from hapticnet.experiment.provenance import provenance

    text = json.dumps({**report, "provenance": provenance()}, indent=2) + "\n"
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
    """Return what an emulated channel did, as part of a report."""
    from dataclasses import asdict

    return {"settings": settings.describe(), **asdict(channel.counters)}


def write_text(path: Path, text: str) -> None:
    """Write a file, completely or not at all; raise FileError if it cannot be written."""
    with replacing(path) as file:
        file.write(text)


def check_outputs(*outputs: Path | None, inputs: Iterable[Path | None] = ()) -> None:
    """Check before a run that its results can be written; make missing directories.

    Raises
    ------
    SettingsError
        If two outputs are the same file, or an output is an input.
    FileError
        If one cannot be written.
    """
    taken = {os.path.realpath(path): "is an input and would be overwritten" for path in inputs if path is not None}
    for path in outputs:
        if path is not None:
            place = os.path.realpath(path)
            if place in taken and not takes_a_stream(path):
                raise SettingsError(f"{path} {taken[place]}; choose another file")
            taken[place] = "is named as an output twice"
            check_replaceable(path)


def check_new(*outputs: Path | None, force: bool) -> None:
    """Raise SettingsError if one of the outputs exists already, unless it may be overwritten."""
    for path in outputs:
        if path is not None and not force and path.is_file():
            raise SettingsError(f"{path} exists; choose another file or add --force to overwrite it")


def _to_stderr(text: str) -> None:
    """Write to stderr; a closed stderr must not end a run that others depend on."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:  # the reader is gone
        abandon(sys.stderr)
    except (ValueError, AttributeError):  # closed by the parent process
        pass


def abandon(stream: TextIO) -> None:
    """Redirect a stream to the null device; otherwise flushing its buffer at exit would fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _lines(report: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return a report as aligned lines, with nested entries indented and missing values left out."""
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
