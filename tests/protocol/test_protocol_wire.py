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
from hapticnet.node.offline import force_datagram_bytes
from hapticnet.protocol import messages
from hapticnet.protocol.wire import (
    MAX_DATAGRAM_BYTES,
    MAX_ELEMENTS,
    OPEN,
    SEALED,
    Kind,
    pack,
    pack_body,
    unpack,
    unpack_nonce,
)
from tests.peers import GRANT, REQUEST
from tests.vectors import make_protocol

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "protocol.json").read_text())
READERS = {
    Kind.HELLO: messages.unpack_hello,
    Kind.WELCOME: messages.unpack_welcome,
    Kind.REFUSE: messages.unpack_refuse,
    Kind.POSITION: messages.unpack_position,
    Kind.FORCE: messages.unpack_force,
    Kind.KEEPALIVE: messages.unpack_keepalive,
    Kind.CLOSE: messages.unpack_close,
    Kind.COOKIE: messages.unpack_cookie,
    Kind.NOTICE: messages.unpack_notice,
    Kind.VIBRATION: messages.unpack_vibration,
}
CONTENTS = {Kind.HELLO: messages.unpack_request, Kind.WELCOME: messages.unpack_grant}
ANY_READER = (unpack, *READERS.values(), *CONTENTS.values(), messages.unpack_grant_or_refusal)
MAY_BE_MISSING = {Kind.POSITION: (10, 80, 5)} | dict.fromkeys(
    (Kind.FORCE, Kind.KEEPALIVE, Kind.VIBRATION, Kind.NOTICE), (b"",)
)
LATER = 6
"""A version that does not exist."""


def raw(values):
    """Return values as the datagram holds them, of values as the file does."""
    return tuple(map(raw_value, values))


def raw_value(value):
    if isinstance(value, dict):
        return bytes.fromhex(value["hex"]) if "hex" in value else {key: raw_value(each) for key, each in value.items()}
    return raw(value) if isinstance(value, list) else value


def test_the_document_lists_every_kind_and_code():
    document = (Path(__file__).parents[2] / "docs" / "refer" / "protocol.md").read_text()
    rows = re.findall(r"^\| (\d+) \| ([A-Z]+) \|", document, flags=re.MULTILINE)
    assert [(int(number), name) for number, name in rows] == [(kind.value, kind.name) for kind in Kind]
    codes = re.findall(
        r"^\| (\d+) \| [a-z]", document.partition("| code | meaning |")[2].partition("\n\n")[0], re.MULTILINE
    )
    assert [int(code) for code in codes] == [code.value for code in messages.Code]


def test_the_vectors_are_what_the_script_writes_and_show_every_kind():
    assert make_protocol.document() == VECTORS
    assert VECTORS["protocol_version"] == OPEN
    assert {vector["kind"] for vector in VECTORS["datagrams"]} == {kind.name for kind in Kind}


@pytest.mark.parametrize("vector", VECTORS["datagrams"], ids=lambda vector: vector["name"])
def test_golden_datagrams_are_read_and_written_to_the_byte(vector):
    data, kind, fields = bytes.fromhex(vector["hex"]), Kind[vector["kind"]], raw(vector["fields"])
    datagram = unpack(data)
    assert (datagram.kind, datagram.session, datagram.sequence) == (kind, vector["session"], vector["sequence"])
    if kind is Kind.RESET:
        assert datagram.body == b""
        return
    message = READERS[kind](datagram.body)
    if kind is Kind.POSITION:
        wait = (message.waited_ms,) if message.waited_ms else ()
        assert (*message[:3], *(round(100 * share) for share in message.loss or ()), *wait) == fields
        assert messages.pack_position(message) == datagram.body
        return
    if kind is Kind.NOTICE:
        assert messages.pack_contents(message) == pack_body(fields)
        assert pack(kind, datagram.session, datagram.sequence, pack_body(fields)) == data
        return
    if kind in (Kind.FORCE, Kind.KEEPALIVE, Kind.VIBRATION):
        assert (message if len(fields) == 3 else message[:2]) == fields
        assert messages.pack_answer(message) == datagram.body
        return
    assert message == fields
    if kind in CONTENTS:
        contents = CONTENTS[kind](message[-1] if kind is Kind.WELCOME else message.request)
        assert contents == type(contents)(*raw(vector["contents"]))  # what is left out asks for nothing
        assert messages.pack_contents(contents) in fields
    if kind is Kind.HELLO:
        assert messages.pack_hello(message, datagram.sequence) == data
    else:
        assert pack(kind, datagram.session, datagram.sequence, pack_body(message)) == data


