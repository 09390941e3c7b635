"""What newcomers and strangers cost a slave: CPU for each kind of datagram, memory for a session, room in its socket.

Each cost is the least of several turns in a loop over one node, without the kernel's part: a lower bound.
"""

import gc
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from hapticnet.node.admission import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.perception import WeberLaw
from hapticnet.protocol.handshake import Attempt, Door, OpenAttempt, OpenDoor, SealedAttempt, SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.messages import Position, Request, pack_position, unpack_cookie, unpack_welcome
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, unpack
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.udp import HostPort, listen
from hapticnet.scene.presets import paper_scene
from hapticnet.scene.scene import Scene

SLAVE_KEY: Final = PrivateKey(bytes(range(32)))
MASTER_KEY: Final = PrivateKey(bytes(range(1, 33)))
SPACING_US: Final = 20_000
"""Time between two requests: all of them are read."""

TURNS: Final = 5

Address = tuple[str, int]


def request(rate_hz: float, name: str) -> Request:
    """Return the request of a master without an operator: `deadband` at 1 JND, one axis, every position."""
    law = WeberLaw()
    return Request(
        codec="deadband",
        parameters={},
        weber_fraction=law.weber_fraction,
        floor_n=law.floor_n,
        multiplier=law.multiplier,
        rate_hz=rate_hz,
        axes=1,
        name=name,
        ticket=None,
        clock_us=0,
        announced=False,
        position_share=0.0,
    )


class Node:
    """A slave's node with room for any number of sessions, and masters' datagrams for it."""

    def __init__(self, *, sealed: bool) -> None:
        scene, rng = paper_scene(1), SystemEntropy()
        roster = Roster([MasterEntry(name="one", public=MASTER_KEY.public)])
        doors: dict[int, Door] = {SEALED: SealedDoor(SLAVE_KEY.private, roster, rng)} if sealed else {OPEN: OpenDoor()}
        session = SessionSettings(most_sessions=1 << 20, most_per_identity=1 << 20)
        self.node = SlaveNode(
            lambda _: Scene(scene.tissues, name=scene.name),
            SlaveSettings(session=session),
            rng,
            doors=doors,
            host_of=lambda address: address,
        )
        self.now_us = 0
        self._sealed = sealed
        self._rng = rng
        self._made = 0

    def attempt(self) -> tuple[Attempt, Address]:
        """Return a new master's attempt, and its address."""
        self._made += 1
        key = MasterKey(MASTER_KEY, SLAVE_KEY.public)
        asked = request(1000.0, f"m{self._made}")
        nonce = self._made
        made = SealedAttempt(asked, nonce, 0, key, self._rng) if self._sealed else OpenAttempt(asked, nonce, 0)
        return made, (f"127.0.{self._made // 250}.{self._made % 250 + 1}", 40_000)

    def answers(self, data: bytes, address: Address) -> list[bytes]:
        """Return the answers to a datagram."""
        self.node.receive_datagrams([(data, address)], self.now_us)
        self.node.settle(self.now_us)
        return [answer for answer, _ in self.node.datagrams_to_send()]

    def cookie_hello(self, attempt: Attempt, address: Address) -> bytes:
        """Return the HELLO with the cookie that answers the first one."""
        (answer,) = self.answers(attempt.hello(b""), address)
        return attempt.hello(unpack_cookie(unpack(answer).body).cookie)

    def seat(self, count: int) -> None:
        """Open so many sessions."""
        for _ in range(count):
            self.now_us += SPACING_US
            attempt, address = self.attempt()
            welcome = unpack(self.answers(self.cookie_hello(attempt, address), address)[0])
            body = pack_position(Position(0, None, bytes(4)))
            if self._sealed:
                _, seal = attempt.read(unpack_welcome(welcome.body).grant)
                assert seal is not None
                position = seal.pack(Kind.POSITION, welcome.session, 1, body)
            else:
                position = pack(Kind.POSITION, welcome.session, 1, body)
            self.answers(position, address)
        while self.node.next_event() is not None:
            pass
        assert all(station.seated for station in self.node.stations)


def datagram_costs(sessions: int, *, sealed: bool, count: int = 60) -> dict[str, float]:
    """Return the CPU time [µs] of a node with so many sessions for each kind of datagram from outside of them."""
    node = Node(sealed=sealed)
    node.seat(sessions)

    def turn(prepare: Callable[[], tuple[bytes, Address]], spacing_us: int) -> float:
        prepared = [prepare() for _ in range(count)]
        taken_ns = 0
        for data, address in prepared:
            node.now_us += spacing_us
            began_ns = time.thread_time_ns()
            node.node.receive_datagrams([(data, address)], node.now_us)
            taken_ns += time.thread_time_ns() - began_ns
            node.node.datagrams_to_send()
        return taken_ns / count / 1e3

    def first() -> tuple[bytes, Address]:
        attempt, address = node.attempt()
        return attempt.hello(b""), address

    def second() -> tuple[bytes, Address]:
        attempt, address = node.attempt()
        return node.cookie_hello(attempt, address), address

    def stray() -> tuple[bytes, Address]:
        body = pack_position(Position(0, None, bytes(4)))
        return pack(Kind.POSITION, 1 << 31, 1, body, SEALED if sealed else OPEN), ("127.9.9.9", 40_000)

    costs = {
        "cookie_us": min(turn(first, SPACING_US) for _ in range(TURNS)),
        "admit_us": min(turn(second, SPACING_US) for _ in range(TURNS)),
        "reset_us": min(turn(stray, SPACING_US) for _ in range(TURNS)),
    }
    throttled = node.node.throttled
    turn(second, 0)  # uses the tokens up
    costs["drop_us"] = min(turn(second, 0) for _ in range(TURNS))
    assert node.node.throttled >= throttled + TURNS * count
    return costs


def memory_per_session(sessions: int, *, sealed: bool) -> float:
    """Return by how many bytes a fresh process grows for each session of a node."""
    command = [sys.executable, __file__, str(sessions), str(int(sealed))]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def growth(sessions: int, *, sealed: bool) -> float:
    """Return by how many bytes this process grows for each session of a node."""
    node = Node(sealed=sealed)
    node.seat(20)
    gc.collect()
    before = private_bytes(Path("/proc/self/smaps_rollup"))
    node.seat(sessions)
    gc.collect()
    return (private_bytes(Path("/proc/self/smaps_rollup")) - before) / sessions


def private_bytes(rollup: Path) -> int:
    """Return the memory of a process that no other shares."""
    return 1024 * sum(int(kib) for kib in re.findall(r"Private_\w+:\s+(\d+) kB", rollup.read_text()))


def queue_datagrams() -> int:
    """Return how many HELLOs wait in a slave's socket before the system drops the next."""
    node = Node(sealed=False)
    attempt, _ = node.attempt()
    hello = attempt.hello(bytes(16))
    with listen(HostPort("127.0.0.1", 0)) as sock, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(20_000):
            sender.sendto(hello, sock.getsockname())
        return _drain(sock)


def _drain(sock: socket.socket) -> int:
    count = 0
    try:
        while True:
            sock.recv(2048)
            count += 1
    except BlockingIOError:
        return count


if __name__ == "__main__":
    print(growth(int(sys.argv[1]), sealed=bool(int(sys.argv[2]))))
