"""A recorded session, whatever its format."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

SessionTable: TypeAlias = Mapping[str, npt.NDArray[np.float64 | np.int64 | np.int32]]
"""Columns by name, shape (n,) each."""


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
        Configuration, seed, versions, and the report if the recording is complete.
    unix_offset_us
        Add it to `t_us` for µs since 1970.
    tables
        The first is the main one: a row for each tick or step.
    events
        In order of time.
    complete
        Whether the writer finished the file.
    """

    side: str
    about: dict[str, Any]
    unix_offset_us: int
    tables: dict[str, SessionTable]
    events: tuple[Event, ...]
    complete: bool

    @property
    def main(self) -> SessionTable:
        """The main table."""
        return next(iter(self.tables.values()))
