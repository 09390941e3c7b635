"""A slave, a master with a hand and its page on one event loop, and clients that speak to it as pages do."""

import asyncio
import functools
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import aiohttp
import numpy as np
import uvloop

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import ChannelSettings
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import Operator
from hapticnet.operator.live import LiveHand, LiveHandSettings
from hapticnet.protocol.handshake import Door
from hapticnet.protocol.wire import OPEN
from hapticnet.runtime.runners import run_master, run_slave
from hapticnet.runtime.system import SystemEntropy
from hapticnet.runtime.udp import HostPort, bound_address, host_of, listen, open_toward
from hapticnet.scene.base import Touchable
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import BodySceneSettings, SceneSettings
from hapticnet.scene.sources import find_scene
from hapticnet.web import messages
from hapticnet.web.access import Access, listen_for_pages
from hapticnet.web.controls import Controls
from hapticnet.web.messages import View
from hapticnet.web.page import Page, PageSettings
from hapticnet.web.server import Server

WITHIN_S = 30.0


@dataclass
class Rig:
    """What a test may look at."""

    node: MasterNode
    page: Page
    access: Access
    hand: LiveHand | None
    said: list[str]
    http: aiohttp.ClientSession
    stop: asyncio.Event

    def address(self, path: str) -> str:
        return f"http://{self.access.host}:{self.access.port}{path}"

    def open(self, view: View) -> "AbstractAsyncContextManager[Client]":
        """Connect as a page of this view does."""
        return connected(self.http, self.access, view, Client)


@dataclass
class Client:
    """A page: keeps what it was sent."""

    socket: aiohttp.ClientWebSocketResponse
    json: list[dict[str, Any]] = field(default_factory=list)
    frames: list[dict[str, Any]] = field(default_factory=list)
    blocks: list[tuple[int, float, np.ndarray]] = field(default_factory=list)
    raw: list[str | bytes] = field(default_factory=list)
    closed: bool = False
    reason: str = ""  # of the end, if one was given

    async def read(self) -> None:
        while (message := await self.socket.receive()).type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY):
            self.raw.append(message.data)
            if message.type is aiohttp.WSMsgType.TEXT:
                self.json.append(json.loads(message.data))
            elif message.data[0] == messages.FRAME:
                self.frames.append(read_frame(message.data))
            else:
                self.blocks.append(read_samples(message.data))
        self.closed, self.reason = True, message.extra or ""

    async def say(self, kind: str, **content: Any) -> None:
        await self.socket.send_str(json.dumps({"type": kind, **content}))

    async def move(self, position_m: float, *further_m: float, time_ms: float = 1.0) -> None:
        hand = struct.pack(f"<BBHfd{len(further_m)}f", messages.HAND, 0, 0, position_m, time_ms, *further_m)
        await self.socket.send_bytes(hand)

    def last(self, kind: str) -> dict[str, Any]:
        return next((each for each in reversed(self.json) if each["type"] == kind), {})

    async def hear(self, kind: str, **content: Any) -> dict[str, Any]:
        """Wait until the newest message of this type has this content."""
        await until(lambda: bool(self.last(kind)) and content.items() <= self.last(kind).items())
        return self.last(kind)

    def newest(self, column: str) -> np.ndarray:
        """Return a column of the newest block of samples."""
        return self.blocks[-1][2][messages.COLUMNS.index(column)]

    def columns(self) -> dict[str, np.ndarray]:
        """Return all samples by column, with the time since the server began."""
        parts = []
        for _, start_s, block in self.blocks:
            part = block.astype(np.float64)
            part[0] += start_s
            parts.append(part)
        return dict(zip(messages.COLUMNS, np.concatenate(parts, axis=1), strict=True))


AnyClient = TypeVar("AnyClient", bound=Client)


