"""A UDP socket that reads and sends many datagrams with one system call (recvmmsg(2), sendmmsg(2) of Linux)."""

import asyncio
import ctypes
import errno
import socket
import struct
from collections.abc import Callable, Hashable
from typing import Any, Final, TypeAlias

import numpy as np

from hapticnet.errors import UnavailableError
from hapticnet.node.bank_tables import Datagrams, make_arrivals
from hapticnet.protocol.frames import ADDRESS_WORDS
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.udp import CROWD_BUFFER_BYTES, DRAIN_AT_MOST, READ_BYTES, SAMPLE_EVERY, OutgoingChannel, UdpPort

ReceiveArrivals: TypeAlias = Callable[[Datagrams, int, int], None]

ADDRESS_BYTES: Final = 4 * ADDRESS_WORDS
"""Size of a sockaddr_in6, the larger one of the two."""

# struct iovec, and struct mmsghdr with its struct msghdr, from <sys/socket.h> on 64-bit Linux.
_PIECE: Final = np.dtype([("base", np.uint64), ("length", np.uint64)])
_MESSAGE: Final = np.dtype(
    [
        ("name", np.uint64),
        ("name_length", np.uint32),
        ("_name_padding", np.uint32),
        ("pieces", np.uint64),
        ("piece_count", np.uint64),
        ("control", np.uint64),
        ("control_length", np.uint64),
        ("flags", np.int32),
        ("_flags_padding", np.uint32),
        ("length", np.uint32),
        ("_padding", np.uint32),
    ]
)
_SOCKADDR_IN: Final = struct.Struct("=H2s4s")
_SOCKADDR_IN6: Final = struct.Struct("=H2s4s16sI")


class SocketAddresses:
    """The addresses of the socket module as the words of a sockaddr. Satisfies `AddressBook`."""

    def words(self, address: Any) -> Any:
        """Return an address as words, the same for the same address."""
        host, port, *more = address
        port_bytes = port.to_bytes(2, "big")
        if more:
            flow, scope = more
            host_bytes = socket.inet_pton(socket.AF_INET6, host.partition("%")[0])
            packed = _SOCKADDR_IN6.pack(socket.AF_INET6, port_bytes, flow.to_bytes(4, "big"), host_bytes, scope)
        else:
            packed = _SOCKADDR_IN.pack(socket.AF_INET, port_bytes, socket.inet_aton(host))
        return np.frombuffer(packed.ljust(ADDRESS_BYTES, b"\0"), np.uint32)

    def address(self, words: Any) -> Hashable:
        """Return the address that was made into words."""
        packed = words.tobytes()
        family, port_bytes = struct.unpack_from("=H2s", packed)
        port = int.from_bytes(port_bytes, "big")
        if family == socket.AF_INET:
            return socket.inet_ntoa(packed[4:8]), port
        _, _, flow_bytes, host_bytes, scope = _SOCKADDR_IN6.unpack(packed)
        flow, host = int.from_bytes(flow_bytes, "big"), socket.inet_ntop(socket.AF_INET6, host_bytes)
        if scope:  # a link-local host is written with its link
            host, _ = socket.getnameinfo((host, port, flow, scope), socket.NI_NUMERICHOST | socket.NI_NUMERICSERV)
        return host, port, flow, scope


class BatchPort(UdpPort):
    """A `UdpPort` that hands over what has queued up as arrays, and sends the answers of a bank.

    Parameters
    ----------
    receive
        Called with the arrays, how many datagrams they hold, and the time [µs].

    Raises
    ------
    UnavailableError
        If the system has no recvmmsg.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sock: socket.socket,
        receive: ReceiveArrivals,
        *,
        channel: OutgoingChannel | None = None,
    ) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        try:
            self._recvmmsg, self._sendmmsg = libc.recvmmsg, libc.sendmmsg
        except AttributeError as error:
            raise UnavailableError("this system has no recvmmsg; omit --compiled") from error
        pointer = ctypes.c_void_p
        self._recvmmsg.argtypes = [ctypes.c_int, pointer, ctypes.c_uint, ctypes.c_int, pointer]
        self._sendmmsg.argtypes = [ctypes.c_int, pointer, ctypes.c_uint, ctypes.c_int]
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, CROWD_BUFFER_BYTES)
        self._receive_arrivals = receive
        self._arrivals = make_arrivals(DRAIN_AT_MOST)
        self._incoming = _Messages(self._arrivals)
        self._incoming.piece_lengths[:] = READ_BYTES
        self._outgoing: _Messages | None = None
        super().__init__(loop, sock, None, channel=channel)
        loop.add_reader(sock.fileno(), self._drain)

    def send_departures(self, departures: Datagrams, count: int) -> None:
        """Send the first `count` answers of a bank. The arrays must be the same at each call."""
        if not count:
            return
        messages = self._outgoing
        if messages is None:
            messages = self._outgoing = _Messages(departures)
            messages.name_lengths[:] = _name_bytes(self._sock)
        messages.piece_lengths[:count] = departures.lengths[:count]
        first = 0
        while first < count:
            at = messages.address + first * _MESSAGE.itemsize
            sent = self._sendmmsg(self._sock.fileno(), at, count - first, 0)
            if sent <= 0:  # the system refuses the first one; it counts as lost
                self.send_errors += 1
                sent = 1
            first += sent

    def _drain(self) -> None:
        self._drains += 1
        if self._backlog or not self._drains % SAMPLE_EVERY:
            try:
                self.queue.sample_age()
            except BlockingIOError:
                return
            except OSError:
                self.send_errors += 1
        messages = self._incoming
        count = self._recvmmsg(self._sock.fileno(), messages.address, DRAIN_AT_MOST, socket.MSG_DONTWAIT, None)
        if count <= 0:
            if ctypes.get_errno() not in (errno.EAGAIN, errno.EINTR):  # an earlier datagram could not be delivered
                self.send_errors += 1
            return
        self._backlog = count > SAMPLE_EVERY
        self._arrivals.lengths[:count] = messages.lengths[:count]
        messages.name_lengths[:count] = ADDRESS_BYTES  # the system has written how much of it was used
        self._receive_arrivals(self._arrivals, count, now_us())


class _Messages:
    """Headers for datagrams.

    Attributes
    ----------
    address
        Where the first header is.
    name_lengths, piece_lengths, lengths
        Sizes [B] of the addresses, of the data to send or the space to read into, and of what was read, shapes (n,).
    """

    def __init__(self, datagrams: Datagrams) -> None:
        data, addresses = datagrams.octets, datagrams.addresses
        messages, pieces = np.zeros(len(data), _MESSAGE), np.zeros(len(data), _PIECE)
        rows = np.arange(len(data), dtype=np.uint64)
        pieces["base"] = data.ctypes.data + rows * data.strides[0]
        messages["name"] = addresses.ctypes.data + rows * addresses.strides[0]
        messages["pieces"] = pieces.ctypes.data + rows * _PIECE.itemsize
        messages["piece_count"] = 1
        self.address = messages.ctypes.data
        self.name_lengths, self.lengths = messages["name_length"], messages["length"]
        self.piece_lengths = pieces["length"]
        self.name_lengths[:] = ADDRESS_BYTES


def _name_bytes(sock: socket.socket) -> int:
    return ADDRESS_BYTES if sock.family == socket.AF_INET6 else 16
