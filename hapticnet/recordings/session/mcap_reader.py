"""Read hapticnet's MCAP files: complete, cut off anywhere, or damaged. Source: mcap.dev/spec."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, TypeAlias

import numpy as np

from hapticnet.errors import FileError, HapticnetError, UnavailableError
from hapticnet.recordings.columns import check_columns
from hapticnet.recordings.session.mcap_writer import ABOUT, NEEDS_MCAP, REPORT
from hapticnet.recordings.session.protobuf import row_dtype, unpack_log
from hapticnet.recordings.session.session import LARGEST_JSON, Event, Session, SessionTable, check_events, parse_json

_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_SCHEMA_CODE: Final = 3
_CHANNEL_CODE: Final = 4
_MESSAGE_CODE: Final = 5
# Records allowed in a chunk, and the least size of each. Anything else is damage.
_IN_CHUNKS: Final = {_SCHEMA_CODE: 14, _CHANNEL_CODE: 16, _MESSAGE_CODE: _MESSAGE.size}
LARGEST_RECORD: Final = 2**30  # larger records are taken for damage
LARGEST_CHUNK: Final = 2**28  # larger unpacked chunks are taken for damage: writers end one after a few MiB
MOST_MESSAGES: Final = 10_000  # most messages passed on together: as objects, each takes many times its size
LARGEST_DESCRIPTION: Final = 2**20  # larger descriptions of a topic are taken for damage: schemas and channels
LARGEST_DESCRIPTIONS: Final = 64 * 2**20  # limit of all channels together [B]
Record: TypeAlias = Any  # a record of the package mcap: Channel, Metadata, Footer; or `Messages` or `Damage`


class Damage:
    """A record that is damaged."""


@dataclass(frozen=True, slots=True)
class Messages:
    """Consecutive messages of a chunk: channel and content of each."""

    each: list[tuple[int, bytes]]


def records(file: IO[bytes], path: Path, max_bytes: int) -> Iterator[Record]:
    """Yield the undamaged records of a file, a `Damage` for others, and a Footer last if the file is complete.

    A channel comes once, although files repeat them; schemas and attachments are skipped. Raise FileError if it is
    not an MCAP file, unpacks to more than `max_bytes`, or describes too many topics.
    """
    try:
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.records import Chunk, Footer, Metadata
        from mcap.writer import MCAP0_MAGIC
    except ImportError as error:
        raise UnavailableError(NEEDS_MCAP) from error

    kinds: dict[int, Any] = {Opcode.METADATA: Metadata, Opcode.CHUNK: Chunk, Opcode.FOOTER: Footer}
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise FileError(f"{path}: not an MCAP file")
    described: dict[int, int] = {}
    unpacked = 0
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        code, length = _RECORD.unpack(head)
        if not code or length > LARGEST_RECORD:  # the specification has no record 0
            return
        if code not in kinds and code not in _IN_CHUNKS:  # indexes, attachments and the like
            file.seek(length, 1)
            continue
        body = file.read(length)
        if len(body) < length:
            return
        if code == Opcode.METADATA and length > LARGEST_JSON:
            yield Damage()
            continue
        try:
            record: Any = None if code in _IN_CHUNKS else kinds[code].read(ReadDataStream(BytesIO(body)))
        except Exception:  # struct.error, ValueError, MemoryError
            yield Damage()
            continue
        unpacked += record.uncompressed_size if code == Opcode.CHUNK else length
        if unpacked > max_bytes:
            raise FileError(f"{path}: unpacks to more than {max_bytes} bytes, which is the limit")
        if code == Opcode.CHUNK or record is None:  # the latter in a file without chunks
            try:
                yield from _contents(path, head + body if record is None else _unpacked(record), described)
            except HapticnetError:
                raise
            except Exception:  # the same, and errors of the compressors
                yield Damage()
            continue
        if code == Opcode.FOOTER and file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return
        yield record
        if code == Opcode.FOOTER:
            return


def _unpacked(chunk: Record) -> bytes:
    """Return a chunk's contents, no larger than it declares; raise any of many exceptions if it is damaged."""
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError("a chunk that unpacks to too much")
    if chunk.compression != "zstd":
        raise ValueError("a chunk in a compression that hapticnet does not write")
    from zstandard import ZstdDecompressor

    with ZstdDecompressor().stream_reader(chunk.data) as stream:
        data = stream.read(size + 1)
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a chunk whose contents changed")
    return data


