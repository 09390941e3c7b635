"""The two ends of a measurement beside peers, a process each.

``far NAME HOST`` hosts the scene, and prints ``ready`` and the process ids of its helpers. ``near NAME HOST`` waits for
a line on its standard input, connects and sends a position in each tick. It prints ``begin`` and ``end`` around the
window, waits for a line again, and writes what it saw to a file: each tick's time [µs], position [m], force held [N]
and age [µs] of the position that this force answers, and the round trips [µs].
"""

import argparse
import asyncio
import functools
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from flood_roles import MASTER_KEY, SLAVE_KEY
from stacks import DOORS, MESSAGE, PORT, STACKS

from hapticnet.node.events import NodeEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.runners import run_master
from hapticnet.runtime.system import SystemEntropy, now_us, prefer_realtime, run
from hapticnet.runtime.timer import Ticker
from hapticnet.runtime.udp import HostPort, open_toward
from hapticnet.runtime.watching import Watcher
from hapticnet.samples import PositionSample
from hapticnet.scene.sources import find_source

PAPER: Final = "paper:1"
"""The scene, unless another is asked for."""

PERIOD_US: Final = 1000
PERCENTILES: Final = (50, 99)


def wait_for_word() -> None:
    sys.stdin.readline()


def make_operator(arguments: argparse.Namespace) -> ScriptedOperator:
    motion = InsertionSettings(insertions=1000, **json.loads(arguments.motion))
    return ScriptedOperator(motion, np.random.default_rng(arguments.seed))


class Window:
    """Count ticks; announce when the window begins and ends; keep each tick."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.done = asyncio.Event()
        self.measuring = False
        self.ticks: list[tuple[int, float, float, int | None]] = []
        self._first = arguments.warm_up
        self._last = self._first + arguments.ticks
        self._seen = 0

    def tick(self, t_us: int, position_m: float, held_n: float, age_us: int | None) -> None:
        """Keep a tick, and begin or end the window."""
        self._seen += 1
        self.ticks.append((t_us, position_m, held_n, age_us))
        if self._seen == self._first:
            self.measuring = True
            print("begin", flush=True)
        elif self._seen == self._last:
            self.measuring = False
            print("end", flush=True)
            wait_for_word()
            self.done.set()

    def report(self, trips: Distribution) -> dict[str, Any]:
        """Return all ticks, including those before the window."""
        percentiles = {f"p{percent}": trips.percentile(percent) for percent in PERCENTILES}
        return {
            "ticks": self.ticks[: self._last],
            "warm_up": self._first,
            "trips_us": percentiles,
            "arrived": trips.count,
        }


async def far(name: str, host: str, scene_name: str) -> None:
    """Host the scene until ended by a signal."""
    scene = find_source(scene_name).make()

    def answer(data: bytes) -> bytes:
        t_us, position_m = MESSAGE.unpack(data)
        return MESSAGE.pack(t_us, scene.step(PositionSample(t_us, (position_m,))).force_n[0])

    serve, _ = (STACKS | DOORS)[name].coroutines()
    await serve(host, answer, lambda *helpers: print("ready", *helpers, flush=True))


async def near_stack(name: str, host: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Send positions over a stack, and hold the force that answers the newest one."""
    operator, window, trips, held = make_operator(arguments), Window(arguments), Distribution(), (-1, 0.0)
    start_us = 0
    _, connect = (STACKS | DOORS)[name].coroutines()

    def deliver(data: bytes) -> None:
        nonlocal held
        t_us, force_n = MESSAGE.unpack(data)
        if window.measuring:
            trips.add(now_us() - start_us - t_us)
        if t_us > held[0]:
            held = t_us, force_n

    wait_for_word()
    send = await connect(host, deliver)
    start_us = now_us()

    def tick(now: int) -> None:
        t_us = now - start_us
        (position_m,) = operator.sample(t_us).position_m
        send(MESSAGE.pack(t_us, position_m))
        answered_us, held_n = held
        window.tick(t_us, position_m, held_n, t_us - answered_us if answered_us >= 0 else None)

    ticker = Ticker(asyncio.get_running_loop(), PERIOD_US, tick)
    await window.done.wait()
    ticker.stop()
    return window.report(trips)


class Look(Watcher[NodeEvent]):
    """Keep each tick of a master, and its round trips within the window only."""

    def __init__(self, node: MasterNode, window: Window) -> None:
        self._node, self._window, self._start_us = node, window, 0

    def observe(self, now: int) -> None:
        node, window = self._node, self._window
        if node.position_m is None or window.done.is_set():
            return
        self._start_us = self._start_us or now
        applied, before = node._applied, window.measuring
        age_us = now - applied._valid_t_us if applied._stream.heard_us is not None else None  # as in the report
        window.tick(now - self._start_us, node.position_m[0], node.held_n[0], age_us)
        if window.measuring and not before:
            node.session.round_trip = Distribution()


async def near_hapticnet(host: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Send positions as a master of hapticnet."""
    settings = json.loads(arguments.settings)
    key = MasterKey(MASTER_KEY, SLAVE_KEY.public) if settings.pop("sealed") else None
    node = MasterNode(make_operator(arguments), None, MasterSettings(key=key, **settings), SystemEntropy())
    window = Window(arguments)
    sock, slave = open_toward(HostPort(host, PORT))
    wait_for_word()
    await run_master(node, sock, slave, watchers=[Look(node, window)], stop=window.done)
    return window.report(node.session.round_trip)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("end", choices=["far", "near"])
    parser.add_argument("stack", help="a stack by its name, or hapticnet (near only)")
    parser.add_argument("host", help="IPv4 address of the far end")
    parser.add_argument("--settings", default="{}", help="MasterSettings as JSON, and whether the session is sealed")
    parser.add_argument("--scene", default=PAPER, help="what the far end hosts")
    parser.add_argument("--motion", default="{}", help="InsertionSettings of the hand as JSON")
    parser.add_argument("--warm-up", type=int, default=500, help="ticks before the measurement")
    parser.add_argument("--ticks", type=int, default=4000, help="ticks that are measured")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument("--out", type=Path, help="file for what the near end saw")
    arguments = parser.parse_args()
    if arguments.real_time:
        prefer_realtime()
    if arguments.end == "far":
        run(far(arguments.stack, arguments.host, arguments.scene))
        return
    work = near_hapticnet if arguments.stack == "hapticnet" else functools.partial(near_stack, arguments.stack)
    report = run(work(arguments.host, arguments))
    arguments.out.write_text(json.dumps(report), encoding="utf-8")
    sys.stdout.flush()
    os._exit(0)  # without waiting for the threads of some stacks


if __name__ == "__main__":
    main()
