"""The channel process: an emulated network between masters and a slave on other hosts."""

import asyncio
import contextlib
import socket
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from hapticnet.channel.emulator import ChannelCounters, Emulator
from hapticnet.channel.settings import ChannelSettings
from hapticnet.errors import UnavailableError
from hapticnet.protocol.settings import Entropy
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.relay_reception import RelayReception, proves_session
from hapticnet.runtime.rescue import Rescue
from hapticnet.runtime.udp import HostPort, SocketAddress, UdpPort, host_of, look_up, open_toward
from hapticnet.runtime.waiting import Repeating, stop_on_signals, until

MOST_CLIENTS: Final = 128
"""Each uses up to four file descriptors; a process usually has 1024."""

GIVES_WAY_US: Final = 2_000_000
"""Silence [µs] after which a client is replaced by a new one if there is no free place. A running master sends at least
every 100 ms."""

UNPROVED_AFTER_US: Final = 5_000_000
"""Silence [µs] after which a client that has no session is forgotten."""

IDLE_AFTER_US: Final = 30_000_000
"""Silence [µs] after which a client is forgotten: as long as a slave keeps a scene by default."""

RETRY_US: Final = 1_000_000
"""Time [µs] after which opening a client is tried again when it has failed."""

LOOKED_UP_FOR_US: Final = 10_000_000
"""Time [µs] for which the target's address is believed: looking a name up blocks everything else."""


class Relay:
    """Carry datagrams between any number of clients and one target, with one socket per client.

    Parameters
    ----------
    forward, feedback
        Channels to the target and back. Each client has its own, as if it used its own access link.
    entropy
        Source of cookies.

    Attributes
    ----------
    turned_away
        Requests without a free seat.
    port
        The port that clients send to.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        sock: socket.socket,
        target: HostPort,
        *,
        forward: ChannelSettings,
        feedback: ChannelSettings,
        rng: np.random.Generator,
        entropy: Entropy,
    ) -> None:
        self.turned_away = 0
        self._reception = RelayReception(entropy)
        self._looked_up: HostPort | None = None
        self._looked_up_us = 0
        self._retry_us = 0
        self._loop = loop
        self._sock = sock
        self._target = target
        self._settings = forward, feedback
        self._rng = rng
        self._clients: dict[SocketAddress, _Client] = {}
        self._ended = 0
        self._totals = [Counter(dict.fromkeys(ChannelCounters.__dataclass_fields__, 0)) for _ in self._settings]
        self.port = UdpPort(loop, sock, self._from_clients)

    @property
    def clients(self) -> int:
        """Number of present clients."""
        return len(self._clients)

    def forget_idle(self) -> None:
        """Forget the clients that have been silent for too long."""
        now = now_us()
        for address, client in list(self._clients.items()):
            if now - client.heard_us > (IDLE_AFTER_US if client.proved else UNPROVED_AFTER_US):
                self._forget(address)

    def close(self) -> None:
        """Close the sockets of all clients and the relay's own."""
        for address in list(self._clients):
            self._forget(address)
        self.port.close()

    def report(self) -> dict[str, Any]:
        """Return the account of all clients' packets, for JSON."""
        totals = [total.copy() for total in self._totals]
        for client in self._clients.values():
            client.add_to(totals)
        forward, feedback = self._settings
        return {
            "forward": {"settings": forward.describe(), **totals[0]},
            "feedback": {"settings": feedback.describe(), **totals[1]},
            "clients": self._ended + len(self._clients),
            "turned_away": self.turned_away,
            "ignored": self._reception.ignored,
            "cookies": self._reception.cookies,
            "throttled": self._reception.throttled,
        }

    def _from_clients(self, batch: list[tuple[bytes, SocketAddress]], now: int) -> None:
        for data, address in batch:
            self._from_client(data, address, now)

    def _from_client(self, data: bytes, address: SocketAddress, now: int) -> None:
        client = self._clients.get(address)
        if client is None:
            must_prove = len(self._clients) >= MOST_CLIENTS
            greeted = self._reception.greet(data, address, now, must_prove=must_prove)
            if isinstance(greeted, bytes):
                self.port.send(greeted, address)
            if greeted is not True:
                return
            client = self._open(address, now)
            if client is None:
                self.turned_away += 1
                return
        client.heard_us = now
        client.send(data)

    def _open(self, address: SocketAddress, now: int) -> "_Client | None":
        if now < self._retry_us or not self._make_room(address, now):
            return None
        try:
            sock, target = open_toward(self._target_now(now))
            client = _Client(self._loop, self._sock, address, sock, target, self._settings, self._rng)
        except (UnavailableError, OSError):  # no free descriptor, or the target's name cannot be resolved
            self._retry_us = now + RETRY_US
            return None
        self._clients[address] = client
        return client

    def _target_now(self, now: int) -> HostPort:
        """Return the target's numeric address."""
        if self._looked_up is None or now - self._looked_up_us > LOOKED_UP_FOR_US:
            self._looked_up, self._looked_up_us = look_up(self._target), now
        return self._looked_up

    def _make_room(self, address: SocketAddress, now: int) -> bool:
        """Free a seat if needed; return whether there is one.

        A client gives way that has no session or is silent; else one of the host that has most, if it has at least two
        more than the newcomer's.
        """
        if len(self._clients) < MOST_CLIENTS:
            return True
        oldest, client = min(self._clients.items(), key=lambda item: (item[1].proved, item[1].heard_us))
        if client.proved and now - client.heard_us <= GIVES_WAY_US:
            held = Counter(host_of(other) for other in self._clients)
            host, most = held.most_common(1)[0]
            if most < held[host_of(address)] + 2:
                return False
            oldest = min(
                (other for other in self._clients if host_of(other) == host),
                key=lambda other: self._clients[other].heard_us,
            )
        self._forget(oldest)
        return True

    def _forget(self, address: SocketAddress) -> None:
        client = self._clients.pop(address)
        client.add_to(self._totals)
        self._ended += 1
        client.close()


