"""What connections to the page may send, so that no flood delays a tick."""

import asyncio
import gc
import struct
from typing import Any
from unittest.mock import Mock

import aiohttp
import pytest
from aiohttp import web

from hapticnet.web import gate as gate_module
from hapticnet.web import messages
from hapticnet.web.gate import MOST_CONNECTIONS, PORTION_BYTES, Connection, Gate
from hapticnet.web.messages import CloseCode
from tests.web.rig import played, rig, until

REQUEST = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"


class Server(asyncio.Protocol):
    """The server's protocol: keeps the portions that it gets."""

    def __init__(self) -> None:
        self.portions: list[bytes] = []
        self.ended = False

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.portions.append(data)

    def eof_received(self) -> None:
        self.ended = True


class Transport:
    """A transport that can be paused."""

    def __init__(self) -> None:
        self.is_reading = True
        self.closed = False

    def pause_reading(self) -> None:
        self.is_reading = False

    def resume_reading(self) -> None:
        self.is_reading = True

    def is_closing(self) -> bool:
        return self.closed

    def close(self) -> None:
        self.closed = True

    abort = close


def connect(gate: Gate) -> tuple[Connection, Any, Transport]:
    connection, transport = gate(), Transport()
    connection.connection_made(transport)  # type: ignore[arg-type]
    return connection, connection._server, transport


@played
async def test_bytes_are_passed_on_in_small_portions_and_nothing_more_is_read_meanwhile():
    connection, server, transport = connect(Gate(Server))
    sent = bytes(range(256)) * 20
    connection.data_received(sent)
    connection.eof_received()
    assert (server.portions, transport.is_reading) == ([], False)
    await until(lambda: server.ended)
    assert b"".join(server.portions) == sent
    assert max(map(len, server.portions)) == PORTION_BYTES
    assert transport.closed


@played
async def test_reading_goes_on_when_all_is_passed_on_and_the_server_is_ready():
    connection, server, transport = connect(Gate(Server))
    connection.data_received(b"first")
    await until(lambda: transport.is_reading)
    server.transport.pause_reading()
    connection.data_received(b"second")
    await asyncio.sleep(0.01)
    assert (server.portions, transport.is_reading) == ([b"first"], False)
    server.transport.resume_reading()
    await until(lambda: transport.is_reading)
    assert server.portions == [b"first", b"second"]


@played
async def test_strangers_share_a_limit_that_does_not_hold_up_who_has_a_token(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gate_module, "RESERVE_BYTES", 4 * PORTION_BYTES)
    monkeypatch.setattr(gate_module, "BYTES_PER_S", 1)
    gate = Gate(Server)
    (one, first, _), (two, second, _), (page, trusted, _) = connect(gate), connect(gate), connect(gate)
    gate.trust(trusted.transport)
    for connection in (one, two, page):
        connection.data_received(bytes(20 * PORTION_BYTES))
    await until(lambda: len(trusted.portions) == 20)
    assert (len(first.portions), len(second.portions)) == (2, 2)
    gate.close()


@played
async def test_the_oldest_connection_without_a_token_makes_room():
    gate = Gate(Server)
    opened = [connect(gate) for _ in range(2)]
    gate.trust(opened[0][1].transport)
    opened += [connect(gate) for _ in range(MOST_CONNECTIONS - 1)]
    assert [transport.closed for _, _, transport in opened[:4]] == [False, True, False, False]


@pytest.mark.parametrize("sent", [b"", REQUEST, 50 * REQUEST, b"nonsense\r\n\r\n"])
@played
async def test_a_connection_that_ends_before_its_requests_are_begun_leaves_no_error(sent: bytes):
    """aiohttp's task would raise: of a connection that is lost it knows neither server nor handler any more."""
    faults: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context))

    async def answer(_: web.BaseRequest) -> web.StreamResponse:
        return web.Response(text="here")

    gate = Gate(web.Server(answer, access_log=None))
    for waits in range(4):
        connection = gate()
        transport = Mock(**{"is_closing.return_value": False})  # to which aiohttp can write
        transport.get_extra_info.side_effect = lambda _, default=None: default
        connection.connection_made(transport)
        for _ in range(waits):
            await asyncio.sleep(0)
        if sent:
            connection._bytes += sent
            connection.take_turn(len(sent))
        connection.connection_lost(None)
        for _ in range(10):
            await asyncio.sleep(0.001)
    gc.collect()  # an error that nobody asked for is told when its task is deleted
    assert faults == []


@pytest.mark.parametrize("opcode", [aiohttp.WSMsgType.PING, aiohttp.WSMsgType.PONG, aiohttp.WSMsgType.BINARY])
@played
async def test_a_flood_of_frames_ends_that_page_only(opcode: aiohttp.WSMsgType):
    async with rig() as run, run.open("watch") as good, run.open("watch") as bad:
        hand = struct.pack("<BBHfd", messages.HAND, 0, 0, 0.0, 0.0)
        for _ in range(2000):
            await bad.socket._writer.send_frame(hand, opcode)
        await until(lambda: bad.socket.closed)
        assert bad.socket.close_code == CloseCode.TOO_MANY_MESSAGES
        assert not good.socket.closed
        assert await good.hear("state", link="established")
