"""A gateway carries datagrams of tabs to one slave, and nothing that a tab or a stranger does costs anybody else."""

import asyncio
import os
import re
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from aiortc import RTCConfiguration, RTCPeerConnection, RTCSessionDescription, sdp
from aiortc.rtcsctptransport import DataChunk, SackChunk, tsn_plus_one
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.cli.gateway import read_token
from hapticnet.errors import PeerError
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES
from hapticnet.runtime.runners import run_slave
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.runtime.udp import HostPort, bound_address, listen, listen_for_streams
from hapticnet.web import gateway as gateway_module
from hapticnet.web import tab as tab_module
from hapticnet.web.gateway import Gateway, TabAccess
from hapticnet.web.offer import LARGEST_OFFER, read_offer
from tests.conftest import make_slave
from tests.peers import KEY
from tests.ready import hapticnet
from tests.web.rig import WITHIN_S, played, until

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


def test_addresses_in_an_offer_are_not_taken():
    clean = read_offer(OFFER.encode()).clean(1200)
    assert not re.search("candidate|198|local", clean)
    media = sdp.SessionDescription.parse(clean).media[0]
    assert (media.ice.usernameFragment, media.dtls.fingerprints[0].value) == ("Ab+/", FINGERPRINT)
    assert media.ice_candidates == []
    assert media.sctpCapabilities.maxMessageSize == 1200


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("m=application 51234 UDP/DTLS/SCTP", "m=audio 9 UDP/TLS/RTP/SAVPF"), "one m= line"),
        (("a=mid:0", "m=application 9 UDP/DTLS/SCTP webrtc-datachannel\r\na=mid:0"), "one m= line"),
        (("a=mid:0", "a=mid:0\r\na=mid:1"), "two values of mid"),
        (("a=ice-pwd:0123456789012345678901\r\n", ""), "no ice-pwd"),
        (("0123456789012345678901", "short"), "ice-pwd is not valid"),
        (("sha-256", "sha-1"), "no fingerprint"),
        (("00:01", "00"), "fingerprint is not valid"),
        (("setup:actpass", "setup:passive"), "setup is not valid"),
        (("sctp-port:5000", "sctp-port:65536"), "sctp-port is not valid"),
        (("v=0", "v=0\r\n" * 300), "lines; at most"),
        (("v=0", "v=" + "0" * LARGEST_OFFER), "bytes; at most"),
        (("v=0", "v=\u00b2"), "not ASCII"),
    ],
    ids=lambda each: each[1][:20] if isinstance(each, tuple) else each,
)
def test_an_offer_of_anything_else_is_refused_in_words(change, why):
    with pytest.raises(PeerError, match=why):
        read_offer(OFFER.replace(*change).encode())


@given(
    st.binary(max_size=2000) | st.lists(st.sampled_from(OFFER.splitlines()), max_size=40).map("\n".join).map(str.encode)
)
def test_garbage_is_refused_or_a_clean_offer(data):
    try:
        clean = read_offer(data).clean(1200)
    except PeerError:
        return
    assert len(sdp.SessionDescription.parse(clean).media) == 1


@played
async def test_sealed_masters_in_two_tabs_touch_the_slave_each_from_an_address_of_its_own():
    async with tabs(sealed=True) as rig:
        for _ in range(2):
            await (await (await rig.connect()).touch(KEY)).feels()
        assert len({context.address for context in rig.slave.contexts}) == 2
        assert {context.address[0] for context in rig.slave.contexts} == {"127.0.0.1"}
        report = rig.gateway.report()
        assert (report["tabs"], report["dropped"], report["refused"]) == (2, {}, {})
        assert min(report["carried"]["to_slave"], report["carried"]["to_tab"]) > 20


@played
async def test_who_has_no_token_or_comes_from_elsewhere_gets_no_answer():
    async with tabs() as rig:
        tried = [
            ({"Authorization": ""}, 401), ({"Authorization": "Bearer wrong"}, 401),
            ({"Authorization": "Basic secret"}, 401), ({"Origin": ""}, 403), ({"Origin": "null"}, 403),
            ({"Origin": "https://evil.example"}, 403), ({"Origin": ELSEWHERE}, 201),
            ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ]  # fmt: skip
        for headers, status in tried:
            assert (await rig.offer(OFFER, **headers))[0] == status, headers
        async with rig.http.options(f"{rig.url}/offer", headers={"Origin": ELSEWHERE}) as answer:
            assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (204, ELSEWHERE)
        async with rig.http.options(f"{rig.url}/offer", headers={"Origin": "https://evil.example"}) as answer:
            assert (answer.status, "Access-Control-Allow-Origin" in answer.headers) == (403, False)
        assert rig.gateway.refused == {"wrong token": 3, "wrong origin": 4}


