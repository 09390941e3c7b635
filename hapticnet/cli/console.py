"""Output of commands: events, a live status line and errors on stderr; reports on stdout."""

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hapticnet.errors import FileError, SettingsError
from hapticnet.files import check_replaceable, replacing, takes_a_stream
from hapticnet.runtime.log_lines import Form, Level, log_line
from hapticnet.runtime.outlet import STDERR, abandon, never_block, write_watched

if TYPE_CHECKING:
    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.settings import ChannelSettings

STALL_S: Final = 3.0
"""Time [s] that a process in real time waits for a reader of its report who has stopped reading."""

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
    real_time
        Whether this process must never wait for the reader of its messages. Their rate is then limited.
    """

    def __init__(self, name: str, *, quiet: bool = False, real_time: bool = False) -> None:
        self._name = name
        self._quiet = quiet
        in_words = STDERR.form in (Form.PLAIN, Form.STAMPED)
        self._live = in_words and not quiet and sys.stderr is not None and sys.stderr.isatty()
        if real_time:
            never_block()

    @property
    def left_out(self) -> int:
        """Number of lines that were not printed, because there were too many or nobody read them."""
        return STDERR.left_out

    def say(self, text: str, *, event: str | None = None, needed: bool = False) -> None:
        """Print a permanent line, a `needed` one even if quiet; `event` names for programs what happened."""
        if needed or not self._quiet:
            STDERR.line(log_line(text, who=self._name, event=event), needed=needed)

    def warn(self, text: str, *, event: str | None = None) -> None:
        """Print a permanent line about something that works worse than it could."""
        if not self._quiet:
            STDERR.line(log_line(text, who=self._name, level=Level.WARNING, event=event))

    def status(self, line: str) -> None:
        """Replace the live status line, if stderr is a terminal."""
        if self._live:
            STDERR.status(f"{self._name}: {line}")

    def finish(self) -> None:
        """Remove the status line, and wait a moment until everything is printed."""
        if self._live:
            STDERR.status("")
        STDERR.drain()


def complain(message: str) -> None:
    """Print an error as one line on stderr."""
    STDERR.line(log_line(" ".join(message.split()), who="hapticnet", level=Level.ERROR), needed=True)


def deliver(
    report: Mapping[str, Any],
    *,
    as_json: bool,
    file: Path | None,
    real_time: bool = False,
    shown: Mapping[str, Any] | None = None,
) -> None:
    """Write a report to `file` as JSON, then print it on stdout, as JSON or for a person.

    The JSON also has the provenance: version, date, machine and command.

    Parameters
    ----------
    real_time
        Whether to give up when stdout is not read for `STALL_S`; otherwise its reader may take any time.
    shown
        What a person is shown instead of `report`.

    Raises
    ------
    FileError
        If the file or stdout cannot be written; the other one is still written.
    """
    from hapticnet.experiment.provenance import provenance

    text = json.dumps({**report, "provenance": provenance()}, indent=2) + "\n"
    try:
        if file is not None:
            write_text(file, text)
    finally:
        STDERR.drain()  # so that on a terminal the report stands below the messages
        _print(text if as_json else "\n".join(_lines(shown or report)) + "\n", STALL_S if real_time else None)


def _print(text: str, stall_s: float | None) -> None:
    if sys.stdout is None:
        return
    try:
        if stall_s is None:
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            write_watched(sys.stdout, text, stall_s)
    except BrokenPipeError:
        raise
    except OSError as error:
        abandon(sys.stdout)
        raise FileError(f"stdout cannot be written: {error.strerror}") from error


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


def _lines(report: Mapping[str, Any], indent: str = "") -> list[str]:
    """Return a report as aligned lines, with nested entries indented and missing values left out."""
    width = max((len(key) for key in report), default=0)
    lines = []
    for key, value in report.items():
        if isinstance(value, Mapping):
            if value:
                lines += [f"{indent}{key}:", *_lines(value, indent + "  ")]
        elif isinstance(value, list):
            texts = [entry for entry in value[:MOST_ENTRIES] if not isinstance(entry, Mapping)]
            if texts:
                lines += [f"{indent}{key}:", *(f"{indent}  {text}" for text in texts)]
            for number, entry in enumerate(value[:MOST_ENTRIES], start=1):
                if isinstance(entry, Mapping):
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
