"""gRPC: one call that streams both ways, with bytes as messages."""

import asyncio
from collections.abc import AsyncIterator

import grpc

from stacks import PORT, Answer, Deliver, Ready, Send


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    async def touch(positions: AsyncIterator[bytes], _: object) -> AsyncIterator[bytes]:
        async for position in positions:
            yield answer(position)

    server = grpc.aio.server()
    handlers = {"Touch": grpc.stream_stream_rpc_method_handler(touch)}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("hapticnet", handlers),))
    server.add_insecure_port(f"{host}:{PORT}")
    await server.start()
    ready()
    await server.wait_for_termination()


async def connect(host: str, deliver: Deliver) -> Send:
    channel = grpc.aio.insecure_channel(f"{host}:{PORT}")
    await channel.channel_ready()
    call = channel.stream_stream("/hapticnet/Touch")()
    waiting: asyncio.Queue[bytes] = asyncio.Queue()

    async def write() -> None:
        while True:
            await call.write(await waiting.get())

    async def read() -> None:
        while (force := await call.read()) is not grpc.aio.EOF:
            deliver(force)

    tasks = [asyncio.ensure_future(write()), asyncio.ensure_future(read())]

    def send(data: bytes, _kept: object = (channel, tasks)) -> None:
        waiting.put_nowait(data)

    return send