@given(st.binary(max_size=200))
def test_garbage_is_a_peer_error_in_every_reader(data):
    for read in ANY_READER:
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
                message = READERS[datagram.kind](datagram.body)
                if datagram.kind in CONTENTS:
                    CONTENTS[datagram.kind](message[2 if datagram.kind is Kind.HELLO else 1])
        except PeerError:
            continue


def test_an_oversized_datagram_is_refused_unread():
    with pytest.raises(PeerError, match="at most 1200"):
        unpack(bytes(MAX_DATAGRAM_BYTES + 1))


@pytest.mark.parametrize(
    ("datagram", "complaint"),
    [
        ((OPEN, 0, 0, 0, b""), "unknown kind"),
        ((OPEN, 12, 0, 0, b""), "unknown kind"),
        ((LATER, Kind.FORCE, 0, 0, b""), "protocol version 6; the versions are 1 and 2"),
        ((LATER, Kind.COOKIE, 0, 0, b""), "protocol version 6"),
        ((True, Kind.HELLO, 0, 0, b""), "protocol version True"),
        ((OPEN, Kind.FORCE, -1, 0, b""), "wrong types"),
        ((OPEN, Kind.FORCE, 0, 1 << 32, b""), "wrong types"),
        ((OPEN, Kind.FORCE, 0, 0, "text"), "wrong types"),
        ((OPEN, True, 0, 0, b""), "wrong types"),
        ((OPEN, Kind.FORCE, 0, 0), "4 elements"),
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
    if kind in MAY_BE_MISSING:
        least = 3 if kind is Kind.POSITION else 2
        fields = (*fields[:least], *MAY_BE_MISSING[kind])
        body = pack_body(fields)
    else:
        least = len(fields)
    assert READERS[kind](pack_body((*fields, "later", 5))) == READERS[kind](body)
    with pytest.raises(PeerError, match=f"body of {least - 1} fields; expected at least {least}"):
        READERS[kind](pack_body(fields[: least - 1]))


@pytest.mark.parametrize("loss", [(101, 0), (0, -1), (0.5, 0), ("later", 5), (True, 0)])
def test_a_loss_that_is_not_in_per_cent_is_refused(loss):
    with pytest.raises(PeerError, match="loss in per cent"):
        messages.unpack_position(pack_body((1000, None, b"", *loss)))


@pytest.mark.parametrize("vector", [v for v in VECTORS["datagrams"] if "contents" in v], ids=lambda v: v["name"])
def test_requests_and_grants_can_be_appended_to_and_not_shortened(vector):
    read, contents = CONTENTS[Kind[vector["kind"]]], raw(vector["contents"])
    whole = read(pack_body(contents))
    assert read(pack_body((*whole, "later", 5)[:MAX_ELEMENTS])) == whole
    with pytest.raises(PeerError, match="expected at least"):
        read(pack_body(whole[: 7 if vector["kind"] == "WELCOME" else 11]))


def test_a_code_that_is_not_known_reads_as_other():
    assert messages.unpack_refuse(pack_body((1, "reason", 77))).code is messages.Code.OTHER
    with pytest.raises(PeerError, match="code"):
        messages.unpack_close(pack_body(("reason", "text")))


def test_printable_is_every_category_but_other_and_separator_with_the_space():
    for number in range(0x110000):
        character = chr(number)
        assert character.isprintable() == (character == " " or unicodedata.category(character)[0] not in "CZ")


def test_hello_and_refuse_of_another_version_can_be_read_far_enough_to_answer():
    hello = unpack(pack_body((LATER, Kind.HELLO, 0, 0, pack_body((77, "what comes after is unknown")))))
    assert hello.version == LATER
    assert unpack_nonce(hello.body) == 77


@pytest.mark.parametrize("body", [(-1, b"", b"", b"", b""), (1, "", b"", b"", b""), (1, b"", b"", None, b""), (1, b"")])
def test_hello_fields_that_cannot_be_are_refused(body):
    with pytest.raises(PeerError):
        messages.unpack_hello(pack_body(body))


@pytest.mark.parametrize("body", [(-1, bytes(16)), (1, bytes(15)), (1, bytes(17)), (1, "sixteen letters.")])
def test_cookies_that_cannot_be_are_refused(body):
    with pytest.raises(PeerError):
        messages.unpack_cookie(pack_body(body))


def test_what_a_sealed_welcome_carries_is_a_grant_or_a_refusal():
    refusal = messages.Refusal(0, "no", messages.Code.KEY)
    assert messages.unpack_grant_or_refusal(pack_body(GRANT)) == GRANT
    assert messages.unpack_grant_or_refusal(pack_body(refusal)) == refusal
    for broken in ((0, "bell\a", 7), (0, "no", -1), (0,), (-1, "no", 7)):
        with pytest.raises(PeerError):
            messages.unpack_grant_or_refusal(pack_body(broken))


@pytest.mark.parametrize("text", ["a" * 257, "bell\a", "\x1b[31mred", "\u202eright to left"])
def test_text_that_is_too_long_or_would_speak_to_a_terminal_is_refused(text):
    other = messages.Code.OTHER
    for read, message in (
        *((messages.unpack_request, REQUEST._replace(**{field: text})) for field in ("name", "codec")),
        (messages.unpack_request, REQUEST._replace(parameters={text: 1.0})),
        (messages.unpack_grant, GRANT._replace(scene=text)),
        (messages.unpack_grant_or_refusal, messages.Refusal(0, text, other)),
        (messages.unpack_refuse, messages.Refuse(1, text, other)),
        (messages.unpack_close, messages.Close(text, other)),
        (messages.unpack_notice, messages.Notice(text, other)),
    ):
        with pytest.raises(PeerError, match="not what the protocol allows"):
            read(pack_body(message))


@pytest.mark.parametrize("version", [OPEN, SEALED])
@given(st.binary(max_size=200), st.binary(max_size=16))
def test_a_hello_is_never_smaller_than_what_the_padding_promises(version, request, cookie):
    data = messages.pack_hello(messages.Hello(1, cookie, request), 7, version)
    assert messages.HELLO_BYTES <= len(data) <= messages.HELLO_BYTES + 5
    assert messages.unpack_hello(unpack(data).body) == (1, cookie, request, b"")


@given(
    st.integers(0, (1 << 32) - 1),
    st.integers(0, (1 << 32) - 1),
    st.binary(max_size=24),
    st.integers(1 << 16, (1 << 32) - 1),
)
def test_the_size_of_a_force_datagram_is_known_without_packing_it(sequence, t_us, payload, session):
    packed = pack(Kind.FORCE, session, sequence, messages.pack_answer(messages.Force(t_us, payload)))
    size = force_datagram_bytes(np.array([sequence]), np.array([t_us]), np.array([len(payload)]))
    assert size.tolist() == [len(packed)]


def test_clipped_text_fits_and_stays_valid_utf8():
    assert messages.clipped("ä" * 10, 5) == "ää"
    assert messages.clipped("a\nb\x1b", 9) == "a?b?"
