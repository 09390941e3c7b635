"""Sealing and opening in compiled functions: the bytes of `Seal`, what is refused, and how a row follows its seal."""

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.compiled import compiled, fast_extra_installed
from hapticnet.protocol import libcrypto, seal_steps
from hapticnet.protocol.seal import EPOCH_BITS, Seal
from hapticnet.protocol.seal_steps import COLUMNS, FOR_SEAL, REFUSED, SEALS, SENT, RowSeal, open_body, seal_body, tell
from hapticnet.protocol.wire import SEALED, Kind, unpack

ONE = bytes(range(32))
OTHER = bytes(range(32, 64))
SESSION = 0xDEADBEEF
EPOCH = 1 << EPOCH_BITS

kinds = st.sampled_from(Kind)
uint32 = st.integers(0, 2**32 - 1)
in_epoch = st.integers(0, EPOCH - 1)
bodies = st.binary(max_size=300)
places = st.integers(0, 5)


@pytest.fixture(autouse=True, scope="module")
def libraries(tool_is_missing):
    if libcrypto.version() is None:
        tool_is_missing("libcrypto of OpenSSL 3")


@pytest.fixture(params=["python", "compiled"], scope="module")
def steps(request, tool_is_missing):
    """`open_body` and `seal_body`, as Python runs them and as machine code."""
    if request.param == "python":
        return open_body, seal_body
    if not fast_extra_installed():
        tool_is_missing("numba")
    return compiled(open_body), compiled(seal_body)


class End:
    """One end of a session with a row."""

    def __init__(self, steps, send_key, receive_key):
        self.open_body, self.seal_body = steps
        self.seal = Seal(send_key, receive_key)
        self.row = np.full(COLUMNS, 77)
        self.keeper = RowSeal(self.seal, self.row)

    def pack(self, kind, session, sequence, body, *, before=0):
        """Return a datagram sealed behind `before` other bytes, or what stands in its place."""
        head = b"\x95" + b"".join(map(msgpack.packb, (SEALED, int(kind), session, sequence)))
        out = np.full(before + 1300, 0xEE, np.uint8)
        out[before : before + len(head)] = np.frombuffer(head, np.uint8)
        given = np.frombuffer(b"\x01" + body, np.uint8).copy()
        end = self.seal_body(self.row, out, before, before + len(head), given, 1, len(body), sequence)
        if end < 0:
            return end
        assert (out[:before] == 0xEE).all()
        assert (out[end:] == 0xEE).all()
        return out[before:end].tobytes()

    def open(self, data, *, before=0, after=0):
        """Return what is in a datagram that stands between other bytes, or what stands in its place."""
        frame = unpack(data)
        received = np.frombuffer(bytes(before) + data + bytes(after), np.uint8).copy()
        out = np.full(before + 1300, 0xEE, np.uint8)
        state = self.row[:5].copy()
        body_start, length = before + len(data) - len(frame.body), len(frame.body)
        opened = self.open_body(self.row, received, before, body_start, length, frame.sequence, out, before)
        assert (self.row[:5] == state).all()
        assert received.tobytes() == bytes(before) + data + bytes(after)
        assert (out[:before] == 0xEE).all()
        assert (out[before + max(0, length - 16) :] == 0xEE).all()
        if opened >= 0:
            return out[before : before + opened].tobytes()
        if opened == REFUSED:
            assert not out[before : before + max(0, length - 16)].any()
        return opened


@pytest.fixture
def ends(steps):
    both = End(steps, ONE, OTHER), End(steps, OTHER, ONE)
    yield both
    for end in both:
        end.keeper.release(end.row)


@pytest.fixture(scope="module")
def lasting(steps):
    """Both ends, for tests with many examples; only rows are renewed."""
    return End(steps, ONE, OTHER), End(steps, OTHER, ONE)


def renewed(lasting):
    for end in lasting:
        end.seal = Seal(*(ONE, OTHER) if end is lasting[0] else (OTHER, ONE))
        end.row[:] = 0
        end.keeper.load(end.seal, end.row)
    return lasting


