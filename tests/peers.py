"""Ends of a session made by hand: a slave for a master under test, a master for a slave under test; open or sealed."""

import numpy as np

from hapticnet.protocol.handshake import Attempt, Door, SealedAttempt, SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.messages import (
    Cookie,
    Grant,
    Position,
    Refusal,
    Refuse,
    Request,
    Welcome,
    unpack_cookie,
    unpack_hello,
    unpack_refuse,
    unpack_welcome,
)
from hapticnet.protocol.states import ForceArrived
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body, unpack
from hapticnet.samples import PositionSample

SESSION = 0xABCDEF01
TICKET = b"sixteen bytes ok"
COOKIE = b"cookie of a hand"
REQUEST = Request("deadband", {}, 0.05, 0.025, 1.0, 1000.0, 1, "test")
GRANT = Grant(SESSION, 1000.0, 45_000, "scene", TICKET, False)

MASTER, OTHER_MASTER, SLAVE = (PrivateKey(bytes(range(first, first + 32))) for first in (1, 33, 65))
PSK = bytes(range(97, 129))
ENTRY = MasterEntry(name="surgeon", public=MASTER.public)
OTHER_ENTRY = MasterEntry(name="student", public=OTHER_MASTER.public)
KEY = MasterKey(MASTER, SLAVE.public)
OTHER_KEY = MasterKey(OTHER_MASTER, SLAVE.public)


class Still:
    """An operator at a place that only the test moves."""

    axes, duration_us = 1, None

    def __init__(self, place_m=0.025):
        self.place_m = place_m

    def sample(self, t_us):
        return PositionSample(t_us, (self.place_m,))


def events_of(end):
    """Return the events of a session or node since the last call."""
    return list(iter(end.next_event, None))


def apply_forces(session):
    """Do what a node does with the forces of a MasterSession; return all events."""
    events = events_of(session)
    for event in events:
        if isinstance(event, ForceArrived):
            session.applied(event)
    return events


class HandSlave:
    """The slave's end, for a `MasterSession` or `MasterNode`. It answers what it is told to."""

    def __init__(self, master, *, sealed=False, entry=ENTRY):
        self.master = master
        self.version = SEALED if sealed else OPEN
        self.seal = None
        self.session = 0
        self.request = None
        rng = np.random.default_rng(77)
        self._door = SealedDoor(SLAVE.private, Roster([entry]), rng) if sealed else Door()

    def said(self):
        """Return what the master has sent since the last call, opened."""
        return [self._opened(data) for data in self.master.datagrams_to_send()]

    def hello(self):
        """Return the HELLO that the master sends now, and nothing else."""
        (datagram,) = self.said()
        assert datagram.kind is Kind.HELLO
        return datagram

    def cookie(self, hello, now_us, cookie=COOKIE):
        """Answer a HELLO with a COOKIE."""
        body = pack_body(Cookie(unpack_hello(hello.body).nonce, cookie))
        self.master.receive_datagram(pack(Kind.COOKIE, 0, 0, body, self.version), now_us)

    def welcome(self, hello, now_us, grant=GRANT, first_sequence=0):
        """Answer a HELLO with a WELCOME that carries a grant or, sealed, a refusal."""
        read = unpack_hello(hello.body)
        visitor = self._door.read(read, hello.sequence)
        self.request = visitor.request
        answer, seal = visitor.answer(grant)
        body = pack_body(Welcome(read.nonce, answer))
        if isinstance(grant, Grant):
            self.session, self.seal = grant.session, seal
        self.master.receive_datagram(pack(Kind.WELCOME, grant.session, first_sequence, body, self.version), now_us)

    def refuse(self, hello, now_us, reason, code):
        """Answer a HELLO with a refusal that the master must believe."""
        if self.version == SEALED:
            self.welcome(hello, now_us, Refusal(0, reason, code))
        else:
            self.hint(hello, now_us, reason, code)

    def hint(self, hello, now_us, reason, code):
        """Answer a HELLO with a REFUSE, which has no seal in any version."""
        body = pack_body(Refuse(unpack_hello(hello.body).nonce, reason, code))
        self.master.receive_datagram(pack(Kind.REFUSE, 0, 0, body, self.version), now_us)

    def connect(self, now_us=0, grant=GRANT, first_sequence=0):
        """Let the master ask, and grant a session through a cookie; return self."""
        self.master.tick(now_us)
        self.cookie(self.hello(), now_us)
        again = self.hello()
        assert unpack_hello(again.body).cookie == COOKIE
        self.welcome(again, now_us, grant, first_sequence)
        return self

    def say(self, kind, sequence, message, now_us):
        """Send a datagram of the session. Numbers may come in any order."""
        body = pack_body(message)
        if self.seal is None:
            data = pack(kind, self.session, sequence, body)
        else:
            self.seal._sent = -1
            data = self.seal.pack(kind, self.session, sequence, body)
        self.master.receive_datagram(data, now_us)
        return data

    def reset(self, sequence, now_us):
        """Send a RESET, which has no seal in any version."""
        self.master.receive_datagram(pack(Kind.RESET, self.session, sequence, b"", self.version), now_us)

    def _opened(self, data):
        datagram = unpack(data)
        if self.seal is None or datagram.kind is Kind.HELLO:
            return datagram
        return datagram._replace(body=self.seal.open(data, datagram))


