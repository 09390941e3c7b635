"""Golden datagrams, and what becomes of everything that is not one."""

import json
import re
import unicodedata
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import PeerError
from hapticnet.protocol import messages
from hapticnet.protocol.wire import (
    MAX_DATAGRAM_BYTES,
    VERSION,
    Kind,
    force_datagram_bytes,
    pack,
    pack_body,
    unpack,
    unpack_nonce,
)

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "protocol.json").read_text())
READERS = {
    Kind.HELLO: messages.unpack_hello,
    Kind.WELCOME: messages.unpack_welcome,
    Kind.REFUSE: messages.unpack_refuse,
    Kind.POSITION: messages.unpack_position,
    Kind.FORCE: messages.unpack_force,
    Kind.KEEPALIVE: messages.unpack_keepalive,
    Kind.CLOSE: messages.unpack_close,
}


def fields_of(vector):
    return tuple(
        bytes.fromhex(field["hex"]) if isinstance(field, dict) and "hex" in field else field
        for field in vector["fields"]
    )


def test_the_document_lists_every_kind_and_code():
    document = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
    rows = re.findall(r"^\| (\d+) \| ([A-Z]+) \|", document, flags=re.MULTILINE)
    assert [(int(number), name) for number, name in rows] == [(kind.value, kind.name) for kind in Kind]
    codes = re.findall(
        r"^\| (\d+) \| [a-z]", document.partition("| code | meaning |")[2].partition("\n\n")[0], re.MULTILINE
    )
    assert [int(code) for code in codes] == [code.value for code in messages.Code]


def test_the_vectors_are_of_this_version_and_show_every_kind():
    assert VECTORS["protocol_version"] == VERSION
    assert {vector["kind"] for vector in VECTORS["datagrams"]} == {kind.name for kind in Kind}


@pytest.mark.parametrize("vector", VECTORS["datagrams"], ids=lambda vector: vector["name"])
def test_golden_datagrams_are_read_and_written_to_the_byte(vector):
    data, kind, fields = bytes.fromhex(vector["hex"]), Kind[vector["kind"]], fields_of(vector)
    datagram = unpack(data)
    assert (datagram.kind, datagram.session, datagram.sequence) == (kind, vector["session"], vector["sequence"])
    if kind is Kind.RESET:
        assert datagram.body == b""
        return
    message = READERS[kind](datagram.body)
    assert tuple(message) == fields
    if kind is Kind.HELLO:
        assert messages.pack_hello(message, datagram.sequence) == data
    else:
        assert pack(kind, datagram.session, datagram.sequence, pack_body(message)) == data


@given(st.binary(max_size=200))
def test_garbage_is_a_peer_error_in_every_reader(data):
    for read in (unpack, *READERS.values()):
        try:
            read(data)
        except PeerError:
            continue


@given(st.sampled_from(VECTORS["datagrams"]), st.integers(0, 420), st.integers(0, 255))
def test_golden_datagrams_with_a_changed_byte_or_a_missing_end_never_raise_anything_else(vector, place, byte):
    data = bytearray.fromhex(vector["hex"])
    cut = bytes(data[: place % len(data)])
    data[place % len(data)] = byte
    for broken in (bytes(data), cut):
        try:
            datagram = unpack(broken)
            if datagram.kind in READERS:
                READERS[datagram.kind](datagram.body)
        except PeerError:
            continue


def test_an_oversized_datagram_is_refused_unread():
    with pytest.raises(PeerError, match="at most 1200"):
        unpack(bytes(MAX_DATAGRAM_BYTES + 1))