@played
async def test_an_offer_that_is_none_costs_one_answer():
    async with tabs() as rig:
        for wrong in (
            "",
            "v=0",
            "\0" * 1000,
            OFFER.replace("a=mid:0", "m=audio 9 x 0\r\na=mid:0"),
            OFFER + "a=x\r\n" * 4000,
        ):
            status, text = await rig.offer(wrong)
            assert (status, text.count("\n")) == (400, 1), wrong[:40]
        assert rig.gateway.refused == {"no valid offer": 5}
        assert rig.gateway.report()["tabs"] == 0


@played
async def test_no_datagram_goes_to_an_address_in_an_offer():
    third = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    third.bind(("127.0.0.1", 0))
    third.setblocking(False)
    async with tabs() as rig:
        host, port = third.getsockname()
        forged = OFFER.replace("198.51.100.7 9 typ srflx", f"{host} {port} typ host")
        assert str(port) in forged
        status, _ = await rig.offer(forged)
        assert status == 201
        await asyncio.sleep(0.5)
        with pytest.raises(BlockingIOError):
            third.recv(2000)
    third.close()


@played
async def test_tabs_and_offers_are_limited_by_host_and_in_all(monkeypatch):
    monkeypatch.setattr(gateway_module, "MOST_TABS_PER_HOST", 2)
    monkeypatch.setattr(gateway_module, "OFFERS_AT_ONCE", 5)
    async with tabs() as rig:
        first = await rig.connect()
        statuses = [(await rig.offer(OFFER))[0] for _ in range(2)]
        assert statuses == [201, 503]
        await first.close()
        await until(lambda: len(rig.gateway.tabs) == 1)
        assert [(await rig.offer(OFFER))[0] for _ in range(3)] == [201, 503, 429]
    async with tabs(most_tabs=1) as rig:
        assert [(await rig.offer(OFFER))[0] for _ in range(2)] == [201, 503]


@played
async def test_what_is_no_datagram_or_one_too_many_is_counted_and_others_go_on(monkeypatch):
    async with tabs() as rig:
        other = await (await rig.connect()).touch()
        monkeypatch.setattr(tab_module, "DATAGRAMS_PER_S", 100)
        page = await rig.connect()
        await other.feels()
        page.connection.sctp._remote_max_message_size = 0  # whatever the gateway has answered
        for wrong in ("text", b"", bytes(MAX_DATAGRAM_BYTES + 1)):
            page.channel.send(wrong)
        await until(lambda: rig.gateway.dropped["text, empty or too large"] == 3)
        before = len(other.received)
        for _ in range(1000):
            page.channel.send(b"garbage of a tab that floods")
        await until(lambda: rig.gateway.dropped["above the rate of datagrams"] > 20)
        await until(lambda: len(other.received) > before + 20)


@played
async def test_strangers_at_a_tabs_port_are_dropped_and_get_no_answer():
    async with tabs() as rig:
        page = await (await rig.connect()).touch()
        await page.feels()
        address = (
            "127.0.0.1",
            rig.of(1)._connection.sctp.transport.transport._connection._protocols[0].local_candidate.port,
        )
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.setblocking(False)
        for data in (b"", b"\x14", b"\x16" * 100, b"\x80" * 50, bytes(20), b"\0\1\0\0\x21\x12\xa4\x42" + bytes(12)):
            for _ in range(30):
                stranger.sendto(data, address)
            await asyncio.sleep(0.05)
        before = len(page.received)
        await until(lambda: len(page.received) > before + 20)
        dropped = rig.gateway.dropped
        await until(lambda: dropped["from a stranger"] > 20)
        await until(lambda: dropped["malformed"] + dropped["above the rate of checks"] > 20)
        with pytest.raises(BlockingIOError):
            stranger.recv(2000)
        stranger.close()


async def many_gaps(page: Page) -> None:
    sack = SackChunk()
    sack.cumulative_tsn, sack.gaps = page.connection.sctp._last_sacked_tsn, [(1, 65535)] * 250
    await page.connection.sctp._send_chunk(sack)


