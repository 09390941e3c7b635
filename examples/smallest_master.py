"""The smallest master: it streams a position on one axis, and holds the force that comes back.

    python3 examples/smallest_master.py 127.0.0.1:47800

docs/refer/protocol.md, "The smallest peer", says which parts of the protocol this is. It needs only the standard
library.
"""

import math
import secrets
import socket
import struct
import sys
import time
from typing import Any

from smallest_msgpack import UNREADABLE, packb, read_frame, uint32, unpackb

HELLO, WELCOME, REFUSE, POSITION, FORCE, KEEPALIVE, CLOSE, RESET, COOKIE = range(1, 10)


class Master:
    """Call `send` and `felt` once each period, and `receive` for each datagram. Send what the first and last return."""

    def __init__(self, rate_hz: float = 1000.0) -> None:
        self.rate_hz = rate_hz  # as the slave grants it
        self.session = self.sent = self.newest = 0
        self.t_us = self.cookie_us = self.felt_us = 0
        self.heard_us = self.asked_us = -(1 << 62)
        self.nonce: int | None = None  # of the request that is not answered yet
        self.cookie = self.request = b""
        self.ticket: bytes | None = None
        self.applied: int | None = None  # the newest FORCE
        self.confirmed: int | None = None  # that, or a KEEPALIVE since
        self.force_n = self.felt_n = 0.0

    def send(self, x_m: float, now_us: int) -> bytes | None:
        """Return the POSITION of this period or, without a session, a HELLO every 200 ms."""
        if self.session and now_us - self.heard_us <= 1_200_000:
            self.sent, self.t_us = self.sent + 1, now_us
            body = packb([now_us % (1 << 32), self.confirmed, struct.pack(">f", x_m)])
            return packb([1, POSITION, self.session, self.sent % (1 << 32), body])
        self.session = 0
        return self.hello(now_us) if now_us - self.asked_us >= 200_000 else None

    def hello(self, now_us: int) -> bytes:
        """Return a HELLO: of a new attempt, if there is none or its cookie has been without an answer for 4 s."""
        self.asked_us = now_us
        if self.nonce is None or (self.cookie and now_us - self.cookie_us > 4_000_000):
            self.nonce, self.cookie = secrets.randbits(32), b""
            law = 0.05, 0.025, 1.0  # Weber fraction, floor [N] and multiplier: the JND
            self.request = packb(["deadband", {}, *law, self.rate_hz, 1, "smallest", self.ticket, now_us, False, 0.0])
        return packb([1, HELLO, 0, 0, packb([self.nonce, self.cookie, self.request, b"", bytes(400)])])

    def receive(self, data: bytes, now_us: int) -> bytes | None:
        """Take in a datagram; return the answer, if there is one. ConnectionError: there is no session."""
        try:
            version, kind, number, sequence, body = read_frame(data)
            if version == 1 and kind in (WELCOME, REFUSE, COOKIE):
                return self.greeted(kind, sequence, unpackb(body), now_us)
            if version == 1 and kind in (FORCE, KEEPALIVE, CLOSE) and number == self.session != 0:
                self.answered(kind, sequence, unpackb(body), now_us)
        except UNREADABLE:
            pass
        return None

    def greeted(self, kind: int, sequence: int, fields: Any, now_us: int) -> bytes | None:
        """Take in the answer to a HELLO."""
        if fields[0] != self.nonce or self.nonce is None:
            return None
        if kind == REFUSE:
            raise ConnectionError(f"the slave refuses: {fields[1]}")
        if kind == COOKIE:
            is_first, self.cookie = not self.cookie, bytes(fields[1])
            self.cookie_us = now_us if is_first else self.cookie_us
            return self.hello(now_us) if is_first else None
        number, rate_hz, _, _, ticket, _, announced, share = unpackb(fields[1])[:8]
        if announced or share or not uint32(number)[0] or not 20 <= rate_hz <= 100_000:
            return None
        self.session, self.rate_hz, self.ticket, self.nonce = number, min(self.rate_hz, rate_hz), ticket, None
        self.sent, self.newest, self.applied, self.confirmed, self.heard_us = 0, sequence, None, None, now_us
        return None

    def answered(self, kind: int, sequence: int, fields: Any, now_us: int) -> None:
        """Take in a FORCE, KEEPALIVE or CLOSE of the session."""
        is_new = newer(sequence, self.newest)
        if kind == CLOSE:
            reason, code = fields[:2]
            if uint32(code)[0] == 6 and is_new:
                raise ConnectionError(f"the slave closed: {reason}")
            self.session = 0 if is_new else self.session
            return
        (t_us,) = uint32(fields[0])
        age_us, since_us = (now_us - t_us) % (1 << 32), (self.t_us - t_us) % (1 << 32)
        if age_us > 1_000_000 or since_us >= 1 << 31:
            return  # it is too old, or answers a position that was not sent
        if kind == FORCE and (self.applied is None or newer(sequence, self.applied)):
            (force_n,) = struct.unpack({4: ">f", 8: ">d"}[len(fields[1])], fields[1])
            if not abs(force_n) <= 1e15:
                return
            self.force_n, self.applied, self.confirmed, self.heard_us = force_n, sequence, sequence, now_us
        elif kind == KEEPALIVE and is_new and holds(fields[1], self.applied):
            self.confirmed, self.heard_us = sequence, now_us
        self.newest = sequence if is_new else self.newest

    def felt(self, now_us: int) -> float:
        """Return the force [N] to apply now: it fades without news, rises by 50 N/s and is at most 5 N."""
        held = min(max((300_000 - (now_us - self.heard_us)) / 100_000, 0.0), 1.0)
        wanted_n = min(max(held * self.force_n, -5.0), 5.0)
        before_n = abs(self.felt_n) if wanted_n * self.felt_n > 0.0 else 0.0
        most_n = before_n + 50e-6 * min(now_us - self.felt_us, 20_000)
        self.felt_us, self.felt_n = now_us, min(max(wanted_n, -most_n), most_n)
        return self.felt_n


