"""MQTT: paho and a mosquitto broker beside the far end; QoS 0, TCP_NODELAY."""

import asyncio
import ctypes
import signal
import socket
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from stacks import PORT, Answer, Deliver, Ready, Send

POSITIONS, FORCES = "touch/position", "touch/force"
PR_SET_PDEATHSIG = 1
BROKER = f"""
listener {PORT} 0.0.0.0
allow_anonymous true
set_tcp_nodelay true
user root
log_dest none
"""


async def joined(host: str, topic: str, take: Callable[[paho.Client, bytes], None]) -> paho.Client:
    """Return a client that is subscribed to a topic, and works on this event loop."""
    loop, subscribed = asyncio.get_running_loop(), asyncio.Event()
    client = paho.Client(CallbackAPIVersion.VERSION2)
    client.on_connect = lambda *_: client.subscribe(topic, qos=0)
    client.on_subscribe = lambda *_: subscribed.set()
    client.on_message = lambda _, __, message: take(client, message.payload)
    client.connect(host, PORT)
    sock = client.socket()
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def receive() -> None:
        client.loop_read()
        while client.want_write():  # messages published in a callback wait for this
            client.loop_write()

    async def keep() -> None:
        while True:
            client.loop_misc()
            await asyncio.sleep(1.0)

    loop.add_reader(sock.fileno(), receive)
    client.keeping = asyncio.ensure_future(keep())
    while client.want_write():
        client.loop_write()
    await subscribed.wait()
    return client


async def serve(host: str, answer: Answer, ready: Ready) -> None:
    def take(client: paho.Client, data: bytes) -> None:
        client.publish(FORCES, answer(data))

    prctl = ctypes.CDLL(None).prctl
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "mosquitto.conf"
        settings.write_text(BROKER)
        broker = subprocess.Popen(
            ["mosquitto", "-c", str(settings)], preexec_fn=lambda: prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        )
        for _ in range(100):
            try:
                await joined(host, POSITIONS, take)
            except ConnectionRefusedError:
                await asyncio.sleep(0.05)
            else:
                break
    ready(broker.pid)
    await asyncio.Event().wait()


async def connect(host: str, deliver: Deliver) -> Send:
    client = await joined(host, FORCES, lambda _, data: deliver(data))
    return lambda data: client.publish(POSITIONS, data)  # type: ignore[return-value]
