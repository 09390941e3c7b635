"""Output of commands: events, a live status line and errors on stderr; reports on stdout."""

import json
import math
import os
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from hapticnet.errors import FileError, SettingsError, visible
from hapticnet.files import check_replaceable, replacing, takes_a_stream
from hapticnet.runtime.nonblocking_log import STDERR, Form, Level, LogLine, abandon, never_block, write_watched

STALL_S: Final = 3.0  # time [s] that a process in real time waits for a stalled reader of its report
PROGRESS_S: Final = 5.0  # time [s] between two lines that say how far a run is, where there is no status line
LONGEST_ERROR: Final = 4000  # characters of an error that are printed; the middle of a longer one is left out
MOST_ENTRIES: Final = 20  # entries shown of a list in a report for a person


class Console:
    """Messages of a process to the person who watches it; a process in real time never waits for the reader."""

    def __init__(self, name: str, *, quiet: bool = False, real_time: bool = False) -> None:
        self._name = name
        self._quiet = quiet
        self.faults: list[str] = []  # what has failed while the run went on
        self._live = STDERR.form is not Form.JOURNAL and not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._next_progress_s = time.monotonic() + PROGRESS_S
        if real_time:
            never_block()

    def say(self, text: str, *, needed: bool = False) -> None:
        """Print a permanent line, a `needed` one even if quiet."""
        if needed or not self._quiet:
            STDERR.line(LogLine(text, who=self._name), needed=needed)

    def warn(self, text: str) -> None:
        """Print a permanent line about something that works worse than it could."""
        if not self._quiet:
            STDERR.line(LogLine(text, who=self._name, level=Level.WARNING))

    def fault(self, text: str) -> None:
        """Warn of a failure that does not end the run; report and exit code state it too."""
        self.faults.append(text)
        self.warn(text)

    def warn_of_unused(self, unused: Mapping[str, tuple[bool, str]]) -> None:
        """Warn of options without effect: by option, whether it is ineffective, and why."""
        for option, (is_unused, why) in unused.items():
            if is_unused:
                self.warn(f"{option} has no effect: {why}")

    def status(self, line: str) -> None:
        """Replace the live status line, if stderr is a terminal."""
        if self._live:
            STDERR.status(f"{self._name}: {line}")

    def progress(self, line: str) -> None:
        """Show the progress of a long run: as status on a terminal, elsewhere as a line every `PROGRESS_S`."""
        self.status(line)
        if not self._live and time.monotonic() >= self._next_progress_s:
            self._next_progress_s = time.monotonic() + PROGRESS_S
            self.say(line)

    def finish(self) -> None:
        """Remove the status line, and wait briefly until everything is printed."""
        if self._live:
            STDERR.status("")
        STDERR.drain()


def complain(message: str) -> None:
    """Print an error as one line on stderr."""
    line = " ".join(message.split())
    if len(line) > LONGEST_ERROR:  # an invalid value may have any length; the allowed values are at the end
        line = f"{line[: LONGEST_ERROR // 2]} … {line[-LONGEST_ERROR // 2 :]}"
    STDERR.line(LogLine(line, who="hapticnet", level=Level.ERROR), needed=True)


def deliver(
    report: Mapping[str, Any],
    *,
    as_json: bool,
    file: Path | None,
    real_time: bool = False,
    shown: Mapping[str, Any] | None = None,
) -> None:
    """Write a report to `file` as JSON, then print it on stdout, as JSON or as text for a person (`shown` if given).

    The JSON includes the provenance. In real time, a stdout that is not read for `STALL_S` is abandoned.

    Raise FileError if the file or stdout cannot be written; the other one is still written.
    """
    from hapticnet.experiment.provenance import provenance

    text = json.dumps({**report, "provenance": provenance()}, indent=2) + "\n"
    try:
        if file is not None:
            write_text(file, text)
    finally:
        STDERR.drain()  # so that on a terminal the report is below the messages
        _print(
            text if as_json else "".join(f"{visible(line)}\n" for line in _lines(shown or report)),
            STALL_S if real_time else None,
        )


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


def show(text: str) -> None:
    """Print a text for a person on stdout, with control characters replaced by "?"."""
    print("\n".join(visible(line) for line in text.split("\n")))


def write_text(path: Path, text: str, *, follow: bool = True) -> None:
    """Write a file, completely or not at all; raise FileError if it cannot be written. `follow` as for `replacing`."""
    with replacing(path, follow=follow) as file:
        file.write(text)


def check_outputs(*outputs: Path | None, inputs: Iterable[Path | None] = ()) -> None:
    """Check before a run that its results can be written; make missing directories.

    Raise SettingsError if two outputs are the same file, or an output is an input; FileError if one cannot be written.
    """
    taken = {os.path.realpath(path): "is an input and would be overwritten" for path in inputs if path is not None}
    for path in outputs:
        if path is not None:
            place = os.path.realpath(path)
            if place in taken and not takes_a_stream(path):
                raise SettingsError(f"{path} {taken[place]}; choose another file")
            taken[place] = "is named as an output twice"
            check_replaceable(path)


def check_needed(name: str, value: object, given: Mapping[str, object]) -> None:
    """Raise SettingsError if one of the options `given` would be ignored, because the option `name` is missing."""
    ignored = next((option for option, each in given.items() if each is not None), None)
    if value is None and ignored is not None:
        raise SettingsError(f"{ignored} needs {name}")


def check_new(*outputs: Path | None, overwrite: bool) -> None:
    """Raise SettingsError if one of the outputs exists already, unless it may be overwritten."""
    for path in outputs:
        if path is not None and not overwrite and path.is_file():
            raise SettingsError(f"{path} exists; choose another file or add --overwrite")


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
