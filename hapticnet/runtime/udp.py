"""UDP sockets, addresses, and datagrams sent through an emulated channel."""

import asyncio
import errno
import ipaddress
import os
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from hapticnet.channel.emulator import Emulator
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES
from hapticnet.runtime.system import now_us
from hapticnet.runtime.timer import Alarm

AGES_KEPT: Final = 1000  # most ages kept until fetched: a second's, even for a port that reads continuously
TOLERANCE_US: Final = 1000.0  # largest difference of two clocks of the system between two samples [µs]

# From <asm-generic/socket.h> and <linux/sock_diag.h>.
_SO_TIMESTAMPNS: Final = 35
_SO_MEMINFO: Final = 55
_TIMESPEC: Final = struct.Struct("=qq")  # s, ns of CLOCK_REALTIME
_MEMINFO: Final = struct.Struct("=9I")
_MEMINFO_DROPS: Final = 8


class ReceiveQueue:
    """The queue of a socket of datagrams; `age` [µs] is a sample of the times from arrival here until reading."""

    def __init__(self, sock: socket.socket) -> None:
        self.age = Distribution()
        self._sock = sock
        self._ages_us: deque[float] = deque(maxlen=AGES_KEPT)
        self._drops = 0
        self._none_before_us = time.monotonic_ns() / 1000
        with suppress(OSError):  # not on Linux: ages stay unknown
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def sample_age(self) -> None:
        """Peek at the oldest datagram of the queue. Costs 1.6 µs. Raises OSError like receiving.

        The system stamps datagrams with its wall clock. If that was set since, the age may be impossible: below 0, or
        such that an earlier sample would have found this datagram. Such a sample does not count.
        """
        now_us = time.monotonic_ns() / 1000
        try:
            _, ancillary, _, _ = self._sock.recvmsg(1, socket.CMSG_SPACE(_TIMESPEC.size), socket.MSG_PEEK)
        except BlockingIOError:
            self._none_before_us = now_us
            raise
        for level, kind, value in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(value) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(value)
                age_us = (time.time_ns() - 1_000_000_000 * seconds - nanoseconds) / 1000
                if 0.0 <= age_us <= now_us - self._none_before_us + TOLERANCE_US:
                    self._none_before_us = max(self._none_before_us, now_us - age_us)
                    self.age.add(age_us)
                    self._ages_us.append(age_us)

    def take_ages(self) -> list[float]:
        """Return the newest samples [µs] since the last call."""
        ages = list(self._ages_us)
        self._ages_us.clear()
        return ages

    def count_drops(self) -> int:
        """Return how many datagrams the system dropped because the queue was full, until the socket was closed."""
        with suppress(OSError, struct.error):  # closed, or not on Linux
            info = self._sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            self._drops = _MEMINFO.unpack(info)[_MEMINFO_DROPS]
        return self._drops


SocketAddress: TypeAlias = Any  # what the socket module uses: (host, port), or four values for IPv6
OutgoingChannel: TypeAlias = Emulator[tuple[bytes, SocketAddress]]  # for outgoing datagrams, each with its destination
IncomingChannel: TypeAlias = Emulator[tuple[bytes, SocketAddress]]  # for arriving datagrams, each with its source
Receive: TypeAlias = Callable[[list[tuple[bytes, SocketAddress]], int], None]
READ_BYTES: Final = MAX_DATAGRAM_BYTES + 1  # one more than allowed, so that oversized datagrams can be recognised
DRAIN_AT_MOST: Final = 256  # largest number of datagrams read in a row
DRAIN_US: Final = 300  # longest time [µs] that a master reads in a row, so that a flood delays no tick by more
# If the socket was empty this recently, the first datagram is handed over before looking for the next, which
# takes as long as a tenth of a round trip.
PROMPT_US: Final = 2_000
POLL_S: Final = 0.01
# Room for 5 s of a master, or 20 ms of a thousand (the system counts 768 B for a small datagram). ``hapticnet doctor``
# tests whether the system allows that much.
RECEIVE_BUFFER_BYTES: Final = 1 << 22
SEND_BUFFER_BYTES: Final = 1 << 20
SAMPLE_EVERY: Final = 16  # drains between two checks of the oldest datagram's age, unless one was longer


