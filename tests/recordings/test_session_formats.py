"""What is written is read back, in every format and by the public readers."""

import json
import sys
import tracemalloc

import numpy as np
import pytest
import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap_protobuf.decoder import DecoderFactory

from hapticnet.errors import FileError, UnavailableError
from hapticnet.node.recording import DATAGRAM_COLUMNS, master_columns
from hapticnet.recordings.loading import load_motion, load_recording
from hapticnet.recordings.session import mcap_reader
from hapticnet.recordings.session import session as session_module
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.mcap_reader import records
from hapticnet.recordings.session.protobuf import LEVELS, log_descriptor, pack_log, row_descriptor, unpack_log, varint
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.session import as_type
from tests.recordings.session_cases import (
    ABOUT,
    EVENTS,
    OFFSET_US,
    SUFFIXES,
    write_session,
)

TICKS = 400
FEW_FACTS = '{"side": "master", "unix_offset_us": 0}'


@pytest.fixture(params=SUFFIXES)
def suffix(request):
    return request.param


def read_of(tmp_path, suffix="", events="[]", **arrays):
    """Return what is read of arrays in a NumPy archive, or after an export to another format."""
    np.savez(tmp_path / "a.npz", **({"about": FEW_FACTS, "events": events, "t_us": np.arange(5)} | arrays))
    session = read_session(tmp_path / "a.npz")
    if not suffix:
        return session
    export(session, tmp_path / f"out{suffix}")
    return read_session(tmp_path / f"out{suffix}")


@pytest.mark.parametrize("axes", [1, 3])
def test_a_recording_reads_back_exactly_and_as_motion_too(tmp_path, suffix, axes):
    path = tmp_path / f"run{suffix}"
    rows = write_session(path, ticks=TICKS, axes=axes)
    session = read_session(path)
    assert session.complete
    assert session.side == "master"
    assert session.unix_offset_us == OFFSET_US
    assert session.about == ABOUT | {"report": {"ticks": TICKS}}
    assert [tuple(event) for event in session.events] == EVENTS
    assert list(session.tables) == ["tick", "datagram"]
    for name, columns in (("tick", master_columns(axes)), ("datagram", DATAGRAM_COLUMNS)):
        assert tuple(session.tables[name]) == columns
        for index, column in enumerate(columns):
            np.testing.assert_array_equal(session.tables[name][column], rows[name][:, index])
    assert not list(tmp_path.glob("*.unfinished*"))
    motion = load_motion(path)
    np.testing.assert_array_equal(motion.t_us, rows["tick"][:, 0])
    np.testing.assert_array_equal(motion.position, rows["tick"][:, 1 : 1 + axes])
    held = master_columns(axes)[1 + 2 * axes : 1 + 3 * axes]
    np.testing.assert_array_equal(
        load_recording(path, columns=held).force, rows["tick"][:, 1 + 2 * axes : 1 + 3 * axes]
    )


