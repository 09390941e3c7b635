"""The limit of a round trip in Python: two uvloop processes that do nothing but send a datagram and send it back.

``server`` prints its port and echoes; ``client PORT SECONDS`` sends 32 bytes a thousand times a second and prints each
round trip [us], one a line. Both wait for arrivals with `add_reader` on a non-blocking socket, as hapticnet does.
"""

import asyncio
import socket
import sys

from hapticnet.runtime.system import now_us, prefer_realtime, run
from hapticnet.runtime.timer import Ticker


async def server() -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    print(sock.getsockname()[1], flush=True)

    def echo() -> None:
        while True:
            try:
                data, address = sock.recvfrom(2048)
            except BlockingIOError:
                return
            sock.sendto(data, address)

    asyncio.get_running_loop().add_reader(sock.fileno(), echo)
    await asyncio.Event().wait()


async def client(port: int, seconds: float) -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", port))
    sock.setblocking(False)
    loop = asyncio.get_running_loop()
    trips: list[int] = []
    payload = bytes(24)

    def receive() -> None:
        while True:
            try:
                data = sock.recv(2048)
            except BlockingIOError:
                return
            trips.append(now_us() - int.from_bytes(data[:8], "big"))

    loop.add_reader(sock.fileno(), receive)
    ticker = Ticker(loop, 1000, lambda _: sock.send(now_us().to_bytes(8, "big") + payload))
    await asyncio.sleep(seconds)
    ticker.stop()
    sys.stdout.write("\n".join(map(str, trips)))


if __name__ == "__main__":
    if "--real-time" in sys.argv:
        prefer_realtime()
        sys.argv.remove("--real-time")
    run(server() if sys.argv[1] == "server" else client(int(sys.argv[2]), float(sys.argv[3])))
