"""A recorded session in any format: its tables, events and facts, and the settings in force."""

import json
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticnet.errors import FileError

SessionTable: TypeAlias = Mapping[str, npt.NDArray[Any]]  # columns of float64, int64 or int32 by name, shape (n,) each
REPORT: Final = "report"  # fact that a node adds when its session ends
INCOMPLETE: Final = "incomplete"  # fact that says why a recording is incomplete
LARGEST_JSON: Final = 32 * 2**20  # longest text that is read [characters]; values take 30 times the memory
MOST_VALUES: Final = 3_000_000  # most commas and opening brackets in it: each value takes 100 bytes and more
MOST_EVENTS: Final = 300_000  # most events that are read: 12 hours at 7 a second
IN_FORCE: Final = "SettingsInForce"  # name of the events that state settings from their time on (`node.events`)
_SURROGATE: Final = re.compile(r"[\ud800-\udfff]|\\u[dD][89a-fA-F]")

INTEGERS: Final = {  # columns that hold whole numbers, and their types; all others are float64
    "t_us": "i8",
    "answered_us": "i8",
    "transmitted": "i4",
    "datagram_bytes": "i4",
    "breaches": "i4",
    "direction": "i4",
    "kind": "i4",
}


def as_type(values: npt.NDArray[Any], kind: str) -> npt.NDArray[Any]:
    """Return values in the type of their column. Whole numbers have -1 for NaN, and end at what the type can hold."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        return values.astype(dtype)
    least, most = float(np.iinfo(dtype).min), float(np.iinfo(dtype).max)
    if int(most) > np.iinfo(dtype).max:  # float64 has no 2**63 - 1
        most = float(np.nextafter(most, 0.0))
    whole: npt.NDArray[Any] = np.clip(np.nan_to_num(values, nan=-1.0, posinf=most, neginf=least), least, most)
    return whole.astype(dtype)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a recording: float64, except for the columns in `INTEGERS`."""

    name: str  # tick, step, datagram or vibration; the topic is /SIDE/NAME
    columns: tuple[str, ...]  # with units; the first is t_us
    shift_us: int = 0  # added to t_us when a row is written, so that all tables have the master's clock

    @property
    def types(self) -> tuple[str, ...]:
        """NumPy's name of each column's type."""
        return tuple(INTEGERS.get(column, "f8") for column in self.columns)


class Event(NamedTuple):
    """An event of a node: its time [µs], its name, and its fields as JSON."""

    t_us: int
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Session:
    """A recording of hapticnet."""

    side: str  # master or slave
    about: dict[str, Any]  # configuration, seed, versions, and the report if the session ended before the recording
    unix_offset_us: int  # add it to t_us for µs since 1970
    tables: Mapping[str, SessionTable]  # the first is the main one: a row for each tick or step
    events: tuple[Event, ...]  # in order of time
    is_whole: bool = True  # the file is neither cut off nor damaged

    @property
    def complete(self) -> bool:
        """Whether it contains its session to the end."""
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
    """Return the value of a JSON text in a recording; ValueError if it is not JSON, too long or of too many values."""
    if len(text) > LARGEST_JSON:
        raise ValueError(f"{len(text):,} characters of JSON; the limit is {LARGEST_JSON:,}")
    values = sum(map(text.count, ",[{"))
    if values > MOST_VALUES:
        raise ValueError(f"{values:,} values of JSON; the limit is {MOST_VALUES:,}")
    try:
        value = json.loads(text)
        if _SURROGATE.search(text):  # lone surrogates, which no file or terminal accepts; pairs are already joined
            value = json.loads(json.dumps(value, ensure_ascii=False).encode(errors="replace"))
        return value
    except RecursionError as error:
        raise ValueError("JSON that is nested too deeply") from error


def in_force(events: Iterable[Event]) -> list[tuple[int, dict[str, Any]]]:
    """Return the times [µs] from which settings were in force, each until the next, and the settings."""
    found: list[tuple[int, dict[str, Any]]] = []
    for event in events:
        if event.name == IN_FORCE:
            try:
                settings = parse_json(event.text)
            except ValueError:
                continue
            if isinstance(settings, dict):
                found.append((event.t_us, settings))
    return found


def settings_line(settings: Mapping[str, Any]) -> str:
    """Return settings in force as a line for a person."""

    def number(name: str) -> str:
        value = settings.get(name)
        return f"{value:g}" if isinstance(value, (int, float)) and abs(value) < sys.float_info.max else "?"

    parameters = settings.get("parameters")
    texts = [f"{name}={value}" for name, value in parameters.items()] if isinstance(parameters, dict) else []
    codec = f"{settings.get('codec')}{':' * bool(texts)}{','.join(texts)}"
    law = f"{number('multiplier')} JND (weber {number('weber_fraction')}, floor {number('floor_n')} N)"
    line = f"{codec} at {law}, {number('rate_hz')} Hz, scene {settings.get('scene')}"
    if settings.get("position_share"):
        line += f", positions on a line with {number('position_share')} of the JND"
    if settings.get("announced"):
        line += ", announced"
    if settings.get("predicted"):
        line += ", predicted"
    for way in ("channel_out", "channel_in"):
        if settings.get(way):
            line += f", {way.replace('_', ' ')} {settings[way]}"
    return line


def change_notes(events: Iterable[Event]) -> tuple[str, ...]:
    """Return a note that settings changed, for a computation with one codec, JND or delay."""
    spans = in_force(events)
    if len(spans) < 2:
        return ()
    changed = {name for _, settings in spans for name in settings if settings.get(name) != spans[0][1].get(name)}
    times = ", ".join(str(t_us) for t_us, _ in spans[1:6])
    more = f" and {len(spans) - 6} times more" if len(spans) > 6 else ""
    note = (
        f"{', '.join(sorted(changed))} changed during this recording, at t_us {times}{more}: none of them holds for all"
        " of it; 'hapticnet info' lists the settings in force"
    )
    return (note,)
