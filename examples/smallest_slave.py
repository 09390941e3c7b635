"""The smallest slave: it answers each position of one master, on one axis, with the force there.

    python3 examples/smallest_slave.py 47800

docs/refer/protocol.md, "The smallest peer", says which parts of the protocol this is. It needs only the standard
library.
"""

import hashlib
import secrets
import socket
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from smallest_msgpack import UNREADABLE, packb, read_frame, uint32, unpackb

HELLO, WELCOME, REFUSE, POSITION, FORCE, KEEPALIVE, CLOSE, RESET, COOKIE = range(1, 10)
CODECS = ("raw", "deadband")  # their receivers take a float32 at any time


@dataclass
class Session:
    """A session that was granted; it is open from its first position on."""

    address: Any
    nonce: int
    newest: int
    heard_us: int
    sent: int = 0
    welcome: bytes = b""
    ticket: bytes = field(default_factory=lambda: secrets.token_bytes(16))
    number: int = field(default_factory=lambda: secrets.randbelow(0xFFFF0000) + 0x10000)


class Slave:
    """Give each datagram that arrives to `receive`, and send what that returns to where it came from."""

    def __init__(self, force_n: Callable[[float], float]) -> None:
        self.force_n = force_n
        self.secret = secrets.token_bytes(32)
        self.open: Session | None = None
        self.half_open: Session | None = None

    def receive(self, data: bytes, address: Any, now_us: int) -> bytes | None:
        """Return the answer to a datagram, None without one."""
        try:
            version, kind, number, sequence, body = read_frame(data)
            if kind == HELLO and len(data) >= 400:
                return self.greet(version, sequence, unpackb(body), address, now_us)
            if version != 1 or kind not in (POSITION, CLOSE):
                return None
            for session in (self.open, self.half_open):
                if session and (session.number, session.address) == (number, address):
                    return self.answer(session, kind, sequence, unpackb(body), now_us)
            return packb([1, RESET, number, sequence, b""])
        except UNREADABLE:
            return None

    def greet(self, version: int, sequence: int, fields: Any, address: Any, now_us: int) -> bytes:
        """Return the answer to a HELLO: a COOKIE, a REFUSE or a WELCOME."""
        (nonce,), here = uint32(fields[0]), repr(address).encode()
        if version != 1:
            return refusal(nonce, "only version 1 is served", 7 if version == 2 else 1)
        cookie = hashlib.blake2s(packb([nonce, here]), digest_size=16, key=self.secret).digest()
        if fields[1] != cookie:
            return packb([1, COOKIE, 0, 0, packb([nonce, cookie])])
        for session in (self.open, self.half_open):
            if session and (session.address, session.nonce) == (address, nonce):
                return session.welcome
        codec, _, _, _, _, rate_hz, axes, _, ticket, *_ = unpackb(fields[2])
        if codec not in CODECS:
            return refusal(nonce, "codecs: raw, deadband", 2)
        if not 20 <= rate_hz <= 100_000:
            return refusal(nonce, "rate: 20 to 100000 Hz", 3)
        if axes != 1:
            return refusal(nonce, "only one axis", 4)
        if self.open and ticket != self.open.ticket and now_us - self.open.heard_us < 1_000_000:
            return refusal(nonce, "the place is taken", 5)
        new = self.half_open = Session(address, nonce, sequence, now_us)
        grant = packb([new.number, min(float(rate_hz), 10_000.0), 45_000, "spring", new.ticket, False, False, 0.0])
        new.welcome = packb([1, WELCOME, new.number, 0, packb([nonce, grant])])
        return new.welcome

    def answer(self, session: Session, kind: int, sequence: int, fields: Any, now_us: int) -> bytes | None:
        """Return the answer to a POSITION or CLOSE."""
        if not 0 < (sequence - session.newest) % (1 << 32) < 1 << 31:
            return None  # late, or a copy
        if kind == CLOSE:
            uint32(fields[1])
            self.open, self.half_open = (each if each is not session else None for each in (self.open, self.half_open))
            return packb([1, CLOSE, session.number, session.sent + 1, packb(["as asked", 0])])
        t_us, _, payload = fields[:3]
        uint32(t_us)
        (x_m,) = struct.unpack(">f", payload)
        if not abs(x_m) <= 1e15:
            raise ValueError("no such place")
        if session is self.half_open:
            self.open, self.half_open = session, None
        session.newest, session.heard_us, session.sent = sequence, now_us, session.sent + 1
        body = packb([t_us, struct.pack(">f", self.force_n(x_m))])
        return packb([1, FORCE, session.number, session.sent % (1 << 32), body])


def refusal(nonce: int, reason: str, code: int) -> bytes:
    """Return a REFUSE."""
    return packb([1, REFUSE, 0, 0, packb([nonce, reason, code])])


def spring(x_m: float) -> float:
    """Return the force [N] of a spring of 300 N/m behind 20 mm."""
    return 300.0 * max(0.0, x_m - 0.02)


def main(port: int = 47800, seconds: float = float("inf")) -> None:
    """Serve one master after the other."""
    slave, end_s = Slave(spring), time.monotonic() + seconds
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        door.bind(("127.0.0.1", port))
        door.settimeout(0.2)
        while time.monotonic() < end_s:
            try:
                data, address = door.recvfrom(1201)
            except TimeoutError:
                continue
            answer = slave.receive(data, address, time.monotonic_ns() // 1000) if len(data) <= 1200 else None
            if answer:
                door.sendto(answer, address)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 47800)
