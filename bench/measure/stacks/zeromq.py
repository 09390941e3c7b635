"""ZeroMQ: DEALER and ROUTER over TCP; its datagram sockets are not in the published wheels."""

import asyncio
from collections.abc import Callable

import zmq

from stacks import PORT, Answer, Deliver, Ready, Send


def watch(sock: "zmq.Socket[bytes]", take: Callable[[list[bytes]], None]) -> Callable[[], None]:
    """Call `take` with each message; call the returned function after each send: the descriptor signals edges."""

    def drain() -> None:
        while True:
            try:
                parts = sock.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            take(parts)

    asyncio.get_running_loop().add_reader(sock.getsockopt(zmq.FD), drain)
    return drain


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    sock = zmq.Context.instance().socket(zmq.ROUTER)
    sock.bind(f"tcp://{host}:{PORT}")
    drain = watch(sock, lambda parts: sock.send_multipart([parts[0], answer(parts[1])], zmq.NOBLOCK))
    drain()
    ready()
    await asyncio.Event().wait()


async def connect(host: str, deliver: Deliver) -> Send:
    sock = zmq.Context.instance().socket(zmq.DEALER)
    sock.setsockopt(zmq.LINGER, 0)
    sock.connect(f"tcp://{host}:{PORT}")
    drain = watch(sock, lambda parts: deliver(parts[-1]))

    def send(data: bytes) -> None:
        sock.send(data, zmq.NOBLOCK)
        drain()

    return send