def test_the_public_reader_decodes_every_message_of_an_mcap_file(tmp_path):
    path = tmp_path / "run.mcap"
    rows = write_session(path, ticks=TICKS)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        messages = [(channel.topic, *found) for _, channel, *found in reader.iter_decoded_messages()]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    topics = sorted(channel.topic for channel in summary.channels.values())
    assert topics == ["/master/datagram", "/master/event", "/master/tick"]
    ticks = [(message, decoded) for topic, message, decoded in messages if topic == "/master/tick"]
    decoded = np.array([[getattr(tick, name) for name in master_columns(1)] for _, tick in ticks])
    np.testing.assert_array_equal(decoded, rows["tick"])
    assert [message.log_time for message, _ in ticks] == [(int(t_us) + OFFSET_US) * 1000 for t_us in rows["tick"][:, 0]]
    logs = [(message, log) for topic, message, log in messages if topic == "/master/event"]
    assert [(message.log_time // 1000 - OFFSET_US, log.name, log.message) for message, log in logs] == EVENTS
    assert all(log.timestamp.ToNanoseconds() == message.log_time for message, log in logs)
    assert {log.level for _, log in logs} == {list(LEVELS).index("INFO")}
    schemas = {summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert schemas == {"hapticnet.Tick", "hapticnet.Datagram", "foxglove.Log"}
    assert json.loads(metadata["hapticnet"]["asked_at_start"]) == ABOUT["asked_at_start"]
    assert json.loads(metadata["hapticnet.report"]["report"]) == {"ticks": TICKS}


def test_the_descriptor_is_one_that_protobuf_reads():
    columns = ("t_us", "force_x_n", "breaches")
    files = FileDescriptorSet.FromString(row_descriptor("Step", columns, ("i8", "f8", "i4"))).file
    (message,) = files[0].message_type
    assert (files[0].package, message.name, files[0].syntax) == ("hapticnet", "Step", "proto3")
    fields = [(field.name, field.number, field.type) for field in message.field]
    assert fields == [("t_us", 1, 16), ("force_x_n", 2, 1), ("breaches", 3, 15)]
    assert [varint(number) for number in (0, 127, 128, 300)] == [b"\0", b"\x7f", b"\x80\1", b"\xac\2"]


def test_the_descriptor_of_a_log_is_that_of_foxglove():
    """As in schemas/proto/foxglove/Log.proto and LogLevel.proto of github.com/foxglove/schemas."""
    _, levels, log = FileDescriptorSet.FromString(log_descriptor()).file
    assert (levels.package, log.package, log.message_type[0].name) == ("foxglove", "foxglove", "Log")
    assert [(field.name, field.number, field.type, field.type_name) for field in log.message_type[0].field] == [
        ("timestamp", 1, 11, ".google.protobuf.Timestamp"), ("level", 2, 14, ".foxglove.LogLevel"),
        ("message", 3, 9, ""), ("name", 4, 9, ""), ("file", 5, 9, ""), ("line", 6, 7, ""),
    ]  # fmt: skip
    assert [value.name for value in levels.enum_type[0].value] == list(LEVELS)


@pytest.mark.parametrize("time_ns", [0, 1, 1_790_000_000_123_456_000, -1_000, -1_000_000_001])
def test_a_log_reads_back(time_ns):
    assert unpack_log(pack_log(time_ns, "WARNING", "LinkStale", "")) == (time_ns, "LinkStale", "")


def test_an_event_that_is_cut_off_is_refused():
    whole = pack_log(1, "INFO", "name", "text")
    for cut in range(len(whole)):
        with pytest.raises(ValueError, match=r"event|end of its message"):
            unpack_log(whole[:cut])


def test_csv_has_datagrams_events_and_configuration_beside_it(tmp_path):
    write_session(tmp_path / "run.csv", ticks=10)
    names = sorted(file.name for file in tmp_path.iterdir())
    assert names == ["run.about.json", "run.csv", "run.datagrams.csv", "run.events.csv"]
    assert (tmp_path / "run.csv").read_text().splitlines()[1].startswith("1000000,"), "times are whole numbers"


def test_something_else_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.csv").write_text("t_us,x\n1,2\n")
    np.savez(tmp_path / "a.npz", x=np.arange(3))
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\0" * 100)
    for suffix in SUFFIXES:
        with pytest.raises(FileError, match="not a recording of hapticnet"):
            read_session(tmp_path / f"a{suffix}")


def test_without_the_extra_one_line_says_what_to_install(tmp_path, monkeypatch):
    write_session(tmp_path / "run.mcap", ticks=10)
    monkeypatch.setitem(sys.modules, "mcap.data_stream", None)
    with pytest.raises(UnavailableError, match=r"pip install mcap"):
        read_session(tmp_path / "run.mcap")


def mcap_with_chunks(path, *chunks):
    """Write a recording, and behind its rows chunks of contents and declared size."""
    write_session(path, ticks=10)
    data = path.read_bytes()
    builder = RecordBuilder()
    for contents, size in chunks:
        packed = zstandard.compress(contents)
        Chunk("zstd", packed, 0, 0, 0, len(contents) if size is None else size).write(builder)
    path.write_bytes(data[: data.index(b"\x0f\x04\0\0\0\0\0\0\0")] + builder.end())  # in the place of DataEnd


def zeros(count):
    return bytes([0x7F]) + count.to_bytes(8, "little") + bytes(count)


@pytest.mark.parametrize("size", [None, 100])
def test_what_a_chunk_unpacks_to_is_bounded_before_it_is_unpacked(tmp_path, size):
    """Whether it says how large it is, or says less; what is in it counts, whatever it is."""
    limit = 8 * 2**20
    mcap_with_chunks(tmp_path / "run.mcap", *[(zeros(4 * 2**20), size)] * 20)
    assert (tmp_path / "run.mcap").stat().st_size < limit / 10
    tracemalloc.start()
    try:
        if size is None:
            with pytest.raises(FileError, match=f"unpacks to more than {limit} bytes"):
                read_session(tmp_path / "run.mcap", max_bytes=limit)
        else:
            session = read_session(tmp_path / "run.mcap", max_bytes=limit)
            assert len(session.main["t_us"]) == 10
            assert not session.is_whole
        assert tracemalloc.get_traced_memory()[1] < 3 * limit
    finally:
        tracemalloc.stop()


def mcap_record(code, body):
    return bytes([code]) + len(body).to_bytes(8, "little") + body


def channel_record(number, types):
    def text(content):
        return len(content).to_bytes(4, "little") + content

    metadata = text(b"columns") + text(b"," * types.count(b",")) + text(b"types") + text(types)
    body = number.to_bytes(2, "little") + bytes(2) + text(b"/master/tick") + text(b"protobuf")
    return mcap_record(4, body + len(metadata).to_bytes(4, "little") + metadata)


@pytest.mark.parametrize(
    "contents",
    [
        mcap_record(5, b"") * 10_000,
        mcap_record(4, b"") * 10_000,
        mcap_record(99, b"") * 10_000,
        mcap_record(5, bytes(30)) + mcap_record(99, b""),
        channel_record(9, b"f8," * 2**20 + b"f8"),
    ],
)
def test_a_chunk_with_other_records_than_the_format_has_is_damaged_as_a_whole(tmp_path, contents):
    mcap_with_chunks(tmp_path / "run.mcap", (contents, None))
    with (tmp_path / "run.mcap").open("rb") as file:
        kinds = [type(record).__name__ for record in records(file, tmp_path / "run.mcap", 2**30)]
    assert kinds.count("Damage") == 1
    assert len(kinds) < 20


def test_a_file_of_zeros_ends_at_the_first(tmp_path):
    mcap_with_chunks(tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("r+b") as file:
        file.truncate(8)
        file.truncate(2**31 - 1)
    with pytest.raises(FileError, match="it has no topics"):
        read_session(tmp_path / "run.mcap")


def test_topics_with_too_many_columns_or_too_long_descriptions_are_refused(tmp_path, monkeypatch):
    mcap_with_chunks(tmp_path / "run.mcap", (channel_record(9, b"f8," * 10_000 + b"f8"), None))
    with pytest.raises(FileError, match="10,001 columns; the limit is 10,000"):
        read_session(tmp_path / "run.mcap")
    monkeypatch.setattr(mcap_reader, "LARGEST_DESCRIPTIONS", 1000)
    with pytest.raises(FileError, match="its topics take more than 1000 bytes to describe"):
        read_session(tmp_path / "run.mcap")


def test_a_description_that_is_repeated_counts_once(tmp_path):
    repeated = channel_record(9, b"f8") * 1000
    mcap_with_chunks(tmp_path / "run.mcap", (repeated, None), (repeated, None))
    with (tmp_path / "run.mcap").open("rb") as file:
        found = [record for record in records(file, tmp_path / "run.mcap", 2**30) if type(record).__name__ == "Channel"]
    assert [channel.id for channel in found].count(9) == 1


def test_events_and_json_of_every_format_are_limited_because_they_grow_in_memory(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"run{suffix}"
    write_session(path, ticks=10)
    with monkeypatch.context() as limited:
        limited.setattr(session_module, "MOST_EVENTS", 3)
        with pytest.raises(FileError, match="more than 3 events, which is the limit"):
            read_session(path)
    for limit, most in (("LARGEST_JSON", 10), ("MOST_VALUES", 0)):
        with monkeypatch.context() as limited:
            limited.setattr(session_module, limit, most)
            if suffix == ".mcap":  # a text that is no JSON stays a text
                assert isinstance(read_session(path).about["report"], str)
            else:
                with pytest.raises(FileError, match="not a recording"):
                    read_session(path)


@pytest.mark.filterwarnings("error")
def test_whole_numbers_out_of_range_end_at_what_the_type_can_hold(tmp_path, suffix):
    found = read_of(tmp_path, suffix, datagram_bytes=np.array([1e300, -1e300, np.inf, -np.inf, 7.0]))
    most, least = 2**31 - 1, -(2**31)
    assert found.main["datagram_bytes"].tolist() == [most, least, most, least, 7]


@pytest.mark.parametrize("kind", ["i4", "i8"])
def test_the_largest_whole_numbers_are_kept(kind):
    limits = np.iinfo(kind)
    values = as_type(np.array([limits.max, limits.min, np.nan, 1e30]), kind)
    assert values[1:3].tolist() == [limits.min, -1]
    assert 0 <= limits.max - int(values[0]) < 2048
    assert values[3] == values[0]


def test_half_a_character_in_facts_and_events_is_replaced(tmp_path, suffix):
    about = FEW_FACTS[:-1] + ', "a": "\\ud800 \\ud83d\\ude00"}'
    session = read_of(tmp_path, suffix, about=about, events='[[1, "\\udfff", "{}"]]')
    assert session.about["a"] == "? \U0001f600"
    assert session.events[0].name == "?"


@pytest.mark.parametrize("name", ["../../x", "a/b", ".", "x\x1b", "x" * 100])
def test_a_table_whose_name_is_no_word_is_damage(tmp_path, name):
    with pytest.raises(FileError, match="is not a valid name of a table"):
        read_of(tmp_path, **{f"{name}.t_us": np.arange(5)})