@dataclass(frozen=True, slots=True)
class HostPort:
    """An address as text: HOST:PORT, or [HOST]:PORT for IPv6."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_host_port(text: str, *, lowest_port: int = 1) -> HostPort:
    """Return the address written as `text`; raise SettingsError if it is invalid."""
    host, separator, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        raise SettingsError(f"address {text!r}: write an IPv6 host in brackets, [HOST]:PORT")
    if not separator or not host:
        raise SettingsError(f"address {text!r} must be HOST:PORT, such as 127.0.0.1:47800")
    if not (port.isascii() and port.isdigit() and lowest_port <= int(port) <= 65535):
        raise SettingsError(f"port {port!r} of address {text!r} must be a number from {lowest_port} to 65535")
    return HostPort(host, int(port))


def listen(address: HostPort) -> socket.socket:
    """Return a socket bound to `address`; raise UnavailableError if this fails."""
    family, target = _resolve(address)
    sock = _socket(family)
    try:
        sock.bind(target)
    except OSError as error:
        sock.close()
        reason = "the port is in use" if error.errno == errno.EADDRINUSE else _words(error)
        raise UnavailableError(f"cannot listen on {address}: {reason}") from error
    return sock


def listen_for_streams(address: HostPort, failure: str) -> socket.socket:
    """Return a listening TCP socket; raise UnavailableError with `failure` if the address is not available."""
    family, target = _resolve(address)
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(target)
        sock.listen()
    except OSError as error:
        sock.close()
        raise UnavailableError(f"{failure}: {_words(error)}") from error
    return sock


def open_toward(address: HostPort) -> tuple[socket.socket, SocketAddress]:
    """Return a socket for sending to `address`, and the resolved address; raise UnavailableError if this fails.

    The socket is not connected: on a connected socket, "connection refused" arrives as a poll error, after which libuv
    stops watching the socket, and a master that was started before its slave would receive nothing.
    """
    family, target = _resolve(address)
    return _socket(family), target


def bound_address(sock: socket.socket) -> HostPort:
    """Return the address a socket is bound to."""
    host, port, *_ = sock.getsockname()
    return HostPort(host, port)


def text_of(address: SocketAddress) -> str:
    """Return a socket's address as text, HOST:PORT."""
    return str(HostPort(address[0], address[1]))


def host_of(address: SocketAddress) -> str:
    """Return the host of an address. Of an IPv6 address, the first 64 bits: one subscriber usually has the rest."""
    host: str = address[0]
    if ":" not in host or host.startswith(("::", "fe80:")):  # IPv4, loopback, mapped IPv4, or one link
        return host
    return str(ipaddress.IPv6Network((host.partition("%")[0], 64), strict=False))


def is_loopback(address: SocketAddress) -> bool:
    """Return whether an address can be reached from this host only."""
    host = ipaddress.ip_address(address[0].partition("%")[0])
    mapped = getattr(host, "ipv4_mapped", None)  # ::ffff:127.0.0.1
    return (mapped or host).is_loopback


