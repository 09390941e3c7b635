"""A recorded session, whatever its format."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticnet.errors import FileError

SessionTable: TypeAlias = Mapping[str, npt.NDArray[np.float64 | np.int64 | np.int32]]
"""Columns by name, shape (n,) each."""


REPORT: Final = "report"
"""Fact that a node adds when its session ends."""

INCOMPLETE: Final = "incomplete"
"""Fact in a recording from which something is missing: why."""

LARGEST_JSON: Final = 32 * 2**20
"""Longest text of events or facts that is read [characters]. Its values take up to 30 times as much memory."""

MOST_VALUES: Final = 3_000_000
"""Most commas and opening brackets in such a text: each value takes 100 bytes and more, however short it is."""

MOST_EVENTS: Final = 300_000
"""Most events that are read: 12 hours at 7 a second."""


_SURROGATE: Final = re.compile(r"[\ud800-\udfff]|\\u[dD][89a-fA-F]")


class Event(NamedTuple):
    """An event of a node: its time [µs], its name, and its fields as JSON."""

    t_us: int
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Session:
    """A recording of hapticnet.

    Attributes
    ----------
    side
        ``master`` or ``slave``.
    about
        Configuration, seed, versions, and the report if the session ended before the recording.
    unix_offset_us
        Add it to `t_us` for µs since 1970.
    tables
        The first is the main one: a row for each tick or step.
    events
        In order of time.
    is_whole
        Whether the file is neither cut off nor damaged.
    """

    side: str
    about: dict[str, Any]
    unix_offset_us: int
    tables: dict[str, SessionTable]
    events: tuple[Event, ...]
    is_whole: bool

    @property
    def complete(self) -> bool:
        """Whether it holds its session to the end."""
        return self.is_whole and REPORT in self.about and INCOMPLETE not in self.about

    @property
    def main(self) -> SessionTable:
        """The main table."""
        return next(iter(self.tables.values()))


def check_events(path: Path, count: int) -> None:
    """Raise FileError if a file has more events than are read."""
    if count > MOST_EVENTS:
        raise FileError(f"{path}: more than {MOST_EVENTS:,} events, which is the limit")


def parse_json(text: str) -> Any:
    """Return what a text in a recording says; ValueError if it is not JSON, too long or of too many values."""
    if len(text) > LARGEST_JSON:
        raise ValueError(f"{len(text):,} characters of JSON; the limit is {LARGEST_JSON:,}")
    values = sum(map(text.count, ",[{"))
    if values > MOST_VALUES:
        raise ValueError(f"{values:,} values of JSON; the limit is {MOST_VALUES:,}")
    try:
        value = json.loads(text)
        if _SURROGATE.search(text):  # half a character, which no file or terminal can take; pairs are whole by now
            value = json.loads(json.dumps(value, ensure_ascii=False).encode(errors="replace"))
        return value
    except RecursionError as error:
        raise ValueError("JSON that is nested too deeply") from error
