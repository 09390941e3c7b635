"""What one HELLO, one first position and one tick cost a slave that has few or many sessions: they must not grow."""

import argparse
import statistics
import struct
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import record

from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_settings import SlaveSettings
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Request
from hapticnet.protocol.settings import SessionSettings
from hapticnet.scene.presets import paper_scene
from hapticnet.scene.scene import Scene

REQUEST = Request("deadband", {}, 0.1, 0.02, 1.0, 1000.0, 1, "master")
PAUSE_US = 20_000
"""Time between two requests, so that the limit on strangers' requests drops none."""


class Crowd:
    """A slave whose masters have a host each."""

    def __init__(self, sessions: int, rng: np.random.Generator) -> None:
        scene = paper_scene(1)
        self.rng = rng
        self.now_us = 1_000_000
        timings = SessionSettings(most_sessions=sessions, gives_way_us=300_000_000, keep_us=600_000_000)
        self.slave = SlaveNode(lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(session=timings), rng)
        self.masters: dict[str, MasterSession] = {}
        for number in range(sessions):
            self.pass_on(self.newcomer(f"host {number}"))
            self.position(f"host {number}")

    def pass_on(self, address: str) -> float:
        """Deliver what a master sends, and the answers; return the time of the last datagram [µs]."""
        taken_us = 0.0
        while sent := self.masters[address].datagrams_to_send():
            for data in sent:
                taken_us = timed(partial(self.slave.receive_datagram, data, address, self.now_us))
            for data, to in self.slave.datagrams_to_send():
                self.masters[str(to)].receive_datagram(data, self.now_us)
        while self.slave.next_event() is not None:
            pass
        return taken_us

    def newcomer(self, address: str) -> str:
        """Let a master begin to ask; return its address."""
        self.now_us += PAUSE_US
        self.masters[address] = MasterSession(REQUEST, SessionSettings(), self.rng)
        self.masters[address].tick(self.now_us)
        return address

    def position(self, address: str) -> float:
        """Let a master send a position; return the time that it took the slave [µs]."""
        self.masters[address].send_position(self.now_us, struct.pack(">f", 0.001))
        return self.pass_on(address)


def timed(call: Callable[[], object]) -> float:
    """Return how long a call takes [µs]."""
    start_ns = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - start_ns) / 1e3


def costs_us(sessions: int, repetitions: int, rng: np.random.Generator) -> dict[str, float]:
    """Return the medians [µs] with so many sessions beside the one that comes."""
    crowd = Crowd(sessions + 1, rng)
    first, *others = crowd.masters
    times: dict[str, list[float]] = {"HELLO, no free place": [], "HELLO": [], "first position": [], "tick": []}
    for number in range(repetitions):
        crowd.position(others[number % len(others)])
        times["HELLO, no free place"].append(crowd.pass_on(crowd.newcomer(f"stranger {number}")))
    crowd.masters[first].close("done", crowd.now_us)
    crowd.pass_on(first)
    for number in range(repetitions):
        guest = crowd.newcomer(f"guest {number}")
        times["HELLO"].append(crowd.pass_on(guest))
        times["first position"].append(crowd.position(guest))
        crowd.masters[guest].close("done", crowd.now_us)
        crowd.pass_on(guest)
        times["tick"].append(timed(partial(crowd.slave.tick, crowd.now_us)))
        if number % 10 == 0:
            for address in others:
                crowd.position(address)
    assert len(crowd.slave.stations) == sessions, f"{len(crowd.slave.stations)} sessions instead of {sessions}"
    return {name: statistics.median(values) for name, values in times.items()}


def measure(arguments: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return the costs by the number of sessions."""
    rng = np.random.default_rng(arguments.seed)
    return {str(sessions): costs_us(sessions, arguments.repetitions, rng) for sessions in arguments.sessions}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--sessions", type=record.within(1), nargs="+", default=(10, 100, 1_000))
    parser.add_argument("--repetitions", type=record.within(1), default=100)
    record.run(parser, measure, unit="µs, medians, by the number of present sessions")


if __name__ == "__main__":
    main()
