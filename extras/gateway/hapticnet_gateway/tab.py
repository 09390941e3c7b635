"""One tab at a gateway: a WebRTC connection on one side, a UDP socket to the slave on the other.

aiortc does ICE, DTLS and SCTP. This module filters what reaches it: no datagrams of strangers, no more packets than a
master needs, no messages that cost much time or memory. It does not probe for the tab, but answers the tab's
checks at the address that the tab has reached by HTTP.
"""

import asyncio
import re
import socket
import struct
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, Final

from aioice.candidate import Candidate, candidate_foundation, candidate_priority
from aioice.ice import Connection, StunProtocol
from aiortc import RTCConfiguration, RTCDataChannel, RTCPeerConnection, RTCSctpTransport, RTCSessionDescription

from hapticnet.errors import UnavailableError
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES
from hapticnet.runtime.system import now_us
from hapticnet.runtime.udp import HostPort, UdpPort, open_toward
from hapticnet_gateway.offer import Offer

DATAGRAMS_PER_S: Final = 1500  # datagrams a second of a tab to the slave, which may grant 1000 positions
BYTES_PER_S: Final = 256 * 1024  # bytes a second of these datagrams
PACKETS_PER_S: Final = 4000  # packets a second of a tab, with acknowledgements
CHECKS_PER_S: Final = 50  # STUN packets a second; a browser sends 20 while it connects, and then one in 2.5 s
DEPTH_S: Final = 0.25  # each of these may come at once for this long
OPEN_WITHIN_S: Final = 15.0  # longest time [s] from the offer until the channel is open
IDLE_S: Final = 20.0  # longest time [s] without a datagram of the tab: a master sends at least twenty a second
CLOSE_WITHIN_S: Final = 3.0
LARGEST_BACKLOG: Final = 256  # bytes waiting for the tab, above which a datagram is dropped: it would come too late
MOST_ADDRESSES: Final = 8  # addresses from which a tab may send checks
MOST_QUEUED: Final = 256  # packets of a tab that wait to be decrypted
BUFFER_BYTES: Final = 32 * 1024  # of a tab's port: if the gateway is too slow, packets are lost instead of late
WINDOW_BYTES: Final = 64 * 1024  # bytes that may be on their way to the tab, also after a loss, as over UDP
LEAST_CREDIT: Final = 512 * 1024  # of the mebibyte that aiortc grants for messages in parts; below it, parts pile up
MOST_GAPS: Final = 2048  # width of the gaps in what has arrived; it takes half a second of losses at 1 kHz

_DTLS: Final = range(20, 64)  # first byte of a packet of DTLS (RFC 7983)
_SACK: Final = 3
_GAPS_AT: Final = 16  # offset of a SACK's gaps from its beginning (RFC 9260)


class IcePort(StunProtocol):
    """A UDP port that tabs reach; a stranger's datagrams end here."""

    def __init__(self, tab: "Tab", connection: Connection) -> None:
        super().__init__(connection)
        self._tab, self._connection = tab, connection
        self._checks = TokenBucket(CHECKS_PER_S, CHECKS_PER_S)
        self._packets = TokenBucket(PACKETS_PER_S, PACKETS_PER_S * DEPTH_S)

    def datagram_received(self, data: bytes | str, addr: tuple[Any, ...]) -> None:
        """Pass on packets that may come from the tab."""
        known = [(each._network_host, each.port) for each in self._connection._remote_candidates]
        assert isinstance(data, bytes)  # noqa: S101 - for the type checker, as in aioice
        if data and data[0] in _DTLS:
            if tuple(addr[:2]) not in known:
                self._tab.drop("from a stranger")
            elif not self._packets.take(now_us()) or self._connection._queue.qsize() >= MOST_QUEUED:
                self._tab.drop("above the rate of packets")
            else:
                super().datagram_received(data, addr)
        elif not self._checks.take(now_us()) or (len(known) >= MOST_ADDRESSES and tuple(addr[:2]) not in known):
            self._tab.drop("above the rate of checks")
        elif len(data) >= 20 and data[0] < 2:
            super().datagram_received(data, addr)
        else:
            self._tab.drop("malformed")