class HandMaster:
    """The master's end, for a `SlaveNode`. Each `nonce` is another attempt to get a session."""

    def __init__(self, slave, address="a", *, sealed=False, nonce=1, key=KEY, first_sequence=0, **request):
        self.slave = slave
        self.address = address
        self.version = SEALED if sealed else OPEN
        asked = REQUEST._replace(**request)
        rng = np.random.default_rng(nonce)
        self.attempt = (
            SealedAttempt(asked, nonce, first_sequence, key, rng) if sealed else Attempt(asked, nonce, first_sequence)
        )
        self.cookie = b""
        self.grant = self.refusal = self.seal = None
        self.said = []  # datagrams as they were sent

    @property
    def session(self):
        return self.grant.session if self.grant else 0

    def hello(self, now_us=0):
        """Send the HELLO; return the answers. A cookie, grant or refusal in them is kept."""
        return self.send(self.attempt.hello(self.cookie), now_us)

    def join(self, now_us=0):
        """Get a session; return self."""
        answers = self.hello(now_us) + self.hello(now_us)
        assert [answer.kind for answer in answers] == [Kind.COOKIE, Kind.WELCOME]
        assert self.grant
        return self

    def refused(self, now_us=0):
        """Ask for a session and return the refusal."""
        self.hello(now_us)
        self.hello(now_us)
        assert self.grant is None
        return self.refusal

    def position(self, sequence, now_us, position_m=0.0, *, ack=None, t_us=None, payload=None):
        """Send a POSITION; return the answers."""
        t_us = now_us if t_us is None else t_us
        payload = np.array(position_m, ">f4").tobytes() if payload is None else payload
        return self.say(Kind.POSITION, sequence, Position(t_us & 0xFFFF_FFFF, ack, payload)[:3], now_us)

    def work(self, now_us=0):
        """Join and send one position; return self."""
        self.join(now_us).position(1, now_us)
        return self

    def say(self, kind, sequence, message, now_us):
        """Send a datagram of the session; return the answers. Numbers may come in any order."""
        return self.send(self.pack(kind, sequence, message), now_us)

    def pack(self, kind, sequence, message):
        """Return a datagram of the session."""
        body = pack_body(message)
        if self.seal is None:
            return pack(kind, self.session, sequence, body)
        self.seal._sent = -1
        return self.seal.pack(kind, self.session, sequence, body)

    def send(self, data, now_us, address=None):
        """Send a datagram, from another `address` if one is given; return the answers to it."""
        self.said.append(data)
        self.slave.receive_datagram(data, self.address if address is None else address, now_us)
        return self.answers(address)

    def answers(self, address=None):
        """Return what the slave has to send to this master, opened."""
        address = self.address if address is None else address
        return [self._read(data) for data, to in self.slave.datagrams_to_send() if to == address]

    def _read(self, data):
        datagram = unpack(data)
        if datagram.kind is Kind.COOKIE:
            cookie = unpack_cookie(datagram.body)
            if cookie.nonce == self.attempt.nonce:
                self.cookie = cookie.cookie
        elif datagram.kind is Kind.WELCOME:
            answer, seal = self.attempt.read(unpack_welcome(datagram.body).grant)
            if isinstance(answer, Grant):
                self.grant, self.seal = answer, seal
            else:
                self.refusal = answer
        elif datagram.kind is Kind.REFUSE:
            self.refusal = unpack_refuse(datagram.body)
        elif self.seal is not None and datagram.kind is not Kind.RESET:
            return datagram._replace(body=self.seal.open(data, datagram))
        return datagram