@given(kind=kinds, session=uint32, sequence=in_epoch, body=bodies, before=places, after=places)
def test_a_row_seals_and_opens_the_bytes_of_a_seal(lasting, kind, session, sequence, body, before, after):
    master, slave = renewed(lasting)
    data = Seal(ONE, OTHER).pack(kind, session, sequence, body)
    assert master.pack(kind, session, sequence, body, before=before) == data
    assert slave.open(data, before=before, after=after) == body
    assert slave.seal.open(data, unpack(data)) == body


@pytest.mark.parametrize("length", [0, 1, 15, 16, 17, 63, 64, 65, 127, 128, 239, 240, 241, 700, 1160])
def test_every_length_is_sealed_and_opened(ends, length):
    master, slave = ends
    body = np.random.default_rng(length).bytes(length)
    data = master.pack(Kind.FORCE, SESSION, 70_000, body)
    assert data == Seal(ONE, OTHER).pack(Kind.FORCE, SESSION, 70_000, body)
    assert slave.open(data) == body


def test_a_body_is_sealed_where_it_stands(ends, steps):
    master, _ = ends
    expected = Seal(ONE, OTHER).pack(Kind.FORCE, SESSION, 70_000, bytes(range(24)))
    out = np.zeros(100, np.uint8)
    head = len(expected) - 42
    out[:head] = np.frombuffer(expected[:head], np.uint8)
    out[head + 2 : head + 26] = range(24)
    assert steps[1](master.row, out, 0, head, out, head + 2, 24, 70_000) == len(expected)
    assert out[: len(expected)].tobytes() == expected


