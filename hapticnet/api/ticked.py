"""The socket of a node that a program ticks itself."""

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

    def arrived(self) -> list[tuple[bytes, SocketAddress]]:
        """Return the datagrams that have arrived, with their senders; raise SettingsError if the socket is closed."""
        if not self.is_open:
            raise SettingsError(f"this {self._what} is closed")
        batch: list[tuple[bytes, SocketAddress]] = []
        for _ in range(DRAIN_AT_MOST):
            try:
                batch.append(self._sock.recvfrom(READ_BYTES))
            except BlockingIOError:
                break
            except OSError:  # an earlier datagram could not be delivered
                self.errors += 1
        return batch

    def send(self, data: bytes, address: SocketAddress) -> None:
        """Send a datagram, or count it as lost."""
        try:
            self._sock.sendto(data, address)
        except OSError:
            self.errors += 1

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()
