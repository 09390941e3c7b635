"""The socket of a node that a program ticks itself."""

from collections.abc import Iterator
from socket import socket

from hapticnet.errors import SettingsError
from hapticnet.runtime.udp import DRAIN_AT_MOST, READ_BYTES, SocketAddress


class TickedSocket:
    """A socket that is never waited for.

    Parameters
    ----------
    what
        What messages call its owner.

    Attributes
    ----------
    errors
        Datagrams that could not be sent or delivered; they count as lost.
    """

    def __init__(self, sock: socket, what: str) -> None:
        self.errors = 0
        self._sock = sock
        self._what = what

    @property
    def is_open(self) -> bool:
        """Whether `close` has not been called."""
        return self._sock.fileno() >= 0

    def arrived(self) -> Iterator[tuple[bytes, SocketAddress]]:
        """Yield the datagrams that have arrived, with their senders; raise SettingsError if the socket is closed."""
        if not self.is_open:
            raise SettingsError(f"this {self._what} is closed")
        for _ in range(DRAIN_AT_MOST):
            try:
                yield self._sock.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an earlier datagram could not be delivered
                self.errors += 1

    def send(self, data: bytes, address: SocketAddress) -> None:
        """Send a datagram, or count it as lost."""
        try:
            self._sock.sendto(data, address)
        except OSError:
            self.errors += 1

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()
