"""Masters and senders of hostile datagrams in the test's own process, on real sockets."""

import contextlib
import socket
import struct
import time
from collections.abc import Callable, Sequence

import numpy as np

from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.samples import PositionSample

Address = tuple[str, int]

IP_PKTINFO = getattr(socket, "IP_PKTINFO", 8)
"""Linux: the source address of one datagram; `socket` names it from Python 3.12 on."""


def parse(address: str) -> Address:
    host, _, port = address.rpartition(":")
    return host, int(port)


class Moving:
    """An operator that moves to and fro, so that every position asks for another force."""

    axes = 1
    duration_us = None

    def sample(self, t_us: int) -> PositionSample:
        return PositionSample(t_us, (0.02 + 0.01 * float(np.sin(t_us * 2e-6)),))


class Client:
    """A master on a socket of a host of its own."""

    def __init__(self, slave: str, *, host: str = "127.0.0.1", settings: MasterSettings | None = None) -> None:
        self.node = MasterNode(Moving(), None, settings or MasterSettings(), SystemEntropy())
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind((host, 0))
        self.sock.setblocking(False)
        self._slave = parse(slave)
        self._next_us = now_us()

    def pump(self) -> None:
        """Take in what has arrived; tick if it is time."""
        try:
            while True:
                self.node.receive_datagram(self.sock.recv(2048), now_us())
        except OSError:
            pass
        if now_us() >= self._next_us:
            self._next_us = max(self._next_us + self.node.period_us, now_us() - 10_000)
            self.node.tick(now_us())
            self.node.drive(now_us())
        self.send()

    def send(self) -> None:
        for data in self.node.datagrams_to_send():
            self.sock.sendto(data, self._slave)

    def close(self) -> None:
        self.sock.close()


def pump(clients: Sequence[Client], until: Callable[[], bool], *, within_s: float) -> bool:
    """Run the clients until a condition holds; return False if it does not within a time [s]."""
    end_s = time.monotonic() + within_s
    while not until():
        if time.monotonic() > end_s:
            return False
        for client in clients:
            client.pump()
        time.sleep(0.0003)
    return True


class Forger:
    """Send datagrams at a constant rate, each from another source in 127/8."""

    def __init__(self, slave: str, make: Callable[[int], bytes], per_s: float) -> None:
        self.sent = 0
        self._make = make
        self._per_s = per_s
        self._slave = parse(slave)
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._start_s = time.monotonic()

    def pump(self) -> None:
        """Send what is due."""
        due = int((time.monotonic() - self._start_s) * self._per_s)
        while self.sent < due:
            source = bytes([127, self.sent // 62_500 % 250 + 1, self.sent // 250 % 250, self.sent % 250 + 1])
            from_there = [(socket.IPPROTO_IP, IP_PKTINFO, struct.pack("=I4s4s", 0, source, bytes(4)))]
            with contextlib.suppress(OSError):  # the buffer is full
                self._sock.sendmsg([self._make(self.sent)], from_there, 0, self._slave)
            self.sent += 1

    def close(self) -> None:
        self._sock.close()
