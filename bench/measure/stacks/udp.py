"""A bare UDP socket on uvloop: the limit of everything else."""

import asyncio
import socket

from stacks import PORT, Answer, Deliver, Ready, Send


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind((host, PORT))
    sock.setblocking(False)

    def receive() -> None:
        while True:
            try:
                data, address = sock.recvfrom(2048)
            except BlockingIOError:
                return
            sock.sendto(answer(data), address)

    asyncio.get_running_loop().add_reader(sock.fileno(), receive)
    ready()
    await asyncio.Event().wait()


async def connect(host: str, deliver: Deliver) -> Send:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect((host, PORT))
    sock.setblocking(False)

    def receive() -> None:
        while True:
            try:
                data = sock.recv(2048)
            except BlockingIOError:
                return
            deliver(data)

    asyncio.get_running_loop().add_reader(sock.fileno(), receive)
    return sock.send
