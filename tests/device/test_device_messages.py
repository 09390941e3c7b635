"""The table of messages compared with the shared vectors; frames are received intact, and damaged ones dropped."""

import binascii
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.messages import (
    LAYOUTS,
    LONGEST_BODY,
    LONGEST_FRAME,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Deframer,
    Identity,
    Setpoint,
    Stream,
    check_version,
    decode,
    encode,
    frame,
)
from hapticnet.errors import PeerError, RefusedError, SettingsError

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "device.json").read_text())
IDENTITY = Identity(PROTOCOL_MAJOR, 0, 0, 1, 0, 1, 1, 16_000_000, 2360, 4040, 2360, 4040, 2360, 4040, 120, 10)


@pytest.mark.parametrize("vector", VECTORS["messages"], ids=lambda vector: vector["name"])
def test_every_message_is_as_in_the_vectors(vector: dict[str, Any]) -> None:
    message_class, _ = LAYOUTS[vector["kind"]]
    message = message_class(*vector["fields"])
    assert encode(message).hex() == vector["body"]
    assert frame(encode(message)).hex() == vector["frame"]
    assert [decode(body) for body in Deframer().feed(bytes.fromhex(vector["frame"]))] == [message]


def test_the_vectors_contain_every_kind_of_this_version() -> None:
    assert {vector["kind"] for vector in VECTORS["messages"]} == set(LAYOUTS)
    assert VECTORS["protocol_version"] == [PROTOCOL_MAJOR, PROTOCOL_MINOR]


def test_every_message_fits_a_frame_and_names_each_field() -> None:
    for message_class, layout in LAYOUTS.values():
        assert layout.size < LONGEST_BODY
        assert len(message_class._fields) == len(layout.unpack(bytes(layout.size)))


@given(st.binary(max_size=LONGEST_BODY))
def test_any_bytes_are_a_message_or_an_error(body: bytes) -> None:
    try:
        message = decode(body)
    except PeerError:
        return
    assert encode(message) == body


@pytest.mark.parametrize(
    ("body", "complaint"), [(b"", "kind missing"), (b"\x7fab", "kind 7f"), (b"\x03", "1 bytes; it must have 2")]
)
def test_an_invalid_message_is_refused(body: bytes, complaint: str) -> None:
    with pytest.raises(PeerError, match=complaint):
        decode(body)


@pytest.mark.parametrize("message", [Stream(256), Stream(-1), Setpoint(0, 65536, 0, 0), Stream(1.5)])  # type: ignore[arg-type]
def test_a_field_that_does_not_fit_is_refused(message: Stream | Setpoint) -> None:
    with pytest.raises(SettingsError, match="does not fit"):
        encode(message)


def test_another_major_version_is_refused_with_the_command_to_flash() -> None:
    check_version(IDENTITY._replace(protocol_minor=9))
    with pytest.raises(RefusedError, match=r"protocol 2\.0, this host 1\.0.*make -C firmware flash"):
        check_version(IDENTITY._replace(protocol_major=2))


bodies = st.binary(min_size=1, max_size=LONGEST_BODY)


def test_the_crc_is_ccitt_false() -> None:
    check = VECTORS["crc"]
    assert binascii.crc_hqx(check["text"].encode(), 0xFFFF) == check["value"]
    assert frame(check["text"].encode())[-3:-1] == check["value"].to_bytes(2, "little")


@given(bodies)
def test_a_frame_contains_no_zero_except_its_delimiter(body: bytes) -> None:
    framed = frame(body)
    assert framed.index(0) == len(framed) - 1 <= LONGEST_FRAME
    assert Deframer().feed(framed) == [body]


@given(st.lists(bodies, max_size=8), st.data())
def test_frames_are_found_however_the_stream_is_split(sent: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(map(frame, sent))
    deframer, received = Deframer(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        received += deframer.feed(stream[:size])
        stream = stream[size:]
    assert received == sent
    assert (deframer.received, deframer.damaged) == (len(sent), 0)


@given(st.binary(max_size=300), bodies)
def test_the_first_complete_frame_after_garbage_is_received(garbage: bytes, body: bytes) -> None:
    deframer = Deframer()
    deframer.feed(garbage + b"\0")
    assert deframer.feed(frame(body)) == [body]


@given(bodies, st.data())
def test_a_flipped_bit_is_detected(body: bytes, data: st.DataObject) -> None:
    framed = bytearray(frame(body))
    bit = data.draw(st.integers(0, 8 * (len(framed) - 1) - 1))
    framed[bit // 8] ^= 1 << bit % 8
    deframer = Deframer()
    assert body not in deframer.feed(bytes(framed))
    assert deframer.damaged >= 1


@pytest.mark.parametrize("vector", VECTORS["damaged"], ids=lambda vector: vector["name"])
def test_damaged_frames_are_counted_and_dropped(vector: dict[str, str]) -> None:
    deframer = Deframer()
    assert deframer.feed(bytes.fromhex(vector["frame"])) == []
    assert deframer.damaged == 1


def test_a_line_without_delimiters_uses_bounded_memory_and_counts_as_one_frame() -> None:
    deframer = Deframer()
    for _ in range(1000):
        assert deframer.feed(b"\x11" * 100) == []
        assert len(deframer._partial) <= LONGEST_FRAME
    assert deframer.feed(b"\0\0\0" + frame(b"after") + b"\0") == [b"after"]  # idle delimiters are no damage
    assert deframer.damaged == 1
