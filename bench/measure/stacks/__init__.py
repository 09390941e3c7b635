"""The same work over several stacks: positions one way, forces the other, one small module for each stack.

Each module has two coroutines. ``serve(host, answer, ready)`` answers each message until the process ends, and calls
``ready`` with the process ids of helpers once it can be reached. ``connect(host, deliver)`` returns a function that
sends a message; ``deliver`` is called with each answer, from any thread.

Messages are 8 bytes: a time stamp and a float32 (`MESSAGE`).
"""

import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from shutil import which
from typing import Any, Final, TypeAlias

MESSAGE: Final = struct.Struct("<If")
"""Time stamp [µs] since the start of the near end, and position [m] or force [N]."""

PORT: Final = 47900
"""Port of every stack; each measurement has its own network namespaces."""

Answer: TypeAlias = Callable[[bytes], bytes]
Deliver: TypeAlias = Callable[[bytes], None]
Send: TypeAlias = Callable[[bytes], None]
Ready: TypeAlias = Callable[..., None]
Serve: TypeAlias = Callable[[str, Answer, Ready], Awaitable[None]]
Connect: TypeAlias = Callable[[str, Deliver], Awaitable[Send]]


@dataclass(frozen=True, slots=True)
class Stack:
    """A stack's module, the settings of its coroutines, and the package and the program that it needs."""

    module: str
    package: str | None = None
    program: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def missing(self) -> str | None:
        """The requirement that this machine lacks; None if the stack can run."""
        if self.package is not None and find_spec(self.package.partition(".")[0]) is None:
            return f"the package {self.package}"
        if self.program is not None and which(self.program) is None:
            return f"the program {self.program}"
        return None

    def coroutines(self) -> tuple[Serve, Connect]:
        """Return ``serve`` and ``connect``."""
        found = import_module(f"stacks.{self.module}")
        return partial(found.serve, **self.settings), partial(found.connect, **self.settings)


STACKS: Final = {
    "UDP": Stack("udp"),
    "TCP": Stack("tcp"),
    "ZeroMQ": Stack("zeromq", "zmq"),
    "Zenoh, UDP": Stack("zenoh_peer", "zenoh", settings={"transport": "udp"}),
    "Zenoh, TCP": Stack("zenoh_peer", "zenoh", settings={"transport": "tcp"}),
    "QUIC datagrams": Stack("quic", "aioquic"),
    "WebRTC data channel": Stack("webrtc", "aiortc"),
    "gRPC stream": Stack("grpc_stream", "grpc"),
    "MQTT": Stack("mqtt", "paho.mqtt", "mosquitto"),
}

DOORS: Final = {
    "LeRobot loop, 30 Hz": Stack("json_zeromq", "zmq", settings={"hz": 30.0}),
    "LeRobot loop, 60 Hz": Stack("json_zeromq", "zmq", settings={"hz": 60.0}),
    "ROS 2 topics": Stack("ros2_topics", "cyclonedds"),
    "JSON WebSocket": Stack("json_websocket", "aiohttp"),
}
"""What communities use where hapticnet has a door, for bench/measure/doors.py."""
