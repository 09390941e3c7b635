"""An attacker between master and slave, on real sockets: it sees all datagrams and decides what becomes of them."""

import heapq
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, TypeAlias

Fate: TypeAlias = Iterable[tuple[float, bytes]]  # what is sent on for one datagram: each with its delay [s]
REMEMBERED: Final = 4096
LARGEST: Final = 2048


def pass_on(data: bytes) -> Fate:
    """Send a datagram on unchanged."""
    return ((0.0, data),)


def drop(data: bytes) -> Fate:  # noqa: ARG001 - one of the fates
    """Send nothing."""
    return ()


def late(delay_s: float) -> Callable[[bytes], Fate]:
    """Return the fate of being sent on after `delay_s` [s]."""
    return lambda data: ((delay_s, data),)


class OnPath:
    """Relay between one master and a slave, in a thread of its own."""

    def __init__(self, slave: str) -> None:
        host, _, port = slave.rpartition(":")
        self._slave = host, int(port)
        self._master: tuple[str, int] | None = None
        self._front = self._bound()
        self._back = self._bound()
        # Where the master finds the slave, as it believes: HOST:PORT
        self.address = "{}:{}".format(*self._front.getsockname())
        # What becomes of each datagram to the slave and to the master; may be replaced at any time
        self.forward: Callable[[bytes], Fate] = pass_on
        self.feedback: Callable[[bytes], Fate] = pass_on
        # The newest datagrams that came from the master and from the slave
        self.to_slave: deque[bytes] = deque(maxlen=REMEMBERED)
        self.to_master: deque[bytes] = deque(maxlen=REMEMBERED)
        self._waiting: list[tuple[float, int, bool, bytes]] = []
        self._number = 0
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._front, selectors.EVENT_READ)
        self._selector.register(self._back, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def inject_to_slave(self, *datagrams: bytes) -> None:
        """Send datagrams to the slave from the master's address, as the slave sees it."""
        for data in datagrams:
            self._send(data, to_slave=True)

    def inject_to_master(self, *datagrams: bytes) -> None:
        """Send datagrams to the master from the slave's address, as the master sees it."""
        for data in datagrams:
            self._send(data, to_slave=False)

    def rebind(self) -> None:
        """Continue toward the slave from another port, as an address translator does after a pause."""
        with self._lock:
            self._selector.unregister(self._back)
            self._back.close()
            self._back = self._bound()
            self._selector.register(self._back, selectors.EVENT_READ)

    def close(self) -> None:
        """End the thread and close the sockets."""
        self._ended.set()
        self._thread.join(5.0)
        self._front.close()
        self._back.close()

    @staticmethod
    def _bound() -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind(("127.0.0.1", 0))
        sock.setblocking(False)
        return sock

    def _run(self) -> None:
        while not self._ended.is_set():
            wait_s = max(0.0, self._waiting[0][0] - time.monotonic()) if self._waiting else 0.05
            self._selector.select(min(wait_s, 0.05))
            with self._lock:
                self._drain(to_slave=True)
                self._drain(to_slave=False)
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                _, _, to_slave, data = heapq.heappop(self._waiting)
                self._send(data, to_slave=to_slave)

    def _drain(self, *, to_slave: bool) -> None:
        sock = self._front if to_slave else self._back
        while True:
            try:
                data, source = sock.recvfrom(LARGEST)
            except OSError:  # nothing more, or the other side is not there yet
                return
            if to_slave:
                self._master = source
            (self.to_slave if to_slave else self.to_master).append(data)
            for delay_s, sent in (self.forward if to_slave else self.feedback)(data):
                if delay_s > 0.0:
                    self._number += 1
                    heapq.heappush(self._waiting, (time.monotonic() + delay_s, self._number, to_slave, sent))
                else:
                    self._send(sent, to_slave=to_slave)

    def _send(self, data: bytes, *, to_slave: bool) -> None:
        try:
            if to_slave:
                self._back.sendto(data, self._slave)
            elif self._master is not None:
                self._front.sendto(data, self._master)
        except OSError:  # refused, or the buffer is full: lost
            pass