@pytest.mark.parametrize("length", [0, 20, 240])
def test_every_flipped_bit_is_refused(ends, length):
    master, slave = ends
    data = master.pack(Kind.POSITION, SESSION, 70_000, bytes([7] * length))
    received = np.frombuffer(data, np.uint8).copy()
    out = np.zeros(length, np.uint8)
    body_start = len(data) - length - 16

    def opened():
        return slave.open_body(slave.row, received, 0, body_start, length + 16, 70_000, out, 0)

    # Without the head of the byte string, whose shape `unpack` checks.
    for bit in [*range(8 * (body_start - 2 - (length == 240))), *range(8 * body_start, 8 * len(data))]:
        received[bit // 8] ^= 1 << bit % 8
        out[:] = 7
        assert opened() == REFUSED, f"bit {bit}"
        assert not out.any()
        received[bit // 8] ^= 1 << bit % 8
    assert opened() == length


@given(body=st.binary(max_size=60), sequence=in_epoch, other=in_epoch, cut=st.integers(1, 76))
def test_what_was_not_sealed_so_is_refused(lasting, body, sequence, other, cut):
    master, slave = renewed(lasting)
    data = master.pack(Kind.FORCE, SESSION, sequence, body)
    sealed = unpack(data).body
    assert master.open(data) == REFUSED  # sent back to its sender
    head = data[: -2 - len(sealed)]
    if cut <= len(sealed):
        assert slave.open(head + msgpack.packb(sealed[:-cut])) == REFUSED
    assert slave.open(head + b"\xc5" + len(sealed).to_bytes(2, "big") + sealed) == REFUSED
    assert slave.open(b"\xdc\x00\x05" + data[1:]) == REFUSED
    if other != sequence:
        assert slave.open(msgpack.packb([SEALED, int(Kind.FORCE), SESSION, other, sealed])) == REFUSED
    assert slave.open(msgpack.packb([SEALED, int(Kind.FORCE), SESSION - 1, sequence, sealed])) == REFUSED
    assert slave.open(data) == body


def test_what_would_reach_outside_a_buffer_is_refused(ends, steps):
    """Machine code has no other bounds."""
    master, slave = ends
    opens, seals = steps
    data = np.frombuffer(master.pack(Kind.FORCE, SESSION, 9, bytes(20)), np.uint8).copy()
    body_start, out = len(data) - 36, np.zeros(20, np.uint8)
    for start, body, length, out_start in [
        (-1, body_start, 36, 0),
        (0, body_start + 1, 36, 0),
        (0, body_start, 37, 0),
        (0, body_start, 36, 1),
        (0, body_start, 36, -1),
        (0, body_start, 15, 0),
        (body_start - 1, body_start, 36, 0),
    ]:
        assert opens(slave.row, data, start, body, length, 9, out, out_start) == REFUSED
    assert opens(slave.row, data, 0, body_start, 36, 9, out, 0) == 20
    out = np.zeros(48, np.uint8)
    body = np.zeros(20, np.uint8)
    for start, head_end, body_start, length in [
        (-1, 10, 0, 20),
        (11, 10, 0, 20),
        (0, 11, 0, 20),
        (0, 10, 1, 20),
        (0, 10, -1, 20),
        (0, 10, 0, -1),
        (0, 10, 0, 21),
    ]:
        assert seals(master.row, out, start, head_end, body, body_start, length, 10) == REFUSED
    assert not out.any()
    assert seals(master.row, out, 0, 10, body, 0, 20, 10) == 48


def test_a_number_is_sealed_once_by_the_row_and_its_seal_together(ends):
    master, _ = ends
    assert len(master.pack(Kind.FORCE, SESSION, 5, b"")) > 0
    assert master.pack(Kind.FORCE, SESSION, 5, b"") == REFUSED
    assert master.pack(Kind.FORCE, SESSION, 4, b"") == REFUSED
    tell(master.seal, master.row)
    with pytest.raises(ValueError, match="after 5"):
        master.seal.pack(Kind.FORCE, SESSION, 5, b"")
    master.seal.pack(Kind.FORCE, SESSION, 9, b"")
    master.keeper.load(master.seal, master.row)
    assert master.pack(Kind.FORCE, SESSION, 9, b"") == REFUSED
    assert len(master.pack(Kind.FORCE, SESSION, 10, b"")) > 0


def test_loading_a_row_forgets_nothing_that_it_sealed(ends):
    master, _ = ends
    master.pack(Kind.FORCE, SESSION, 5, b"")
    master.keeper.load(master.seal, master.row)
    assert master.pack(Kind.FORCE, SESSION, 5, b"") == REFUSED
    assert master.seal.sent == 5


@pytest.mark.parametrize(("noted", "sequence"), [(5, 4), (5, -1), (5, EPOCH), (-1, EPOCH), (-1, -2)])
def test_a_seal_notes_only_what_its_key_can_have_sealed(noted, sequence):
    seal = Seal(ONE, OTHER)
    seal.note_sealed(noted)
    with pytest.raises(ValueError, match=f"sequence number {sequence} after {noted}; it must be higher"):
        seal.note_sealed(sequence)
    assert seal.sent == noted


def test_other_epochs_are_for_the_seal_and_the_row_follows_it(ends):
    master, slave = ends
    late = master.pack(Kind.POSITION, SESSION, EPOCH - 2, b"late")
    for epoch in (1, 2, 3):
        sequence = epoch * EPOCH
        assert master.pack(Kind.POSITION, SESSION, sequence, b"first") == FOR_SEAL
        tell(master.seal, master.row)
        first = master.seal.pack(Kind.POSITION, SESSION, sequence, b"first")
        master.keeper.load(master.seal, master.row)
        assert slave.open(first) == FOR_SEAL
        assert slave.seal.open(first, unpack(first)) == b"first"
        slave.keeper.load(slave.seal, slave.row)
        assert slave.open(first) == b"first"
        assert slave.open(late) == FOR_SEAL
        assert slave.seal.open(late, unpack(late)) == b"late"
        second = master.pack(Kind.POSITION, SESSION, sequence + 1, b"second")
        assert slave.seal.open(second, unpack(second)) == slave.open(second) == b"second"
        late = master.pack(Kind.POSITION, SESSION, sequence + 2, b"late")
        answer = slave.pack(Kind.FORCE, SESSION, epoch, b"answer")  # the other direction keeps its key
        assert master.open(answer) == b"answer"


def test_a_row_of_zeros_leaves_everything_to_the_seal(ends):
    master, slave = ends
    data = master.pack(Kind.FORCE, SESSION, 5, b"")
    for end in ends:
        end.keeper.release(end.row)
        assert not end.row.any()
    assert slave.open(data) == FOR_SEAL
    assert master.pack(Kind.FORCE, SESSION, 6, b"") == FOR_SEAL


def test_columns_do_not_overlap():
    assert seal_steps.NONCE + 2 == seal_steps.WRITTEN == COLUMNS - 1
    assert SEALS < SENT < seal_steps.NONCE
