"""The processes of a measurement under a flood: a slave, a working master, and joining masters.

``slave`` prints its port. ``work PORT`` keeps one session and, for each line on its standard input, prints the round
trips since the last one. ``come PORT SECONDS`` connects again and again and prints how long each took.
"""

import argparse
import asyncio
import json
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hapticnet.node.events import NodeEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.states import Connected
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.runtime.runners import run_master, run_slave
from hapticnet.runtime.system import SystemEntropy, now_us, prefer_realtime, run
from hapticnet.runtime.udp import HostPort, bound_address, host_of, listen
from hapticnet.runtime.watching import Watcher
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

SLAVE_KEY: Final = PrivateKey(bytes(range(32)))
MASTER_KEY: Final = PrivateKey(bytes(range(1, 33)))
PERCENTILES: Final = (50, 99)
PAUSE_S: Final = 0.3
"""Time between two joining masters; the requests of one host are limited to five a second."""

PATIENCE_S: Final = 10.0


async def slave(*, sealed: bool) -> None:
    """Serve open or sealed sessions until ended by a signal."""
    sock = listen(HostPort("127.0.0.1", 0))
    rng = SystemEntropy()
    roster = Roster([MasterEntry(name="work", public=MASTER_KEY.public)])
    doors: dict[int, Door] = {SEALED: SealedDoor(SLAVE_KEY.private, roster, rng)} if sealed else {OPEN: Door()}
    scene = paper_scene(1)
    node = SlaveNode(
        lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(), rng, doors=doors, host_of=host_of
    )
    print(bound_address(sock).port, flush=True)
    await run_slave(node, sock)


def make_master(*, sealed: bool, rate_hz: float) -> MasterNode:
    """Return a master with an endless operator."""
    operator = ScriptedOperator(InsertionSettings(insertions=1000), np.random.default_rng(1))
    key = MasterKey(MASTER_KEY, SLAVE_KEY.public) if sealed else None
    return MasterNode(operator, None, MasterSettings(key=key, rate_hz=rate_hz), SystemEntropy())


async def work(port: int, *, sealed: bool) -> None:
    """Keep a session, and print the round trips [us] since the last line for each line read, until the input ends."""
    node = make_master(sealed=sealed, rate_hz=1000.0)
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()

    def mark() -> None:
        if not sys.stdin.readline():
            stop.set()
            return
        trips = node.session.round_trip
        values = {f"p{percent}": trips.percentile(percent) for percent in PERCENTILES}
        print(json.dumps({**values, "count": trips.count, "connections": counting.connections}), flush=True)
        node.session.round_trip = Distribution()

    counting = Counting()
    loop.add_reader(sys.stdin.fileno(), mark)
    await play(node, port, stop, None, [counting])


class Counting(Watcher[NodeEvent]):
    """Count the sessions."""

    def __init__(self) -> None:
        self.connections = 0

    def note(self, event: NodeEvent, now_us: int) -> None:  # noqa: ARG002
        self.connections += isinstance(event, Connected)


async def come(port: int, seconds: float, *, sealed: bool) -> None:
    """Connect again and again; print for each the time [s] until the first answer to a position, or null."""
    end_s = time.monotonic() + seconds
    number = 0
    while time.monotonic() < end_s:
        number += 1
        node = make_master(sealed=sealed, rate_hz=200.0)
        stop = asyncio.Event()
        started_us = now_us()

        def check(node: MasterNode = node, stop: asyncio.Event = stop) -> None:
            if node.session.round_trip.count:
                stop.set()

        poll = asyncio.ensure_future(polling(check))
        await play(node, port, stop, PATIENCE_S, (), host=f"127.0.1.{number % 250 + 1}")
        poll.cancel()
        took_s = (now_us() - started_us) / 1e6 if node.session.round_trip.count else None
        print(json.dumps(took_s), flush=True)
        await asyncio.sleep(PAUSE_S)


async def polling(check: Any) -> None:
    while True:
        check()
        await asyncio.sleep(0.005)


async def play(
    node: MasterNode,
    port: int,
    stop: asyncio.Event,
    duration_s: float | None,
    watchers: Sequence[Watcher[NodeEvent]],
    *,
    host: str = "127.0.0.1",
) -> None:
    """Run a master from a host of 127/8."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind((host, 0))
    await run_master(
        node,
        sock,
        ("127.0.0.1", port),
        duration_s=duration_s,
        connect_timeout_s=duration_s,
        watchers=watchers,
        stop=stop,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["slave", "work", "come"])
    parser.add_argument("port", type=int, nargs="?", default=0)
    parser.add_argument("seconds", type=float, nargs="?", default=0.0)
    parser.add_argument("--sealed", action="store_true")
    parser.add_argument("--real-time", action="store_true")
    arguments = parser.parse_args()
    if arguments.real_time and arguments.role != "come":
        prefer_realtime()
    if arguments.role == "slave":
        run(slave(sealed=arguments.sealed))
    elif arguments.role == "work":
        run(work(arguments.port, sealed=arguments.sealed))
    else:
        run(come(arguments.port, arguments.seconds, sealed=arguments.sealed))


if __name__ == "__main__":
    main()
