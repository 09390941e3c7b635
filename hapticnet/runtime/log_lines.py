"""The lines that a process writes on stderr: plain, with time and level, as JSON, or for the journal of systemd."""

import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Any, Final

from hapticnet.errors import visible


class Level(Enum):
    """How serious a line is."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class Form(Enum):
    """How a line is written."""

    PLAIN = "plain"
    """``master: link stale``, for commands that a person waits for."""

    STAMPED = "stamped"
    """``2026-11-22T08:17:50.123Z warning master: link stale``, for processes that run until they are stopped."""

    JSON = "json"
    """One JSON object per line, for log collectors."""

    JOURNAL = "journal"
    """``<4>master: link stale``: the journal adds the time itself (sd-daemon(3))."""


PRIORITIES: Final = {Level.INFO: 6, Level.WARNING: 4, Level.ERROR: 3}
"""The levels of syslog(3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLine:
    """A message to whoever watches a process.

    Attributes
    ----------
    time_s
        Unix time [s] at which it was said, which may be long before it is written.
    who
        Part of the program that says it.
    event
        Name of the event that it tells, for programs; None if it tells none.
    fields
        What the event is about, for programs: master, address, codec.
    """

    time_s: float
    level: Level
    who: str
    text: str
    event: str | None = None
    fields: Mapping[str, Any] | None = None

    def write(self, form: Form) -> str:
        """Return the line, with its line end."""
        if form is Form.JSON:
            fields: dict[str, Any] = {"time": self._stamp(), "level": self.level.value, "source": self.who}
            fields |= {"message": self.text, **(self.fields or {})}
            if self.event is not None:
                fields["event"] = self.event
            return json.dumps(fields, ensure_ascii=False) + "\n"
        if form is Form.STAMPED:
            return f"{self._stamp()} {self.level.value} {self.who}: {self.text}\n"
        if form is Form.JOURNAL:
            return f"<{PRIORITIES[self.level]}>{self.who}: {self.text}\n"
        return f"{self.who}: {'warning: ' * (self.level is Level.WARNING)}{self.text}\n"

    def _stamp(self) -> str:
        """Return the time in UTC (RFC 3339), so that the logs of two hosts can be compared."""
        return datetime.fromtimestamp(self.time_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def log_line(
    text: str,
    *,
    who: str,
    level: Level = Level.INFO,
    event: str | None = None,
    fields: Mapping[str, Any] | None = None,
) -> LogLine:
    """Return a line that is said now. Nothing in it speaks to a terminal, whatever file or peer it quotes."""
    return LogLine(time_s=time.time(), level=level, who=who, text=visible(text), event=event, fields=fields)


def is_journal(environment: Mapping[str, str], descriptor: int) -> bool:
    """Return whether a file descriptor is connected to the journal of systemd (JOURNAL_STREAM, systemd.exec(5))."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return named == f"{status.st_dev}:{status.st_ino}"
