"""A plain TCP connection with TCP_NODELAY on uvloop."""

import asyncio
import socket
from collections.abc import Callable
from typing import cast

from stacks import MESSAGE, PORT, Answer, Deliver, Ready, Send


class Messages(asyncio.Protocol):
    """Cut the stream into messages, and pass them on with the transport."""

    def __init__(self, take: Callable[[asyncio.WriteTransport, bytes], None]) -> None:
        self._take = take
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.WriteTransport", transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def data_received(self, data: bytes) -> None:
        data = self._rest + data
        whole = len(data) - len(data) % MESSAGE.size
        for start in range(0, whole, MESSAGE.size):
            self._take(self._transport, data[start : start + MESSAGE.size])
        self._rest = data[whole:]


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    def take(transport: asyncio.WriteTransport, data: bytes) -> None:
        transport.write(answer(data))

    server = await asyncio.get_running_loop().create_server(lambda: Messages(take), host, PORT)
    ready()
    await server.serve_forever()


async def connect(host: str, deliver: Deliver) -> Send:
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_connection(lambda: Messages(lambda _, data: deliver(data)), host, PORT)
    return transport.write
