"""A recording for tests: its heading, its rows, and an archive that takes it in without a process."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hapticnet.node.recording import DATAGRAM_COLUMNS, master_columns
from hapticnet.recordings.session.archive import Archive
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.frames import (
    FrameKind,
    Heading,
    frame_reader,
    pack_begin,
    pack_frame,
    pack_rows_header,
)
from hapticnet.recordings.session.session import Event, Session, Table

PLENTY = 2**30
OFFSET_US = 1_790_000_000_000_000
LIVE = (".mcap", ".csv")
SUFFIXES = (*LIVE, ".npz")
ABOUT = {"seed": 7, "asked_at_start": {"codec": "deadband"}}
FIRST = {"codec": "deadband", "parameters": {}, "multiplier": 1.0, "weber_fraction": 0.05, "floor_n": 0.025,
         "rate_hz": 1000.0, "scene": "paper:1", "channel_in": "delay=5ms"}  # fmt: skip
SECOND = FIRST | {"codec": "level-crossing", "parameters": {"hysteresis": 0.5}, "channel_in": "delay=20ms"}
EVENTS = [
    (1_000_000, "Connected", '{"scene": "paper"}'),
    (1_001_000, "SettingsInForce", json.dumps(FIRST)),
    (1_100_000, "SettingsInForce", json.dumps(SECOND)),
    (1_500_000, "Ended", "ein Ende – mit Umlaut ä"),
]


def heading(path: Path, *, axes: int = 1) -> Heading:
    tables = (Table("tick", master_columns(axes)), Table("datagram", DATAGRAM_COLUMNS))
    return Heading(path=path, side="master", tables=tables, unix_offset_us=OFFSET_US, about=ABOUT)


def tick_rows(count: int, *, axes: int = 1, first: int = 0) -> np.ndarray:
    """Return rows of a master's recording; the position and forces are noise, so that nothing compresses."""
    columns = master_columns(axes)
    rows = np.random.default_rng(first).normal(size=(count, len(columns)))
    rows[:, 0] = 1_000_000 + 1000 * np.arange(first, first + count)
    return rows


def datagram_rows(count: int) -> np.ndarray:
    numbers = np.arange(count)
    return np.stack([1_000_000 + 500 * numbers, numbers % 2, 4 + numbers % 2, 20 + numbers % 9], axis=1).astype(float)


def feed(archive: Archive, data: bytes) -> None:
    reader = frame_reader()
    reader.feed(data)
    for frame in reader:
        archive.take(*frame)


def give(archive: Archive, kind: FrameKind, *content: object, recording: int = 1) -> None:
    """Pass a frame to an archive, as bytes that come through a pipe."""
    feed(archive, pack_frame(kind, recording, *content))


def begin(archive: Archive, path: Path, *, recording: int = 1, axes: int = 1) -> None:
    feed(archive, pack_begin(recording, heading(path, axes=axes)))


def give_rows(archive: Archive, rows: np.ndarray, table: int = 0, *, recording: int = 1) -> None:
    feed(archive, pack_rows_header(recording, table, rows.nbytes) + rows.tobytes())


def make_archive(said: list[str], limit_bytes: int = PLENTY) -> Archive:
    return Archive(lambda reason, is_fault: said.append(f"{is_fault}: {reason}"), said.append, limit_bytes=limit_bytes)


def write_session(
    path: Path, *, ticks: int = 2000, axes: int = 1, batch: int = 100, finish: bool = True
) -> dict[str, np.ndarray]:
    """Write a recording with events and datagrams, in batches if it is live, and return the rows of its tables."""
    rows = {"tick": tick_rows(ticks, axes=axes), "datagram": datagram_rows(2 * ticks)}
    if path.suffix == ".npz":
        tables = {
            table.name: dict(zip(table.columns, rows[table.name].T, strict=True))
            for table in heading(path, axes=axes).tables
        }
        about = ABOUT | {"report": {"ticks": ticks}} if finish else ABOUT
        export(Session("master", about, OFFSET_US, tables, tuple(Event(*each) for each in EVENTS)), path)
        return rows
    said: list[str] = []
    archive = make_archive(said)
    begin(archive, path, axes=axes)
    for event in EVENTS:
        give(archive, FrameKind.EVENT, *event)
    for start in range(0, ticks, batch):
        give_rows(archive, rows["tick"][start : start + batch])
        give_rows(archive, rows["datagram"][2 * start : 2 * (start + batch)], 1)
        archive.flush()
    if finish:
        give(archive, FrameKind.ABOUT, {"report": {"ticks": ticks}})
        give(archive, FrameKind.END)
    assert said == []
    return rows


def write_csv(path: Path, columns: Mapping[str, npt.ArrayLike]) -> None:
    """Write columns of equal length under their names."""
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