class Tab:
    """A tab: answer its offer, then carry its datagrams until `end`.

    `slave` is the slave's address in numbers, `here` the address at which the tab reaches this host, `host` the tab's.
    `ended` is called once, with the tab and the reason.
    """

    def __init__(
        self, number: int, host: str, here: str, slave: HostPort, carried: Counter[str], dropped: Counter[str],
        admits: Callable[[int], bool], ended: Callable[["Tab", str], None],
    ) -> None:  # fmt: skip
        self.number, self.host = number, host
        self.to_slave = self.to_tab = 0  # datagrams
        self.is_open = False
        self._here, self._slave = here, slave
        self._carried, self._dropped, self._admits, self._ended = carried, dropped, admits, ended
        self._datagrams = TokenBucket(DATAGRAMS_PER_S, DATAGRAMS_PER_S * DEPTH_S)
        self._bytes = TokenBucket(BYTES_PER_S, BYTES_PER_S * DEPTH_S)
        self._begun_s = self._heard_s = time.monotonic()
        self._connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        self._channel: RTCDataChannel | None = None
        self._port: UdpPort | None = None
        self._address: Any = None
        self._closing: asyncio.Task[None] | None = None

    async def answer(self, offer: Offer) -> str:
        """Return the answer to the tab's offer, in SDP."""
        connection = self._connection
        connection.on("datachannel", self._opened)
        connection.on("connectionstatechange", self._changed)
        await connection.setRemoteDescription(RTCSessionDescription(offer.clean(MAX_DATAGRAM_BYTES), "offer"))
        sctp = connection.sctp
        assert sctp is not None  # noqa: S101 - for the type checker: the offer has a data channel
        ice = sctp.transport.transport._connection
        # Replacing these methods filters what reaches aiortc.
        vars(ice)["get_component_candidates"] = self._listen
        vars(ice)["respond_error"] = lambda *_: None  # the error would be larger than a forged request
        vars(sctp)["_handle_data"] = self._guarded(sctp, sctp._handle_data)
        await connection.setLocalDescription(await connection.createAnswer())
        if not ice.local_candidates:
            raise UnavailableError(f"cannot receive datagrams at {self._here}")
        return re.sub("(?<=max-message-size:)[0-9]+", str(MAX_DATAGRAM_BYTES), connection.localDescription.sdp)

    def check(self) -> None:
        """End a tab that did not connect or is silent; call this a few times a second."""
        now_s = time.monotonic()
        if not self.is_open and now_s - self._begun_s > OPEN_WITHIN_S:
            self.end(f"did not connect within {OPEN_WITHIN_S:g} s")
        elif now_s - self._heard_s > IDLE_S:
            self.end(f"sent nothing for {IDLE_S:g} s")

    def drop(self, why: str) -> None:
        """Count a datagram that is not passed on."""
        self._dropped[why] += 1

    def end(self, reason: str) -> None:
        """End the tab, for a reason that a person reads."""
        if self._closing is None:
            self._closing = asyncio.ensure_future(self._close())
            if self._port is not None:
                self._port.close()
            self._ended(self, reason)

    async def closed(self) -> None:
        """Wait until the ended tab has closed its sockets."""
        if self._closing is not None:
            await asyncio.wait([self._closing])

    async def _close(self) -> None:
        with suppress(Exception):  # aiortc's, whose sockets may be gone
            await asyncio.wait_for(self._connection.close(), CLOSE_WITHIN_S)

    async def _listen(self, component: int, **_: Any) -> list[Candidate]:
        """Open the port for the tab, in the place of aioice's method, which opens one at each address of the host."""
        sctp = self._connection.sctp
        assert sctp is not None  # noqa: S101 - as in `answer`
        ice = sctp.transport.transport._connection
        loop = asyncio.get_running_loop()
        try:
            transport, port = await loop.create_datagram_endpoint(
                lambda: IcePort(self, ice), local_addr=(self._here, 0)
            )
        except OSError:
            return []
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        host, number = transport.get_extra_info("sockname")[:2]
        port.local_candidate = Candidate(
            candidate_foundation("host", "udp", host), component, "udp", candidate_priority(component, "host"),
            host, number, "host",
        )  # fmt: skip
        ice._protocols.append(port)
        return [port.local_candidate]

    def _guarded(
        self, sctp: RTCSctpTransport, handle: Callable[[bytes], Awaitable[None]]
    ) -> Callable[[bytes], Awaitable[None]]:
        """Return a replacement for `handle`, which takes in a packet: it refuses costly ones, and never raises."""

        async def handle_data(data: bytes) -> None:
            if self._closing is not None:
                return
            if _width_of_gaps(data) > MOST_GAPS:
                self.end("sent a packet that is costly to process")
                return
            try:
                await handle(data)
            except ConnectionError:
                raise
            except Exception as error:  # aiortc asserts where a peer is wrong
                self.end(f"sent a malformed packet ({type(error).__name__})")
                return
            sctp._cwnd = max(sctp._cwnd, WINDOW_BYTES)
            if (
                sctp._advertised_rwnd < LEAST_CREDIT
                or len(sctp._sack_misordered) > MOST_GAPS
                or len(sctp._inbound_streams) > 1
            ):
                self.end("sent fragments of messages without their ends")

        return handle_data

    def _changed(self) -> None:
        state = self._connection.connectionState
        if state in ("failed", "closed"):
            self.end("did not connect" if self._channel is None else "disconnected")

    def _opened(self, channel: RTCDataChannel) -> None:
        if self._channel is not None:
            self.end("opened a second channel")
        elif channel.ordered or channel.maxRetransmits != 0:
            self.end("opened a reliable or ordered channel; it must be unordered, with maxRetransmits 0")
        elif self._closing is None:
            try:
                sock, self._address = open_toward(self._slave)
            except UnavailableError as error:
                self.end(str(error))
                return
            self._port = UdpPort(asyncio.get_running_loop(), sock, self._return, at_once=True, peer=self._address)
            self._channel = channel
            self._heard_s = time.monotonic()
            self.is_open = True
            channel.on("message", self._forward)
            channel.on("close", lambda: self.end("closed its channel"))

    def _forward(self, data: bytes | str) -> None:
        """Send a datagram of the tab to the slave."""
        if self._closing is not None or self._port is None:
            return
        if isinstance(data, str) or not 0 < len(data) <= MAX_DATAGRAM_BYTES:
            self.drop("text, empty or too large")
            return
        now = now_us()
        if not self._datagrams.take(now) or not self._bytes.take(now, len(data)) or not self._admits(now):
            self.drop("above the rate of datagrams")
            return
        self._heard_s = time.monotonic()
        self.to_slave += 1
        self._carried["to_slave"] += 1
        self._carried["to_slave_bytes"] += len(data)
        self._port.send(data, self._address)

    def _return(self, batch: list[tuple[bytes, Any]], _now_us: int) -> None:
        """Send datagrams of the slave to the tab."""
        channel = self._channel
        for data, _ in batch:
            if channel is None or channel.readyState != "open" or channel.bufferedAmount > LARGEST_BACKLOG:
                self.drop("backlog to the tab")
            elif not 0 < len(data) <= MAX_DATAGRAM_BYTES:
                self.drop("text, empty or too large")
            else:
                self.to_tab += 1
                self._carried["to_tab"] += 1
                self._carried["to_tab_bytes"] += len(data)
                channel.send(data)


def _width_of_gaps(data: bytes) -> int:
    """Return how many numbers the gaps of all acknowledgements in a packet of SCTP name; aiortc looks at each."""
    at, width = 12, 0
    while at + 4 <= len(data):
        kind, _, length = struct.unpack_from("!BBH", data, at)
        if kind == _SACK and at + _GAPS_AT <= len(data):
            (count,) = struct.unpack_from("!H", data, at + 12)
            count = min(count, (len(data) - at - _GAPS_AT) // 4)
            for first, last in struct.iter_unpack("!HH", data[at + _GAPS_AT : at + _GAPS_AT + 4 * max(0, count)]):
                width += max(0, last - first + 1)
        at += max(4, length + -length % 4)
    return width