@asynccontextmanager
async def connected(
    http: aiohttp.ClientSession, access: Access, view: View, kind: type[AnyClient]
) -> AsyncIterator[AnyClient]:
    """Connect as a page of a view does."""
    place = f"http://{access.host}:{access.port}"
    query = f"/socket/{view}?token={access.tokens[view]}"
    async with http.ws_connect(place + query, headers={"Origin": place}) as socket:
        client = kind(socket)
        reader = asyncio.ensure_future(client.read())
        try:
            yield client
        finally:
            reader.cancel()


def read_frame(data: bytes) -> dict[str, Any]:
    kind, state, count, number, time_ms, tip_m = struct.unpack_from("<BBHIdf", data)
    rest = len(data) - 20 - 5 * count
    assert (kind, rest % 4) == (messages.FRAME, 0)
    surfaces = struct.unpack_from(f"<{count}f", data, 20)
    contacts = struct.unpack_from(f"<{count}B", data, 20 + 4 * count)
    return {
        "state": state, "number": number, "time_ms": time_ms, "tip_m": tip_m, "surfaces_m": surfaces,
        "contacts": contacts, "further": struct.unpack_from(f"<{rest // 4}f", data, 20 + 5 * count),
    }  # fmt: skip


def read_samples(data: bytes) -> tuple[int, float, np.ndarray]:
    kind, columns, rows, first, start_s = struct.unpack_from("<BBHId", data)
    assert (kind, len(data)) == (messages.SAMPLES, 16 + 4 * columns * rows)
    return first, start_s, np.frombuffer(data, dtype="<f4", offset=16).reshape(columns, rows)


async def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so; fail after `WITHIN_S`."""
    async with asyncio.timeout(WITHIN_S):
        while not condition():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def rig(
    *, scene: str | SceneSettings = "paper:1", operator: Operator | None = None, with_slave: bool = True
) -> AsyncIterator[Rig]:
    """Run slave, master and page; without an `operator`, the page is the hand."""
    found = find_scene(scene) if isinstance(scene, str) else scene
    axes = found.axes if isinstance(found, BodySceneSettings) else 1

    def make_scene() -> Touchable:
        if isinstance(found, BodySceneSettings):
            return BodyScene(found.bodies, name=found.name)
        return Scene(found.tissues, name=found.name)

    stop, said = asyncio.Event(), []
    slave = SlaveNode(lambda _: make_scene(), SlaveSettings(), SystemEntropy(), doors={OPEN: Door()}, host_of=host_of)
    slave_sock = listen(HostPort("127.0.0.1", 0))
    sock, address = open_toward(bound_address(slave_sock))
    hand = LiveHand(LiveHandSettings(axes=axes)) if operator is None else None
    node = MasterNode(operator or hand, None, MasterSettings(), SystemEntropy())
    plain = ChannelSettings()
    out: Emulator[Any] = Emulator(plain, np.random.default_rng(1))
    back: Emulator[Any] = Emulator(plain, np.random.default_rng(2))
    page_sock, access = listen_for_pages(HostPort("127.0.0.1", 0))
    page = Page(
        node,
        Controls(node, [(back, plain), (out, plain)]),
        PageSettings(
            source="page" if hand else "scripted", hand=hand, in_words=repr, say=said.append,
            operator_url=access.url("operator"), yields=hasattr(operator, "feel"),
        ),
    )  # fmt: skip
    runs: list[Awaitable[Any]] = [
        run_master(
            node, sock, address, stop=stop, channel=out, channel_in=back, tell=said.append,
            watchers=[Server(page, access, page_sock), page],
        )
    ]  # fmt: skip
    if with_slave:
        runs.append(run_slave(slave, slave_sock, stop=stop))
    tasks = [asyncio.ensure_future(run) for run in runs]
    try:
        async with aiohttp.ClientSession() as http:
            yield Rig(node, page, access, hand, said, http, stop)
    finally:
        stop.set()
        async with asyncio.timeout(WITHIN_S):
            await asyncio.gather(*tasks)
        slave_sock.close()


def played(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Run a test on a loop of its own."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(test(*args, **kwargs))

    return run
