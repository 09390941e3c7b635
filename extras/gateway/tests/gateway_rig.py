"""A gateway between tabs, which are connections of aiortc here, and a slave, in one process."""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from aiortc import RTCConfiguration, RTCPeerConnection, RTCSessionDescription

from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.keys import MasterKey
from hapticnet.runtime.runners import run_slave
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.runtime.udp import HostPort, bound_address, listen, listen_for_streams
from hapticnet_gateway.gateway import Gateway, TabAccess
from tests.conftest import make_slave
from tests.web.rig import WITHIN_S, until

FINGERPRINT = ":".join(f"{each:02X}" for each in range(32))
OFFER = f"""v=0
o=- 4567 2 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE 0
a=extmap-allow-mixed
a=msid-semantic: WMS
m=application 51234 UDP/DTLS/SCTP webrtc-datachannel
c=IN IP4 198.51.100.7
a=candidate:1 1 udp 2113937151 0f1e.local 51234 typ host generation 0
a=candidate:2 1 udp 1677729535 198.51.100.7 9 typ srflx raddr 10.0.0.1 rport 22
a=ice-ufrag:Ab+/
a=ice-pwd:0123456789012345678901
a=ice-options:trickle
a=fingerprint:sha-256 {FINGERPRINT}
a=setup:actpass
a=mid:0
a=sctp-port:5000
a=max-message-size:262144
a=end-of-candidates
""".replace("\n", "\r\n")
PERIOD_S = 0.004
ELSEWHERE = "https://touch.example"


def open_sockets() -> int:
    links = []
    for each in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # that of the folder itself
            links.append(os.readlink(each))
    return sum(link.startswith("socket:") for link in links)


@dataclass
class Rig:
    gateway: Gateway
    access: TabAccess
    slave: SlaveNode
    http: aiohttp.ClientSession
    said: list[str]
    pages: list["Page"] = field(default_factory=list)

    async def connect(self, **options: Any) -> "Page":
        self.pages.append(Page(self, options))
        return await self.pages[-1].connect()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.access.port}"

    async def offer(self, sdp: str | bytes, **headers: str) -> tuple[int, str]:
        """Return status and text of the answer; `headers` replace those of the gateway's own page."""
        given = {"Authorization": f"Bearer {self.access.tokens['operator']}", "Origin": self.url} | headers
        async with self.http.post(f"{self.url}/offer", data=sdp, headers=given) as answer:
            return answer.status, await answer.text()

    def of(self, number: int) -> Any:
        """Return the gateway's end of a tab."""
        return next(tab for tab in self.gateway.tabs if tab.number == number)


@dataclass
class Page:
    """A tab: a connection, its channel, and a master behind it once `touch` is called."""

    rig: Rig
    options: dict[str, Any] = field(default_factory=dict)
    received: list[bytes] = field(default_factory=list)
    node: MasterNode | None = None

    def __post_init__(self) -> None:
        self.connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        settings = {"ordered": False, "maxRetransmits": 0} | self.options
        self.channel = self.connection.createDataChannel("hapticnet", **settings)
        self.opened, self.closed = asyncio.Event(), asyncio.Event()
        self.channel.on("open", self.opened.set)
        self.channel.on("close", self.closed.set)
        self.channel.on("message", self._receive)
        self._touching: asyncio.Task[None] | None = None

    async def offer(self) -> tuple[int, str]:
        await self.connection.setLocalDescription(await self.connection.createOffer())
        return await self.rig.offer(self.connection.localDescription.sdp)

    async def connect(self) -> "Page":
        status, answer = await self.offer()
        assert status == 201, answer
        await self.connection.setRemoteDescription(RTCSessionDescription(answer, "answer"))
        await asyncio.wait_for(self.opened.wait(), WITHIN_S)
        return self

    async def touch(self, key: MasterKey | None = None) -> "Page":
        """Ask the slave for a session, and go on touching its scene."""
        hand = ScriptedOperator(InsertionSettings(insertions=1000), np.random.default_rng(1))
        self.node = MasterNode(hand, None, MasterSettings(rate_hz=1 / PERIOD_S, key=key), SystemEntropy())
        self._touching = asyncio.ensure_future(self._touch(self.node))
        return self

    async def feels(self, more_n: float = 0.1) -> None:
        """Wait for a force."""
        node = self.node
        assert node is not None
        await until(lambda: abs(node.held_n[0]) > more_n)

    async def close(self) -> None:
        if self._touching is not None:
            self._touching.cancel()
            await asyncio.wait([self._touching])
        await self.connection.close()

    async def _touch(self, node: MasterNode) -> None:
        while True:
            now = now_us()
            node.tick(now)
            self._send(node)
            node.drive(now)
            await asyncio.sleep(PERIOD_S)

    def _receive(self, data: bytes) -> None:
        self.received.append(data)
        if self.node is not None:
            self.node.receive_datagram(data, now_us=now_us())
            self._send(self.node)

    def _send(self, node: MasterNode) -> None:
        for data in node.datagrams_to_send():
            if self.channel.readyState == "open":
                self.channel.send(data)


@asynccontextmanager
async def tabs(*, sealed: bool = False, with_slave: bool = True, most_tabs: int = 8) -> AsyncIterator[Rig]:
    """Run a gateway and a slave; at the end nothing of them is left, and no library had a fault."""
    sockets, tasks = open_sockets(), len(asyncio.all_tasks())
    slave, stop = make_slave(sealed=sealed), asyncio.Event()
    sock = listen(HostPort("127.0.0.1", 0))
    address = bound_address(sock)
    http_sock = listen_for_streams(HostPort("127.0.0.1", 0), "no port")
    access = TabAccess("127.0.0.1", http_sock.getsockname()[1], {"operator": "secret"})
    said: list[str] = []
    gateway = Gateway(address, access, http_sock, frozenset({ELSEWHERE}), most_tabs, said.append, said.append)
    runs = [asyncio.ensure_future(gateway.run(stop, lambda _: None))]
    if with_slave:
        runs.append(asyncio.ensure_future(run_slave(slave, sock, stop=stop)))
    else:
        sock.close()
    rig = None
    try:
        async with aiohttp.ClientSession() as http:
            rig = Rig(gateway, access, slave, http, said)
            yield rig
    finally:
        stop.set()
        async with asyncio.timeout(WITHIN_S):
            await asyncio.gather(*runs)
            for page in [] if rig is None else rig.pages:
                await page.close()
        with suppress(OSError):
            sock.close()
            http_sock.close()
    await until(lambda: len(asyncio.all_tasks()) <= tasks)
    await until(lambda: open_sockets() <= sockets)
    assert gateway.faults == []
    assert gateway.tabs == []