def _contents(path: Path, data: bytes, described: dict[int, int]) -> Iterator[Record]:
    """Yield a chunk's records; ValueError or struct.error before the first if damaged; `described`: channels so far."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Channel

    at, end = 0, len(data)
    while at < end:
        code, length = _RECORD.unpack_from(data, at)
        if length < _IN_CHUNKS[code] or (code != _MESSAGE_CODE and length > LARGEST_DESCRIPTION):
            raise ValueError("a record that is too short or too long")
        at += _RECORD.size + length
    if at > end:
        raise ValueError("a record reaches past the end of its chunk")
    at = 0
    each: list[tuple[int, bytes]] = []
    while at < end:
        code, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if code == _MESSAGE_CODE:
            each.append((_MESSAGE.unpack_from(data, at)[0], data[at + _MESSAGE.size : at + length]))
        if each and (code != _MESSAGE_CODE or len(each) == MOST_MESSAGES):
            yield Messages(each)
            each = []
        if code == _CHANNEL_CODE and data[at] | data[at + 1] << 8 not in described:
            total = length + next(reversed(described.values()), 0)
            if total > LARGEST_DESCRIPTIONS:
                raise FileError(f"{path}: its topics take more than {LARGEST_DESCRIPTIONS} bytes to describe")
            channel = Channel.read(ReadDataStream(BytesIO(data[at : at + length])))
            described[channel.id] = total
            yield channel
        at += length
    yield Messages(each)


class _Rows(NamedTuple):
    table: str
    columns: tuple[str, ...]
    dtype: np.dtype[Any]
    data: bytearray

    @classmethod
    def of(cls, path: Path, channel: Record) -> "_Rows":
        check_columns(path, 1 + channel.metadata["types"].count(","))
        columns = tuple(channel.metadata["columns"].split(","))
        types = channel.metadata["types"].split(",")
        if len(columns) != len(types) or any(kind not in ("f8", "i8", "i4") for kind in types):
            raise FileError(f"{path}: topic {channel.topic} has unknown types: {channel.metadata['types'][:60]}")
        return cls(channel.topic.rpartition("/")[2], columns, row_dtype(types), bytearray())

    def read(self) -> SessionTable:
        rows = np.frombuffer(self.data, dtype=self.dtype)
        return {name: np.ascontiguousarray(rows[f"v{index}"]) for index, name in enumerate(self.columns)}


def read_mcap(path: Path, max_bytes: int) -> Session:
    """Return the undamaged part of a recording that hapticnet wrote; raise FileError for any other file."""
    tables: dict[int, _Rows] = {}
    logs: list[tuple[int, str, str]] = []
    event_channels: set[int] = set()
    about: dict[str, Any] = {}
    topics: dict[int, str] = {}
    whole, damages = False, 0
    with path.open("rb") as file:
        for record in records(file, path, max_bytes):
            kind = type(record).__name__
            damages += kind == "Damage"
            whole = kind == "Footer" and not damages
            if isinstance(record, Messages):
                for channel, data in record.each:
                    rows = tables.get(channel)
                    if rows is not None and len(data) == rows.dtype.itemsize:  # otherwise it is damaged
                        rows.data.extend(data)
                    elif channel in event_channels:
                        logs.append(unpack_log(data))
                check_events(path, len(logs))
            elif kind == "Channel":
                topics[record.id] = record.topic
                if "types" in record.metadata:
                    tables[record.id] = _Rows.of(path, record)
                elif record.topic.endswith("/event"):
                    event_channels.add(record.id)
            elif kind == "Metadata" and record.name in (ABOUT, REPORT):
                about |= {name: _value(text) for name, text in record.metadata.items()}
    if not tables:
        has = f"its topics are {', '.join(list(topics.values())[:20])}" if topics else "it has no topics"
        has += f"; damaged parts: {damages}" if damages else ""
        raise FileError(f"{path}: an MCAP file, but not a recording of hapticnet: {has}")
    offset_us = about.pop("unix_offset_us", 0)
    offset_us = offset_us if isinstance(offset_us, int) else 0  # anything else is damaged
    return Session(
        side=next(iter(topics.values())).strip("/").partition("/")[0],
        about=about,
        unix_offset_us=offset_us,
        tables={rows.table: rows.read() for rows in tables.values()},
        events=tuple(Event(time_ns // 1000 - offset_us, name, text) for time_ns, name, text in logs),
        is_whole=whole,
    )


def _value(text: str) -> Any:
    try:
        return parse_json(text)
    except ValueError:
        return text
