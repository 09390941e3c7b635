"""Frames: messages are received intact, and damaged ones are dropped."""

import binascii
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.messages import LONGEST_BODY, LONGEST_FRAME, Deframer, frame

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "device.json").read_text())

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