class UdpPort:
    """A socket on an event loop: receives datagrams, and sends directly or through an emulated channel.

    `receive` is called with the datagrams that have queued up, each with its source, and the time [µs]; with `at_once`,
    for each as soon as it is read, for `DRAIN_US` in a row. If there is a `peer`, only its datagrams are accepted.
    Outgoing datagrams pass `channel` first, and arriving ones `channel_in`, if these are given.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sock: socket.socket,
        receive: Receive,
        *,
        at_once: bool = False,
        peer: SocketAddress | None = None,
        channel: OutgoingChannel | None = None,
        channel_in: IncomingChannel | None = None,
    ) -> None:
        self.unknown_peers = 0  # datagrams dropped because their source is not the peer
        self.send_errors = 0  # datagrams that the system did not accept; they count as lost
        self.queue = ReceiveQueue(sock)  # how long datagrams wait until they are read, and how many are dropped
        self._drains = 0
        self._backlog = False
        self._loop = loop
        self._sock = sock
        self._receive = receive
        self._at_once = at_once
        self._drained_us = 0
        self._peer = peer
        self._channel = channel
        self._alarm = Alarm(loop, self._deliver) if channel else None
        self._channel_in = channel_in
        self._alarm_in = Alarm(loop, self._hand_over) if channel_in else None
        self._due: deque[tuple[bytes, SocketAddress]] = deque()  # out of the channel, but not handed over yet
        loop.add_reader(sock.fileno(), self._drain)

    def send(self, data: bytes, address: SocketAddress) -> None:
        """Send a datagram to `address`."""
        if self._channel is None:
            self._send_now(data, address)
        else:
            self._channel.push((data, address), len(data), now_us())
            self._deliver()

    async def drained(self, within_s: float) -> None:
        """Wait until the channel has delivered everything, or for `within_s` [s]."""
        end_us = now_us() + round(within_s * 1e6)
        while self._channel is not None and self._channel.in_flight and now_us() < end_us:
            await asyncio.sleep(POLL_S)

    def close(self) -> None:
        """Stop reading and close the socket; datagrams still in the channel are lost."""
        self._loop.remove_reader(self._sock.fileno())
        self.queue.count_drops()
        for alarm in (self._alarm, self._alarm_in):
            if alarm is not None:
                alarm.stop()
        self._sock.close()

    def _drain(self) -> None:
        receive = self._receive
        if self._due:  # due datagrams come first, and must not accumulate
            return
        receive_from = self._sock.recvfrom
        at_once = self._at_once
        batch: list[tuple[bytes, SocketAddress]] = []
        end_us = now_us() + DRAIN_US
        for number in range(DRAIN_AT_MOST):
            if at_once and number and now_us() >= end_us:
                break
            try:
                if number == 0:
                    self._drains += 1
                    if self._backlog or not self._drains % SAMPLE_EVERY:
                        self.queue.sample_age()
                data, address = receive_from(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # an earlier datagram could not be delivered; it counts as lost
                self.send_errors += 1
                continue
            now = now_us()
            if self._peer is not None and address != self._peer:
                self.unknown_peers += 1
            elif self._channel_in is not None:
                self._channel_in.push((data, address), len(data), now)
            elif at_once or (number == 0 and now - self._drained_us < PROMPT_US):
                receive([(data, address)], now)
            else:
                batch.append((data, address))
        self._backlog = number > SAMPLE_EVERY
        if batch:
            receive(batch, now_us())
        if self._channel_in is not None:
            self._hand_over()
        self._drained_us = now_us()

    def _hand_over(self) -> None:
        if self._channel_in is None or self._alarm_in is None:
            return
        now = now_us()
        due = self._channel_in.due(now)
        if self._at_once:
            self._due += due
            end_us = now + DRAIN_US
            while self._due and now < end_us:
                self._receive([self._due.popleft()], now)
                now = now_us()
        elif due:
            self._receive(due, now)
        self._alarm_in.set(now if self._due else self._channel_in.next_timer_us())

    def _deliver(self) -> None:
        if self._channel is None or self._alarm is None:
            return
        for data, address in self._channel.due(now_us()):
            self._send_now(data, address)
        self._alarm.set(self._channel.next_timer_us())

    def _send_now(self, data: bytes, address: SocketAddress) -> None:
        try:
            self._sock.sendto(data, address)
        except OSError:
            self.send_errors += 1


def _resolve(address: HostPort) -> tuple[socket.AddressFamily, SocketAddress]:
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise UnavailableError(f"cannot find host {address.host!r}: {_words(error)}") from error
    family, _, _, _, target = found[0]
    return family, target


def _socket(family: socket.AddressFamily) -> socket.socket:
    try:
        sock = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise UnavailableError(f"cannot create a socket: {_words(error)}") from error
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return sock


def _words(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno) if error.errno > 0 else str(error.strerror)
    return str(error)