@pytest.mark.parametrize(
    ("datagram", "complaint"),
    [
        ((VERSION, 9, 0, 0, b""), "unknown kind"),
        ((VERSION + 1, Kind.FORCE, 0, 0, b""), "protocol version 2"),
        ((VERSION, Kind.FORCE, -1, 0, b""), "wrong types"),
        ((VERSION, Kind.FORCE, 0, 1 << 32, b""), "wrong types"),
        ((VERSION, Kind.FORCE, 0, 0, "text"), "wrong types"),
        ((VERSION, True, 0, 0, b""), "wrong types"),
        ((VERSION, Kind.FORCE, 0, 0), "4 elements"),
    ],
)
def test_frames_that_cannot_be_are_refused(datagram, complaint):
    with pytest.raises(PeerError, match=complaint):
        unpack(pack_body(datagram))


@pytest.mark.parametrize("vector", [v for v in VECTORS["datagrams"] if v["kind"] != "RESET"], ids=lambda v: v["name"])
def test_fields_that_a_later_revision_appends_are_ignored_and_missing_ones_are_not(vector):
    kind = Kind[vector["kind"]]
    body = unpack(bytes.fromhex(vector["hex"])).body
    fields = msgpack.unpackb(body, use_list=False)
    assert READERS[kind](pack_body((*fields, "later", 5))) == READERS[kind](body)
    with pytest.raises(PeerError, match=f"body of {len(fields) - 1} fields; expected at least {len(fields)}"):
        READERS[kind](pack_body(fields[:-1]))


def test_a_code_that_is_not_known_reads_as_other():
    assert messages.unpack_refuse(pack_body((1, "reason", 77))).code is messages.Code.OTHER
    with pytest.raises(PeerError, match="code"):
        messages.unpack_close(pack_body(("reason", "text")))


def test_printable_is_every_category_but_other_and_separator_with_the_space():
    for number in range(0x110000):
        character = chr(number)
        assert character.isprintable() == (character == " " or unicodedata.category(character)[0] not in "CZ")


def test_hello_and_refuse_of_another_version_can_be_read_far_enough_to_answer():
    hello = unpack(pack_body((VERSION + 6, Kind.HELLO, 0, 0, pack_body((77, "what comes after is unknown")))))
    assert hello.version == VERSION + 6
    assert unpack_nonce(hello.body) == 77


@pytest.mark.parametrize("name", ["a" * 65, "bell\a", "\x1b[31mred"])
def test_text_that_is_too_long_or_would_speak_to_a_terminal_is_refused(name):
    good = messages.Hello(1, "raw", {}, 0.1, 0.0, 1.0, 1000.0, 1, "ok")
    assert messages.unpack_hello(pack_body((*good, b""))) == good
    with pytest.raises(PeerError, match="name"):
        messages.unpack_hello(pack_body((*good._replace(name=name), b"")))


@pytest.mark.parametrize(
    "change",
    [
        {"rate_hz": float("nan")},
        {"rate_hz": 0.0},
        {"axes": 4},
        {"axes": True},
        {"nonce": -1},
        {"weber_fraction": float("inf")},
        {"parameters": {"k": float("nan")}},
        {"parameters": []},
    ],
)
def test_hello_fields_that_cannot_be_are_refused(change):
    hello = messages.Hello(1, "raw", {}, 0.1, 0.0, 1.0, 1000.0, 1, "ok")._replace(**change)
    with pytest.raises(PeerError):
        messages.unpack_hello(pack_body((*hello, b"")))


@given(
    st.integers(0, (1 << 32) - 1),
    st.integers(0, (1 << 32) - 1),
    st.binary(max_size=24),
    st.integers(1 << 16, (1 << 32) - 1),
)
def test_the_size_of_a_force_datagram_is_known_without_packing_it(sequence, t_us, payload, session):
    packed = pack(Kind.FORCE, session, sequence, pack_body(messages.Force(t_us, payload)))
    size = force_datagram_bytes(np.array([sequence]), np.array([t_us]), np.array([len(payload)]))
    assert size.tolist() == [len(packed)]


def test_clipped_text_fits_and_stays_valid_utf8():
    assert messages.clipped("ä" * 10, 5) == "ää"
    assert messages.clipped("a\nb\x1b", 9) == "a?b?"
