"""A gateway carries datagrams of tabs to one slave, and nothing that a tab or a stranger does costs anybody else."""

import asyncio
import os
import re
import socket
import sys
from contextlib import suppress

import pytest
from aiortc import RTCSessionDescription, sdp
from aiortc.rtcsctptransport import DataChunk, SackChunk, tsn_plus_one
from gateway_rig import ELSEWHERE, FINGERPRINT, OFFER, Page, tabs
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import PeerError, UnavailableError
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES
from hapticnet.runtime.runners import run_slave
from hapticnet.runtime.udp import HostPort, listen
from hapticnet_gateway import gateway as gateway_module
from hapticnet_gateway import tab as tab_module
from hapticnet_gateway.cli import GatewayOptions, carry, read_token
from hapticnet_gateway.gateway import check_origin
from hapticnet_gateway.offer import LARGEST_OFFER, read_offer
from tests.peers import KEY
from tests.ready import hapticnet
from tests.web.rig import played, until


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


@pytest.mark.parametrize(("body", "status"), [(b"a", b"408"), (b"a" * 1000, b"400")])
@played
async def test_an_offer_that_does_not_arrive_or_is_none_keeps_no_connection(body, status, monkeypatch):
    monkeypatch.setattr(gateway_module, "OFFER_WITHIN_S", 0.3)
    async with tabs() as rig:
        reader, writer = await asyncio.open_connection("127.0.0.1", rig.access.port)
        host, token = rig.url.removeprefix("http://"), rig.access.tokens["operator"]
        head = f"POST /offer HTTP/1.1\r\nHost: {host}\r\nOrigin: {rig.url}\r\nAuthorization: Bearer {token}\r\n"
        writer.write(f"{head}Content-Length: 1000\r\n\r\n".encode() + body)
        assert status in await asyncio.wait_for(reader.read(), 5)
        writer.close()


@played
async def test_a_token_that_is_no_text_is_wrong():
    async with tabs() as rig:
        reader, writer = await asyncio.open_connection("127.0.0.1", rig.access.port)
        head = f"POST /offer HTTP/1.1\r\nHost: 127.0.0.1:{rig.access.port}\r\nOrigin: {rig.url}\r\n"
        writer.write(head.encode() + b"Authorization: Bearer \xff\xfe\r\nContent-Length: 0\r\n\r\n")
        assert b" 401 " in await asyncio.wait_for(reader.readline(), 5)
        writer.close()


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
        (many_gaps, "costly"), (endless_message, "fragments"),
        (many_streams, "second channel|fragments"), (nonsense, "malformed"),
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
    for address in ("255.255.255.255:9", "239.1.2.3:9", "[ff02::1%lo]:9"):
        assert "must be the address of one host" in hapticnet("gateway", "--slave", address).stderr
    assert [check_origin(f"HTTPS://Touch.example{port}") for port in ("", ":443", ":444")] == [
        "https://touch.example", "https://touch.example", "https://touch.example:444",
    ]  # fmt: skip


def test_without_its_libraries_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "hapticnet_gateway.gateway", None)
    with pytest.raises(UnavailableError, match="pip install aiohttp aiortc"):
        carry(GatewayOptions())
