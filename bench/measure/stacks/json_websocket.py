"""A JSON object in a WebSocket message each way: aiohttp at both ends, TCP_NODELAY (its default), no compression."""

import asyncio
import json

import aiohttp
from aiohttp import web

from stacks import MESSAGE, PORT, Answer, Deliver, Ready, Send


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    async def handle(request: web.Request) -> web.WebSocketResponse:
        sock = web.WebSocketResponse(compress=False)
        await sock.prepare(request)
        async for message in sock:
            asked = json.loads(message.data)
            t_us, force_n = MESSAGE.unpack(answer(MESSAGE.pack(asked["t_us"], asked["position_m"][0])))
            await sock.send_str(json.dumps({"t_us": t_us, "force_n": [force_n]}))
        return sock

    app = web.Application()
    app.router.add_get("/", handle)
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, host, PORT).start()
    ready()
    await asyncio.Event().wait()


async def connect(host: str, deliver: Deliver) -> Send:
    session = aiohttp.ClientSession()
    sock = await session.ws_connect(f"http://{host}:{PORT}/")
    tasks: set[asyncio.Task[None]] = set()  # the loop itself keeps no task alive

    def start(work: "asyncio.Task[None]") -> None:
        tasks.add(work)
        work.add_done_callback(tasks.discard)

    async def listen() -> None:
        async for message in sock:
            said = json.loads(message.data)
            deliver(MESSAGE.pack(said["t_us"], said["force_n"][0]))

    def send(data: bytes) -> None:
        t_us, position_m = MESSAGE.unpack(data)
        start(asyncio.ensure_future(sock.send_str(json.dumps({"t_us": t_us, "position_m": [position_m]}))))

    start(asyncio.ensure_future(listen()))
    return send
