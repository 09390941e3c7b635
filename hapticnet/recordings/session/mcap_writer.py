"""Recordings as MCAP with Protocol Buffers, for Foxglove, PlotJuggler and the readers of mcap.dev."""

import json
from collections.abc import Mapping
from typing import Any, Final

from hapticnet.arrays import FloatArray
from hapticnet.errors import UnavailableError
from hapticnet.recordings.session.frames import Heading
from hapticnet.recordings.session.protobuf import LOG, PACKAGE, log_descriptor, pack_log, pack_rows, row_descriptor
from hapticnet.recordings.session.sink import Sink

CHUNK_BYTES: Final = 64 * 1024  # uncompressed size of a chunk; `flush` ends one earlier
MESSAGE_BYTES: Final = 47  # most bytes that a message adds to its fields: 31 B in the chunk, 16 B in the index
CHUNK_OVERHEAD_BYTES: Final = 400  # most bytes that a chunk adds, with its index of three channels in the summary
FIXED_BYTES: Final = 8192  # room for schemas, channels, statistics and metadata, which are written twice or at the end

DISTURBANCES: Final = frozenset(  # events logged as warnings: the run continues or ends safely
    (
        "LinkStale", "SessionLost", "Refused", "ChangeRefused", "Hinted", "Noticed", "DeviceLost", "Paused", "Failed",
        "ForceFault", "FingerNotMet", "HeldBack", "StepsTooSlow", "ScenePaused",
        "SceneSaid",
    )
)  # fmt: skip
ABOUT: Final = "hapticnet"
REPORT: Final = "hapticnet.report"
NEEDS_MCAP: Final = ".mcap files need the package mcap (extra record): pip install mcap"


class McapWriter:
    """Write a recording as MCAP; raise UnavailableError without the extra ``record``, OSError if it cannot be written.

    Each table is a topic ``/SIDE/TABLE``, events are logs on ``/SIDE/event``; times are in ns since 1970.
    """

    def __init__(self, heading: Heading) -> None:
        try:
            from mcap.writer import CompressionType, Writer
        except ImportError as error:
            raise UnavailableError(NEEDS_MCAP) from error
        self._heading = heading
        self._sink = Sink(heading.path)
        self.files = (self._sink,)  # the files being written
        self._writer: Any = Writer(self._sink, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)  # type: ignore[arg-type]  # write, tell and flush are all that it uses
        self._pending = 0
        self._chunks = 0
        self._writer.start(profile="", library="hapticnet")
        self._writer.add_metadata(ABOUT, _texts({**heading.about, "unix_offset_us": heading.unix_offset_us}))
        self._channels = []
        for table in heading.tables:
            message = table.name.title()
            schema = row_descriptor(message, table.columns, table.types)
            columns = {"columns": ",".join(table.columns), "types": ",".join(table.types)}
            self._channels.append(self._channel(table.name, f"{PACKAGE}.{message}", schema, columns))
        self._events = self._channel("event", LOG, log_descriptor(), {})
        self._sink.flush()

    @property
    def size(self) -> int:
        """Upper limit of the file's size if finished now [B]."""
        return self._sink.tell() + self._pending + CHUNK_OVERHEAD_BYTES * (self._chunks + 1) // 2 + FIXED_BYTES

    def bound(self, table: int, rows: int) -> int:
        """Return the most bytes that this many more rows take."""
        return rows * (10 * len(self._heading.tables[table].columns) + MESSAGE_BYTES)

    def rows(self, table: int, rows: FloatArray) -> None:
        """Add rows, shape (n, columns)."""
        packed = pack_rows(rows, self._heading.tables[table].types)
        times_ns = ((packed["v0"] + self._heading.unix_offset_us) * 1000).tolist()
        data, size = packed.tobytes(), packed.itemsize
        add, channel = self._writer.add_message, self._channels[table]
        for index, time_ns in enumerate(times_ns):
            add(channel, time_ns, data[index * size : (index + 1) * size], time_ns)
        self._pending += len(rows) * (size + MESSAGE_BYTES)

    def event(self, t_us: int, name: str, text: str) -> None:
        """Add an event."""
        time_ns = (t_us + self._heading.unix_offset_us) * 1000
        data = pack_log(time_ns, "WARNING" if name in DISTURBANCES else "INFO", name, text)
        self._writer.add_message(self._events, time_ns, data, time_ns)
        self._pending += len(data) + MESSAGE_BYTES

    def flush(self) -> None:
        """End the chunk, so that all rows so far can be recovered if this process is killed."""
        if self._pending:
            self._writer.flush()
            self._pending = 0
            self._chunks += 1

    def finish(self, about: Mapping[str, Any]) -> None:
        """Complete the file; `about` are further facts, such as the report."""
        self.flush()
        if about:
            self._writer.add_metadata(REPORT, _texts(about))
        self._writer.finish()
        self._sink.finish()

    def _channel(self, name: str, message: str, schema: bytes, columns: dict[str, str]) -> int:
        number = self._writer.register_schema(message, "protobuf", schema)
        topic = f"/{self._heading.side}/{name}"
        channel: int = self._writer.register_channel(topic, "protobuf", number, columns)
        return channel


def _texts(about: Mapping[str, Any]) -> dict[str, str]:
    """Return facts as MCAP's metadata: text unchanged, everything else as JSON."""
    return {name: value if isinstance(value, str) else json.dumps(value, default=str) for name, value in about.items()}
