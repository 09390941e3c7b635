"""MCAP files of hapticnet read back: whole, cut off anywhere, or damaged. Source: mcap.dev/spec."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final, TypeAlias

import numpy as np

from hapticnet.errors import FileError, HapticnetError, UnavailableError
from hapticnet.recordings.columns import check_columns
from hapticnet.recordings.session.mcap_writer import ABOUT, NEEDS_MCAP, REPORT
from hapticnet.recordings.session.protobuf import row_dtype, unpack_log
from hapticnet.recordings.session.session import (
    LARGEST_JSON,
    Event,
    Session,
    SessionTable,
    check_events,
    parse_json,
)

_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_SCHEMA_CODE: Final = 3
_CHANNEL_CODE: Final = 4
_MESSAGE_CODE: Final = 5
_IN_CHUNKS: Final = {_SCHEMA_CODE: 14, _CHANNEL_CODE: 16, _MESSAGE_CODE: _MESSAGE.size}
"""Records that may be in a chunk, and the bytes that each has at least. What else is there is damage."""

LARGEST_RECORD: Final = 2**30  # larger records are taken for damage
LARGEST_CHUNK: Final = 2**28
"""Chunks that unpack to more are taken for damage. Writers end a chunk after a few MiB at most."""

MOST_MESSAGES: Final = 10_000
"""Messages that are passed on together: each takes many times its size while it is an object."""

LARGEST_DESCRIPTION: Final = 2**20  # larger descriptions of a topic are taken for damage: schemas and channels
LARGEST_DESCRIPTIONS: Final = 64 * 2**20  # limit of all channels together [B]
RECOVERED: Final = "hapticnet.recovered"  # metadata of a file that an earlier `hapticnet recover` wrote

Record: TypeAlias = Any
"""A record of the package mcap: Channel, Metadata, Footer; or `Messages` or `Damage`."""


class Damage:
    """A record that is damaged."""


@dataclass(frozen=True, slots=True)
class Messages:
    """Consecutive messages of a chunk: channel and content of each."""

    each: list[tuple[int, bytes]]


def records(file: IO[bytes], path: Path, max_bytes: int) -> Iterator[Record]:
    """Yield what is whole in a file, in its order, and stop where it is cut off or its structure is damaged.

    In the place of a record that is damaged comes a `Damage`. A Footer comes last if the file is complete. A channel
    comes once, though files repeat them; schemas and attachments are passed over. Raise FileError if it is not an MCAP
    file, unpacks to more than `max_bytes`, or describes too many topics; nothing beyond the limits is unpacked.
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
    described = _Described(path)
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
                yield from _contents(head + body if record is None else _unpacked(record), described)
            except HapticnetError:
                raise
            except Exception:  # the same, and what the compressors raise
                yield Damage()
            continue
        if code == Opcode.FOOTER and file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return
        yield record
        if code == Opcode.FOOTER:
            return


def _unpacked(chunk: Record) -> bytes:
    """Return a chunk's contents, which are no larger than it says; an exception of many kinds if it is damaged."""
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError("a chunk that unpacks to too much")
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor

        with ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError("a chunk in an unknown compression")
    else:
        data = chunk.data
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a chunk whose contents changed")
    return data


@dataclass(slots=True)
class _Described:
    """The channels of a file so far."""

    path: Path
    seen: set[int] = field(default_factory=set)
    size: int = 0

    def add(self, data: bytes) -> Record:
        """Return a channel, None if it was there already; FileError if they are too large together."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel

        if data[0] | data[1] << 8 in self.seen:
            return None
        self.size += len(data)
        if self.size > LARGEST_DESCRIPTIONS:
            raise FileError(f"{self.path}: its topics take more than {LARGEST_DESCRIPTIONS} bytes to describe")
        channel = Channel.read(ReadDataStream(BytesIO(data)))
        self.seen.add(channel.id)
        return channel


def _contents(data: bytes, described: _Described) -> Iterator[Record]:
    """Yield the records in a chunk; ValueError or struct.error before the first one if their structure is damaged."""
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
        if code == _CHANNEL_CODE and (channel := described.add(data[at : at + length])):
            yield channel
        at += length
    yield Messages(each)


@dataclass(slots=True)
class _Reading:
    """One channel of rows while it is read."""

    name: str
    columns: tuple[str, ...]
    dtype: Any
    parts: list[bytes] = field(default_factory=list)
    whole: bytearray = field(default_factory=bytearray)

    def join(self) -> None:
        """Move messages together, without those that are damaged."""
        self.whole += b"".join(part for part in self.parts if len(part) == self.dtype.itemsize)
        self.parts.clear()


def read_mcap(path: Path, max_bytes: int) -> Session:
    """Return a recording that hapticnet wrote, as far as it is whole; raise FileError if it is something else."""
    reading: dict[int, _Reading] = {}
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
                    if channel in reading:
                        reading[channel].parts.append(data)
                    elif channel in event_channels:
                        logs.append(unpack_log(data))
                for number in {channel for channel, _ in record.each} & reading.keys():
                    reading[number].join()
                check_events(path, len(logs))
            elif kind == "Channel":
                topics[record.id] = record.topic
                if "types" in record.metadata:
                    reading[record.id] = _reading(path, record)
                elif record.topic.endswith("/event"):
                    event_channels.add(record.id)
            elif kind == "Metadata" and record.name in (ABOUT, REPORT, RECOVERED):
                about |= {name: _value(text) for name, text in record.metadata.items()}
    if not reading:
        has = f"its topics are {', '.join(list(topics.values())[:20])}" if topics else "it has no topics"
        has += f"; damaged parts: {damages}" if damages else ""
        raise FileError(f"{path}: an MCAP file, but not a recording of hapticnet: {has}")
    offset_us = about.pop("unix_offset_us", 0)
    offset_us = offset_us if isinstance(offset_us, int) else 0  # damaged, if it is anything else
    tables = {each.name: _table(each) for each in reading.values()}
    return Session(
        side=next(iter(topics.values())).strip("/").partition("/")[0],
        about=about,
        unix_offset_us=offset_us,
        tables=tables,
        events=tuple(Event(time_ns // 1000 - offset_us, name, text) for time_ns, name, text in logs),
        is_whole=whole,
    )


def _reading(path: Path, channel: Record) -> _Reading:
    check_columns(path, 1 + channel.metadata["types"].count(","))
    columns = tuple(channel.metadata["columns"].split(","))
    types = channel.metadata["types"].split(",")
    if len(columns) != len(types) or any(kind not in ("f8", "i8", "i4") for kind in types):
        raise FileError(f"{path}: topic {channel.topic} has unknown types: {channel.metadata['types'][:60]}")
    return _Reading(name=channel.topic.rpartition("/")[2], columns=columns, dtype=row_dtype(types))


def _table(reading: _Reading) -> SessionTable:
    rows = np.frombuffer(reading.whole, dtype=reading.dtype)
    return {name: np.ascontiguousarray(rows[f"v{index}"]) for index, name in enumerate(reading.columns)}


def _value(text: str) -> Any:
    try:
        return parse_json(text)
    except ValueError:
        return text
