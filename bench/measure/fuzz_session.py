"""A true session in virtual time, and hostile datagrams against one of its ends."""

import math
import struct
from dataclasses import replace
from typing import Any, Final

import numpy as np
from fuzz_datagrams import Fuzz

from hapticnet.node.events import Failed, MasterLeft
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.handshake import Door, SealedDoor, hello_mac, prologue
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster, new_key
from hapticnet.protocol.messages import COOKIE_BYTES, TICKET_BYTES, unpack_cookie
from hapticnet.protocol.noise import Initiator
from hapticnet.protocol.states import Connected
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body, unpack, unpack_nonce
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

Source = tuple[str, int]

TICK_US: Final = 1_000
MASTER: Final[Source] = ("192.0.2.1", 40_000)
STRANGERS: Final = 1_000
RENEWED_EVERY: Final = 701
"""Ticks after which another master asks for a session."""

UNANSWERED: Final = 5
"""Ticks in which a new master hears only the attacker."""

SETTLED: Final = 500
"""Ticks after which a master must have a session."""

LARGEST_BODY: Final = 1_000
"""Limit that keeps sealed datagrams within the size that is read."""

CODECS: Final = ("deadband", "adaptive-predictive", "raw", "least-squares", "linear-predictive", "motion-predictive")


class Session:
    """A slave and its master in virtual time, and what arrives at one of them.

    Parameters
    ----------
    attacked
        "slave" or "master".

    Attributes
    ----------
    step
        Ticks so far.
    failures
        How often a codec, a scene or an operator failed.
    lost
        Masters that did not keep their first session, though nobody else had its keys; only if sealed.
    insiders, requests
        Datagrams with a valid seal, in every other session; requests from proved addresses.
    """

    def __init__(self, seed: int, *, sealed: bool, attacked: str) -> None:
        self.step = self.failures = self.lost = self.insiders = self.requests = 0
        self.fuzz = Fuzz(seed)
        self._rng = np.random.default_rng(seed)
        self._now_us = 0
        self._sealed = sealed
        self._attacks_slave = attacked != "master"
        self._keys = [new_key(self._rng) for _ in range(3)]  # of the slave, the master and a stranger
        public = self._keys[0].public
        self._key = MasterKey(self._keys[1], public) if sealed else None
        entry = MasterEntry(name="fuzz", public=self._keys[1].public)
        door: Door = SealedDoor(self._keys[0].private, Roster([entry]), self._rng) if sealed else Door()
        scene = paper_scene(seed)
        tissues = [replace(each, ring_hz=200.0, touch_per_s=100.0, breach_m_s2=10.0) for each in scene.tissues]
        given = lambda _: Scene(tissues, name=scene.name), SlaveSettings(), self._rng
        others: dict[str, Any] = {
            "doors": {SEALED if sealed else OPEN: door},
            "host_of": lambda address: address[0] if isinstance(address, tuple) else address,
        }
        self._slave = SlaveNode(*given, **others)
        self._operator = ScriptedOperator(InsertionSettings(insertions=10), self._rng)
        self._masters = 0
        self._renewed = self._connections = 0
        self._betrayed = False
        self._renew_master()
        for _ in range(100):  # until the corpus has something of every kind
            self.tick()

    def tick(self) -> None:
        """Advance the true session by one tick."""
        self.step += 1
        jumps = self.step % 20_011 == 0
        self._now_us += int(self._rng.integers(-(10**9), 10**9)) if jumps else TICK_US
        if self._master.finished or jumps or self.step % RENEWED_EVERY == 0:
            self._renew_master()
        self._slave.tick(self._now_us)
        self._master.tick(self._now_us)
        self._master.drive(self._now_us)
        for _ in range(3):
            for data in self._master.datagrams_to_send():
                self._note(data)
                self._slave.receive_datagram(data, MASTER, self._now_us)
            answers = [data for data, address in self._slave.datagrams_to_send() if address == MASTER]
            if self.step - self._renewed > UNANSWERED:
                for data in answers:
                    self._note(data)
                    self._master.receive_datagram(data, self._now_us)
        self._count_events()

    def hostile(self) -> tuple[bytes, Source]:
        """Return a hostile datagram for the attacked node, and its source."""
        fuzz = self.fuzz
        if self._betrayed and fuzz.one_in(4) and (data := self._insiders()):
            return data, MASTER
        if not self._attacks_slave and self.step - self._renewed <= UNANSWERED:
            return self._answer(), MASTER
        if self._attacks_slave and fuzz.one_in(200):
            return self._request()
        return fuzz.datagram(), MASTER if fuzz.one_in(2) else self._stranger()

    def strike(self, data: bytes, source: Source) -> None:
        """Deliver a datagram to the attacked node."""
        if self._attacks_slave:
            self._slave.receive_datagram(data, source, self._now_us)
        else:
            self._master.receive_datagram(data, self._now_us)

    def report(self) -> dict[str, Any]:
        """Return the counters of the attacked node; of a slave, those for strangers."""
        report = self._slave.report() if self._attacks_slave else self._master.report()
        return {
            name: report[name] for name in ("unknown_peers", "throttled", "unkeyed", "never_used") if name in report
        }

    def _note(self, data: bytes) -> None:
        self.fuzz.corpus.append(data)
        if unpack(data).kind is Kind.HELLO:
            self._nonce = unpack_nonce(unpack(data).body)

    def _renew_master(self) -> None:
        if self._sealed and not self._betrayed and self.step - self._renewed > SETTLED:
            self.lost += self._connections != 1
        self._betrayed = self._sealed and self._masters % 2 == 1
        codec = CODECS[self._masters % len(CODECS)]
        settings = MasterSettings(
            codec=codec,
            key=self._key,
            name=f"fuzz {self._masters % 10}",
            announced=self._masters % 3 == 0,
            positions="line" if self._masters % 4 < 2 else "raw",
            vibration=self._masters % 3 == 1,
        )
        self._master = MasterNode(self._operator, None, settings, self._rng)
        self._masters += 1
        self._renewed = self.step
        self._connections = 0
        self._nonce = 0

    def _count_events(self) -> None:
        while event := self._master.next_event():
            self.failures += isinstance(event, Failed)
            self._connections += isinstance(event, Connected)
        while left := self._slave.next_event():
            self.failures += isinstance(left, MasterLeft) and "failed" in (left.context.session.end_reason or "")

    def _stranger(self) -> Source:
        number = self.fuzz.random.randrange(STRANGERS)
        return f"198.51.100.{number % 250}", 40_000 + number

    def _insiders(self) -> bytes | None:
        """Return a datagram with a hostile body with a valid seal: from a peer that has the keys."""
        if self._attacks_slave:
            stream = self._master.session._stream
            if stream is None or stream.seal is None:
                return None
        else:
            context = next((each for each in self._slave.contexts if each.address == MASTER and each.steps), None)
            if context is None or context.session.seal is None:
                return None
        kind = Kind.POSITION if self._attacks_slave else Kind.FORCE
        if self.fuzz.one_in(4):
            kind = self.fuzz.random.choice(list(Kind))
        body = self.fuzz.body(pack_body(self._true_fields(kind)))[:LARGEST_BODY]
        self.insiders += 1
        if self._attacks_slave:
            return stream.pack(kind, body)
        session: Any = context.session
        data: bytes = session.seal.pack(kind, session.number, session._sequence, body)
        session._sequence += 1
        return data

    def _true_fields(self, kind: Kind) -> tuple[Any, ...]:
        """Return the fields of a message of a kind, as the peer could send it now."""
        t_us = self._now_us & 0xFFFFFFFF
        payload = self.fuzz.random.randbytes(self.fuzz.random.choice((0, 1, 4, 4, 8, 12, 24, 40)))
        if kind is Kind.POSITION:
            loss = (self.fuzz.random.randrange(120), self.fuzz.random.randrange(120)) if self.fuzz.one_in(2) else ()
            return t_us, self.fuzz.random.randrange(100), payload, *loss
        if kind is Kind.FORCE:
            return t_us, payload, *self._bound()
        if kind is Kind.VIBRATION:
            return t_us - 10_000 & 0xFFFFFFFF, payload, *self._bound()
        return (t_us, None, *self._bound()) if kind is Kind.KEEPALIVE else ("reason", self.fuzz.random.randrange(9))

    def _bound(self) -> tuple[bytes, ...]:
        """Return the field with a stiffness bound, if any."""
        random = self.fuzz.random
        if random.randrange(2):
            return ()
        numbers = [random.choice((0.0, 1.0, -1.0, 1e9, 1e30, math.nan, math.inf, -0.0)) for _ in range(4)]
        return (random.choice((struct.pack(">4f", *numbers), random.randbytes(16), random.randbytes(7), b"")),)

    def _answer(self) -> bytes:
        """Return a hostile answer to the HELLO that the master last sent."""
        fuzz = self.fuzz
        kind = fuzz.random.choice((Kind.COOKIE, Kind.WELCOME, Kind.REFUSE))
        contents: tuple[Any, ...] = (fuzz.random.randbytes(COOKIE_BYTES),)
        if kind is Kind.WELCOME:
            grant = pack_body(
                (fuzz.random.randrange(2**32), 1000.0, 45_000, "scene", bytes(TICKET_BYTES), False, False, 0.0)
            )
            contents = (grant if fuzz.one_in(4) else fuzz.body(grant),)
        elif kind is Kind.REFUSE:
            contents = ("no", 5)
        version = SEALED if self._sealed else OPEN
        body = pack_body((self._nonce, *contents))
        if fuzz.one_in(4):
            body = fuzz.body(body)
        return pack(kind, fuzz.random.randrange(2**32), fuzz.random.randrange(2**32), body, version)

    def _request(self) -> tuple[bytes, Source]:
        """Return a HELLO with a hostile request from a stranger that has proved its address."""
        fuzz, source = self.fuzz, self._stranger()
        nonce, request, mac = fuzz.random.randrange(2**32), fuzz.request(), b""
        version = OPEN
        if self._sealed:
            version = SEALED
            own: PrivateKey = fuzz.random.choice(self._keys[1:])
            initiator = Initiator(own.private, self._keys[0].public, own.psk, prologue(nonce, 0), self._rng)
            request = initiator.write(request)
            if fuzz.one_in(4):
                request = request[: fuzz.random.randrange(len(request))]
            mac = hello_mac(self._keys[0].public, nonce, 0, request)
        self._slave.receive_datagram(fuzz.hello(nonce, b"", request, mac, version), source, self._now_us)
        cookie = b""
        for data, address in self._slave.datagrams_to_send():
            if address == source and unpack(data).kind is Kind.COOKIE:
                cookie = unpack_cookie(unpack(data).body).cookie
        self.requests += 1
        return fuzz.hello(nonce, cookie, request, mac, version), source
