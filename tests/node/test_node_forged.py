"""What is forged costs a running session nothing: not a byte of what it says."""

import numpy as np
import pytest

from hapticnet.errors import PeerError
from hapticnet.protocol.messages import Close, Hello, pack_hello
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body, unpack
from tests.node.undisturbed import HERE, SESSION, Masters, Slaves

STRANGER = ("10.66.66.66", 6)
EDGES = (0, 1, 2, 127, 128, 3000, 2**16, 2**20 - 1, 2**20, 2**21, 2**31 - 1, 2**31, 2**32 - 1)
KINDS = (0, *Kind, 11)


class Forger:
    """Makes datagrams without a key, a cookie, or a place at the address of either end."""

    def __init__(self, ends, seed, *, sealed):
        self.ends, self.sealed = ends, sealed
        self.rng = np.random.default_rng([seed, 66])
        self.tricks = [self.invented, self.flipped, self.cut, self.garbage, self.hello, self.close, self.misaddressed]
        if isinstance(ends, Slaves):
            self.tricks.append(self.replayed)

    def any(self, values):
        return values[int(self.rng.integers(len(values)))]

    def __call__(self):
        """Return a forged datagram and the address that it seems to come from."""
        return self.any(self.tricks)()

    def true(self):
        """Return what the other end could send next."""
        if isinstance(self.ends, Slaves):
            return self.ends.pack(Kind.POSITION, (self.ends.now_us, None, bytes(4)))
        return self.ends.pack(Kind.FORCE, (self.ends.now_us, bytes(4)))

    def sequence(self):
        return self.any((*EDGES, self.ends.sequence, self.ends.sequence + 1, self.ends.sequence + 2))

    def place(self):
        """Return an address: under a seal it proves nothing, in an open session it is all there is."""
        return self.any((HERE, STRANGER)) if self.sealed else STRANGER

    def invented(self):
        body = self.any(
            (b"", bytes(16), self.rng.bytes(40), pack_body((1, None, bytes(4))), pack_body(Close("forged")))
        )
        version = SEALED if self.sealed else self.any((OPEN, SEALED))
        return pack(self.any(KINDS), SESSION, self.sequence(), body, version), self.place()

    def flipped(self):
        data = bytearray(self.true())
        at = int(self.rng.integers(len(data))) if self.sealed else int(self.rng.integers(4, 8))
        data[at] ^= 1 << int(self.rng.integers(8))
        return bytes(data), self.place() if self.sealed else HERE

    def cut(self):
        data = self.true()
        return data[: int(self.rng.integers(len(data)))], self.any((HERE, STRANGER))

    def garbage(self):
        return self.rng.bytes(int(self.rng.integers(0, 1300))), self.any((HERE, STRANGER))

    def hello(self):
        hello = Hello(int(self.rng.integers(2**32)), self.any((b"", bytes(16))), self.rng.bytes(100), bytes(16))
        return pack_hello(hello, self.any(EDGES), self.any((OPEN, SEALED, 3))), self.any((HERE, STRANGER))

    def replayed(self):
        """Return a HELLO that the master sent, as if it came from there again."""
        return self.any(self.ends.masters[0].said), HERE

    def close(self):
        session = SESSION ^ (1 << int(self.rng.integers(32)))
        return pack(Kind.CLOSE, session, self.sequence(), pack_body(Close("forged")), self.any((OPEN, SEALED))), HERE

    def misaddressed(self):
        """Return a message of the wrong version, session or kind, or a right one from a stranger's address."""
        if not self.sealed and self.rng.random() < 0.5:
            return self.true(), STRANGER
        frame = unpack(self.true())
        changed = self.any(({"version": 3 - frame.version}, {"session": SESSION - 1}, {"kind": self.any(UNANSWERED)}))
        frame = frame._replace(**changed)
        return pack(frame.kind, frame.session, frame.sequence, frame.body, frame.version), self.any((HERE, STRANGER))


UNANSWERED = (Kind.WELCOME, Kind.REFUSE, Kind.COOKIE)
"""Kinds that neither end of a session takes from the other."""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("line", [False, True], ids=["each", "line"])
def test_a_slave_serves_its_sessions_as_if_nothing_had_been_forged(line, sealed, seed):
    ends = Slaves(sealed=sealed, line=line)
    forger = Forger(ends, seed, sealed=sealed)
    for number in range(600):
        data, address = forger()
        ends.disturb(data, address)
        if number % 5 == 0:
            ends.step()
    (context, *_), (other, *_) = (slave.contexts for slave in ends.slaves)
    assert ends.disturbed.session_count == 1
    assert context.address == other.address == HERE


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("line", [False, True], ids=["each", "line"])
def test_a_master_goes_on_as_if_nothing_had_been_forged(line, sealed, seed):
    ends = Masters(sealed=sealed, line=line)
    forger = Forger(ends, seed, sealed=sealed)
    for number in range(600):
        data, address = forger()
        # A master hears its slave's address only: the socket sees to that.
        if sealed or address == HERE or not is_of_session(data):
            assert not ends.disturb(data), data
        if number % 5 == 0:
            ends.step()


def is_of_session(data):
    try:
        return unpack(data).session == SESSION
    except PeerError:
        return False


def test_what_is_replayed_from_under_an_earlier_key_costs_nothing(monkeypatch):
    monkeypatch.setattr("hapticnet.protocol.seal.EPOCH_BITS", 6)
    ends = Slaves(sealed=True)
    for _ in range(60):
        ends.step()
    for data in ends.said[60:]:
        for address in (HERE, STRANGER):
            assert ends.disturb(data, address) == []
    ends.step()