def newer(sequence: int, than: int) -> bool:
    """Return whether a sequence number comes after another one."""
    return 0 < (sequence - than) % (1 << 32) < 1 << 31


def holds(named: int | None, applied: int | None) -> bool:
    """Return whether a KEEPALIVE that names a FORCE confirms what is applied."""
    return named is applied if named is None or applied is None else not newer(uint32(named)[0], applied)


def main(slave: str = "127.0.0.1:47800", seconds: float = 5.0) -> float:
    """Push in and out for some seconds; print the forces and return the largest [N]."""
    master, largest_n, (host, port) = Master(), 0.0, slave.rsplit(":", 1)
    start_s = due_s = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect((host, int(port)))
        while due_s < start_s + seconds:
            now_us, due_s = time.monotonic_ns() // 1000, due_s + 1.0 / master.rate_hz
            x_m = 0.015 * (1.0 - math.cos(2.0 * math.pi * (due_s - start_s) / seconds))
            answer = master.send(x_m, now_us)
            while True:
                try:
                    if answer:
                        link.send(answer)
                    link.settimeout(max(due_s - time.monotonic(), 1e-6))
                    data = link.recv(1201)
                except TimeoutError:
                    break
                except ConnectionRefusedError:  # nobody is there yet
                    answer = None
                    continue
                answer = master.receive(data, time.monotonic_ns() // 1000) if len(data) <= 1200 else None
            largest_n = max(largest_n, master.felt(time.monotonic_ns() // 1000))
            print(f"{x_m * 1e3:6.2f} mm  {master.felt_n:6.2f} N")
        if master.session:
            link.send(packb([1, CLOSE, master.session, (master.sent + 1) % (1 << 32), packb(["done", 0])]))
    return largest_n


if __name__ == "__main__":
    main(sys.argv[1] if sys.argv[1:] else "127.0.0.1:47800")
