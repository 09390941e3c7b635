"""The messages between page and server."""

import contextlib
import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet.operator.live import HandState
from hapticnet.web import messages
from hapticnet.web.messages import Change, Hand, MistakeError, Order
from tests.web.rig import read_frame, read_samples


def test_a_frame_is_as_specified():
    data = messages.frame(HandState.LIVE, 7, 12.5, 0.25, (0.25, 0.5), (1, 0))
    assert len(data) == 20 + 2 * 4 + 2
    assert read_frame(data) == {
        "state": 1, "number": 7, "time_ms": 12.5, "tip_m": 0.25, "surfaces_m": (0.25, 0.5), "contacts": (1, 0),
        "further": (),
    }  # fmt: skip
    of_three_axes = messages.frame(HandState.LIVE, 7, 12.5, 0.25, (), (), (0.5, 0.75, 1.0, 2.0, 3.0))
    assert read_frame(of_three_axes)["further"] == (0.5, 0.75, 1.0, 2.0, 3.0)


def test_samples_are_column_by_column():
    columns = np.arange(6.0).reshape(2, 3)
    first, start_s, read = read_samples(messages.samples(2**32 + 5, 1.5, columns))
    assert (first, start_s) == (5, 1.5)
    assert (read == columns).all()


def test_what_a_page_may_say():
    assert messages.parse_text('{"type": "take"}') == Order.TAKE
    assert messages.parse_text('{"type": "release"}') == Order.RELEASE
    assert messages.parse_text('{"type": "let_go"}') == Order.LET_GO
    assert messages.parse_text('{"type": "set", "codec": "raw", "delay_ms": 20}') == Change(codec="raw", delay_ms=20)
    assert messages.parse_binary(struct.pack("<BBHfd", 1, 0, 0, 0.5, 3.25)) == Hand((0.5,), 3.25)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "must be an object"),
        ('{"type": 3}', "must be an object"),
        ('{"type": "fire"}', "unknown message 'fire'; there are: take, release, let_go, set"),
        ('{"type": "take", "now": 1}', "has no key 'now'"),
        ('{"type": "set"}', "changes nothing"),
        ('{"type": "set", "seed": 1}', "cannot set 'seed'"),
        ('{"type": "set", "codec": 1}', "codec must be a name"),
        ('{"type": "set", "multiplier": "1"}', "must be a number"),
        ('{"type": "set", "multiplier": true}', "must be a number"),
        ('{"type": "set", "delay_ms": 900}', "delay_ms is 900; it must be between 0 and 250"),
        ('{"type": "set", "delay_ms": -1}', "must be between"),
        ('{"type": "set", "loss_percent": NaN}', "must be between"),
        ('{"type": "set", "loss_percent": ' + "9" * 400 + "}", "must be between"),
    ],
)
def test_a_malformed_text_is_refused_in_one_short_line(text: str, complaint: str):
    with pytest.raises(MistakeError, match=complaint) as refused:
        messages.parse_text(text)
    assert len(str(refused.value)) < 200
    assert "\n" not in str(refused.value)


def test_a_page_of_a_package_reads_messages_of_its_own():
    further = {"blink": lambda content: content["times"]}
    assert messages.parse_text('{"type": "blink", "times": 2}', further) == 2
    with pytest.raises(MistakeError, match="there are: take, release, let_go, set, blink"):
        messages.parse_text('{"type": "nod"}', further)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x01",
        struct.pack("<BBHfd", 2, 0, 0, 0.5, 0.0),
        struct.pack("<BBHfd", 1, 0, 0, math.nan, 0.0),
        struct.pack("<BBHfd", 1, 0, 0, math.inf, 0.0),
        struct.pack("<BBHfd", 1, 0, 0, 0.5, math.nan),
        struct.pack("<BBHfd", 1, 0, 0, 0.5, 0.0) * 2,
    ],
)
def test_a_malformed_binary_is_refused(data: bytes):
    with pytest.raises(MistakeError):
        messages.parse_binary(data)


@settings(max_examples=50)
@given(st.one_of(st.text(), st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps)))
def test_any_text_is_understood_or_refused(text: str):
    with contextlib.suppress(PeerError):
        messages.parse_text(text)


@given(st.binary(max_size=40))
def test_any_bytes_are_understood_or_refused(data: bytes):
    with contextlib.suppress(PeerError):
        assert math.isfinite(messages.parse_binary(data).position_m)
