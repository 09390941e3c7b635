"""The smallest master and the smallest slave, with the real ones and with each other, in virtual time and live."""

import contextlib
import importlib
import re
import socket
import sys
import threading
from itertools import count, product
from pathlib import Path
from types import SimpleNamespace

import msgpack
import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import UserOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue

EXAMPLES = Path(__file__).parents[2] / "examples"
NETWORKS = [
    "delay=0ms",
    "delay=10ms",
    "delay=25ms,jitter=normal:5ms,loss=10%",
    "delay=60ms,jitter=normal:20ms,reorder=5%,duplicate=5%",
]
MASTERS = ["smallest", "raw", "deadband"]
SLAVES = ["smallest", "hapticnet"]
PAIRS = [pair for pair in product(MASTERS, SLAVES) if "smallest" in pair]
HERE = ("127.0.0.1", 50_000)
SEEDS = count(1)
START_US = 2**32 - 1_500_000  # time stamps wrap


@pytest.fixture
def small(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return lambda name: importlib.import_module(f"smallest_{name}")


def place_m(t_us):
    """Return where the hand is: it goes in within a second and stays at 30 mm."""
    return 0.03 * min(t_us / 1e6, 1.0)


class SmallMaster:
    def __init__(self, small):
        self.master = small("master").Master()
        self.outbox = []

    def tick(self, now_us):
        self.outbox.append(self.master.send(place_m(now_us - START_US), now_us))
        self.force_n = self.master.felt(now_us)

    def receive(self, data, now_us):
        self.outbox.append(self.master.receive(data, now_us))

    def to_send(self):
        outbox, self.outbox = self.outbox, []
        return [data for data in outbox if data]


class RealMaster:
    def __init__(self, codec):
        hand = SimpleNamespace(axes=1, sample=place_m)
        rng = np.random.default_rng(next(SEEDS))
        self.node = MasterNode(UserOperator(hand), None, MasterSettings(codec=codec), rng)
        self.receive, self.to_send = self.node.receive_datagram, self.node.datagrams_to_send

    def tick(self, now_us):
        self.node.tick(now_us)
        self.node.drive(now_us)
        (self.force_n,) = self.node.held_n


def make_master(name, small):
    return SmallMaster(small) if name == "smallest" else RealMaster(name)


def make_slave(name, small):
    """Return a function that passes a datagram to a slave and returns the answers."""
    if name == "smallest":
        slave = small("slave").Slave(small("slave").spring)

        def answer(data, address, now_us):
            return [each for each in [slave.receive(data, address, now_us)] if each]
    else:
        tissue = Tissue(name="spring", rest_position_m=0.02, stiffness_n_per_m=300.0, breach_force_n=1e6)
        node = SlaveNode(lambda _: Scene((tissue,)), SlaveSettings(), np.random.default_rng(4))

        def answer(data, address, now_us):
            node.receive_datagram(data, address, now_us)
            return [data for data, to in node.datagrams_to_send() if to == address]

    return answer


def run(master, slave, network, milliseconds, start_ms=0):
    """Join both; return the largest force that was felt."""
    forward, back = (Emulator(parse_channel(network), np.random.default_rng([5, way])) for way in (0, 1))
    largest_n = 0.0
    for now_us in range(START_US + 1000 * start_ms, START_US + 1000 * (start_ms + milliseconds), 1000):
        master.tick(now_us)
        for data in master.to_send():
            forward.push(data, len(data), now_us)
        for data in forward.due(now_us):
            for answer in slave(data, HERE, now_us):
                back.push(answer, len(answer), now_us)
        for data in back.due(now_us):
            master.receive(data, now_us)
        for data in master.to_send():
            forward.push(data, len(data), now_us)
        largest_n = max(largest_n, abs(master.force_n))
    return largest_n


def test_the_smallest_peers_stand_alone_and_are_named_in_the_page():
    page = (EXAMPLES.parent / "docs" / "refer" / "protocol.md").read_text()
    for file in EXAMPLES.glob("smallest_*.py"):
        text = file.read_text()
        assert set(re.findall(r"^(?:from|import) (\w+)", text, re.MULTILINE)) <= {
            *sys.stdlib_module_names,
            "smallest_msgpack",
        }
        assert f"examples/{file.name}" in page


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize(("master_name", "slave_name"), PAIRS)
def test_the_smallest_peers_work_with_the_real_ones(small, network, master_name, slave_name):
    master = make_master(master_name, small)
    largest_n = run(master, make_slave(slave_name, small), network, 3000)
    assert master.force_n == pytest.approx(3.0, abs=0.16), "within a JND of the force of the spring"
    assert largest_n <= 3.16


@pytest.mark.parametrize("slave_name", SLAVES)
def test_the_smallest_master_fades_without_answers_and_comes_back(small, slave_name):
    master, slave = make_master("smallest", small), make_slave(slave_name, small)
    run(master, slave, "delay=5ms", 2000)
    assert master.force_n == pytest.approx(3.0, abs=0.16)
    run(master, lambda *_: [], "delay=5ms", 320, 2000)
    assert master.force_n == 0.0
    run(master, lambda *_: [], "delay=5ms", 2000, 2320)
    assert master.master.session == 0
    run(master, slave, "delay=5ms", 1500, 4320)
    assert master.force_n == pytest.approx(3.0, abs=0.16)


@pytest.mark.parametrize("master_name", MASTERS)
def test_the_smallest_slave_serves_a_master_that_comes_back(small, master_name):
    slave = make_slave("smallest", small)
    run(make_master(master_name, small), slave, "delay=5ms", 500)
    again = make_master(master_name, small)
    run(again, slave, "delay=5ms", 2500, 2500)
    assert again.force_n == pytest.approx(3.0, abs=0.16)


def test_the_smallest_slave_refuses_what_it_does_not_serve_in_words(small):
    slave = make_slave("smallest", small)
    for settings, code in [({"codec": "linear-predictive"}, 2), ({"codec": "deadband"}, None)]:
        master = RealMaster(settings["codec"])
        run(master, slave, "delay=1ms", 300)
        assert master.node.refused is (code is not None)
    other = RealMaster("deadband")
    run(other, slave, "delay=1ms", 300, 301)
    assert other.node.end_reason == "the place is taken"


def test_no_datagram_stops_the_smallest_peers(small):
    rng = np.random.default_rng(6)
    junk = [None, True, -1, 2**40, 1.5, float("nan"), "x", b"y", b"", [], {}, {"a": 1}, [1] * 9]
    slave, master = make_slave("smallest", small), make_master("smallest", small)
    seen = []

    def watched(data, address, now_us):
        answers = slave(data, address, now_us)
        seen.extend([data, *answers])
        return answers

    run(master, watched, "delay=1ms", 500)
    for number in range(30_000):
        frame = msgpack.unpackb(seen[rng.integers(len(seen))])
        body = msgpack.unpackb(frame[4])
        spoilt = [frame, body][rng.integers(2)]
        spoilt[rng.integers(len(spoilt))] = junk[rng.integers(len(junk))]
        frame[4] = msgpack.packb(body) if spoilt is body else frame[4]
        data = bytearray(msgpack.packb(frame))
        if number % 3 == 0:
            data[rng.integers(len(data))] = rng.integers(256)
        now_us = START_US + 500_000 + number
        for answer in slave(bytes(data), HERE, now_us):
            assert len(answer) <= len(data), "no more than was received"
        with contextlib.suppress(ConnectionError):
            master.receive(bytes(data), now_us)
        assert abs(master.master.felt(now_us)) <= 5.0
    run(master, slave, "delay=1ms", 4000, 5000)
    assert master.force_n == pytest.approx(3.0, abs=0.16)


def test_msgpack_of_the_smallest_peers_is_msgpack(small):
    rng = np.random.default_rng(7)
    numbers = [0, 127, 128, 255, 256, 65_535, 65_536, 2**32 - 1, 2**32, 2**63]
    values = [None, True, False, *numbers, 0.1, -1e300, "", "ä" * 15, b"", b"x" * 255, b"x" * 1000, {}, {"a": 1.0}, []]
    for value in [*values, values[:15], {"a": values[:15]}]:
        assert small("msgpack").packb(value) == msgpack.packb(value)
        assert small("msgpack").unpackb(msgpack.packb(value)) == value
    for value in [-1, -33, -1000, -(2**40), "x" * 200, np.float32(1.5)]:
        assert small("msgpack").unpackb(msgpack.packb(value, default=float)) == value
    assert small("msgpack").unpackb(msgpack.packb(1.5, use_single_float=True)) == 1.5
    for _ in range(20_000):
        data = rng.bytes(rng.integers(1, 12))
        try:
            found = small("msgpack").unpackb(data)
        except small("msgpack").UNREADABLE:
            continue
        assert repr(found) == repr(msgpack.unpackb(data, strict_map_key=False))


def test_the_smallest_peers_run_live(small):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    thread = threading.Thread(target=small("slave").main, args=(port, 2.0))
    thread.start()
    try:
        assert small("master").main(f"127.0.0.1:{port}", 1.0) == pytest.approx(3.0, abs=0.3)
    finally:
        thread.join()
