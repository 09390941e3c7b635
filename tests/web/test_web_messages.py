"""The messages between page and server."""

import contextlib
import json
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet.web import messages
from hapticnet.web.messages import MistakeError


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