async def endless_message(page: Page) -> None:
    sctp = page.connection.sctp
    chunk = DataChunk()
    chunk.flags, chunk.stream_id, chunk.stream_seq, chunk.protocol, chunk.user_data = (
        6,
        page.channel.id,
        0,
        53,
        bytes(1100),
    )
    for _ in range(600):
        chunk.tsn = sctp._local_tsn
        sctp._local_tsn = tsn_plus_one(sctp._local_tsn)
        with suppress(ConnectionError):  # the gateway has closed it
            await sctp._send_chunk(chunk)
        await asyncio.sleep(0.001)


async def many_streams(page: Page) -> None:
    page.connection.createDataChannel("more", ordered=False, maxRetransmits=0)
    await asyncio.sleep(0.1)


async def nonsense(page: Page) -> None:
    sack = SackChunk()
    sack.__class__ = type("Short", (SackChunk,), {"__bytes__": lambda _: b"\3\0\0\6\0\0\0\0"})
    await page.connection.sctp._send_chunk(sack)


@pytest.mark.parametrize(
    ("attack", "why"),
    [
        (many_gaps, "would take long"), (endless_message, "never become whole"),
        (many_streams, "second channel|never become whole"), (nonsense, "makes no sense"),
    ],
)  # fmt: skip
@played
async def test_a_tab_that_abuses_its_connection_loses_it_alone(attack, why):
    async with tabs() as rig:
        other, page = await (await rig.connect()).touch(), await rig.connect()
        await other.feels()
        await attack(page)
        await until(lambda: any(re.search(f"tab 2 .*left: .*({why})", line) for line in rig.said))
        before = len(other.received)
        await until(lambda: len(other.received) > before + 20)


@pytest.mark.parametrize("options", [{"ordered": True}, {"maxRetransmits": None}, {"maxRetransmits": 3}])
@played
async def test_a_channel_that_repeats_or_sorts_is_refused(options):
    async with tabs() as rig:
        await rig.connect(**options)
        await until(lambda: "must be unordered, with maxRetransmits 0" in rig.said[-1])


@pytest.mark.parametrize("stage", ["offered", "connecting", "open", "touching"])
@played
async def test_a_tab_may_close_or_vanish_at_any_stage_and_leaves_nothing(stage, monkeypatch):
    monkeypatch.setattr(tab_module, "OPEN_WITHIN_S", 1.0)
    monkeypatch.setattr(tab_module, "IDLE_S", 1.0)
    async with tabs() as rig:
        for vanishes in (False, True):
            page = Page(rig)
            if stage in ("offered", "connecting"):
                _, answer = await page.offer()
                if stage == "connecting":
                    await page.connection.setRemoteDescription(RTCSessionDescription(answer, "answer"))
            else:
                await page.connect()
                if stage == "touching":
                    await page.touch()
                    await page.feels()
            if vanishes and stage in ("open", "touching"):  # no farewell
                page.connection.sctp.transport._send_data = lambda _: asyncio.sleep(0)
            await page.close()
            await until(lambda: not rig.gateway.tabs)


@played
async def test_without_a_slave_a_tab_waits_and_with_one_it_feels():
    async with tabs(with_slave=False) as rig:
        page = await (await rig.connect()).touch()
        await asyncio.sleep(0.5)
        assert page.received == []
        stop = asyncio.Event()
        task = asyncio.ensure_future(
            run_slave(rig.slave, listen(HostPort("127.0.0.1", rig.gateway._slave.port)), stop=stop)
        )
        await page.feels()
        stop.set()
        await task


@played
async def test_a_gateway_that_is_stopped_ends_its_tabs():
    async with tabs() as rig:
        page = await (await rig.connect()).touch()
        await page.feels()
    assert "the gateway was stopped" in rig.said[-1]
    assert page.closed.is_set()


def test_the_command_makes_a_token_once_and_reports_at_the_end(tmp_path):
    command = ("gateway", "--listen", "127.0.0.1:0", "--token", tmp_path / "token.toml", "--duration", "0.1", "--json")
    first, second = hapticnet(*command), hapticnet(*command)
    assert first.returncode == second.returncode == 0
    assert '"tabs": 0' in second.stdout
    assert (tmp_path / "token.toml").stat().st_mode & 0o777 == 0o600
    token = read_token(tmp_path / "token.toml")
    assert len(token) == 43
    assert token not in first.stdout + first.stderr + second.stderr
    os.chmod(tmp_path / "token.toml", 0o644)
    assert "accessible to other users" in hapticnet(*command).stderr
    assert "such as https://touch.example" in hapticnet("gateway", "--origin", "touch.example").stderr