class _Client:
    """One client's socket toward the target, and its two channels."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        front: socket.socket,
        address: SocketAddress,
        sock: socket.socket,
        target: SocketAddress,
        settings: tuple[ChannelSettings, ChannelSettings],
        rng: np.random.Generator,
    ) -> None:
        forward, feedback = (Emulator[tuple[bytes, SocketAddress]](each, rng.spawn(1)[0]) for each in settings)
        self.heard_us = now_us()
        self.proved = False
        self._target = target
        with contextlib.ExitStack() as undo:
            undo.callback(sock.close)
            self._back = UdpPort(loop, front.dup(), None, channel=feedback)
            undo.callback(self._back.close)
            self._upstream = UdpPort(loop, sock, self._from_target, peer=self._target, channel=forward)
            undo.pop_all()
        self._address = address
        self._channels = forward, feedback

    def add_to(self, totals: list[Counter[str]]) -> None:
        """Add the counts of this client's packets to the totals of both directions."""
        for total, channel in zip(totals, self._channels, strict=True):
            total.update(asdict(channel.counters))

    def close(self) -> None:
        self._upstream.close()
        self._back.close()

    def send(self, data: bytes) -> None:
        self._upstream.send(data, self._target)

    def _from_target(self, batch: list[tuple[bytes, SocketAddress]], _: int) -> None:
        for data, _address in batch:
            self.proved = self.proved or proves_session(data)
            self._back.send(data, self._address)


async def run_relay(
    sock: socket.socket,
    target: HostPort,
    *,
    forward: ChannelSettings,
    feedback: ChannelSettings,
    rng: np.random.Generator,
    duration_s: float | None,
    on_status: Callable[[Relay], None],
    overload: Overload,
    rescue: Rescue | None = None,
) -> dict[str, Any]:
    """Relay until SIGINT, SIGTERM or the end of `duration_s` [s]; return the account of all packets.

    Pass a `rescue` if a report follows: later signals then do not disturb it.
    """
    loop = asyncio.get_running_loop()
    stop = stop_on_signals(loop, rescue)
    relay = Relay(loop, sock, target, forward=forward, feedback=feedback, rng=rng, entropy=SystemEntropy())
    overload.attach(relay.port)

    def status() -> None:
        relay.forget_idle()
        on_status(relay)

    repeating = Repeating(loop, status, overload)
    try:
        await until(stop, duration_s)
        return relay.report()
    finally:
        repeating.cancel()
        relay.close()
