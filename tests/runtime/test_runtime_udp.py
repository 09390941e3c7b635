"""Addresses, floods, and the ages of datagrams in the queue of a socket."""

import select
import socket
import struct

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.errors import SettingsError
from hapticnet.runtime import udp
from hapticnet.runtime.udp import DRAIN_US, ReceiveQueue, UdpPort, listen, parse_host_port


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("127.0.0.1:47800", "127.0.0.1", 47800), ("[::1]:1", "::1", 1), ("slave.lab:65535", "slave.lab", 65535)],
)
def test_addresses_are_read_and_written_alike(text, host, port):
    address = parse_host_port(text)
    assert (address.host, address.port) == (host, port)
    assert str(address) == text


@pytest.mark.parametrize(
    "text", ["", "host", ":1", "host:", "host:0", "host:65536", "host:-1", "host:1.5", "::1:5", "h:١"]
)
def test_invalid_addresses_are_refused(text):
    with pytest.raises(SettingsError):
        parse_host_port(text)


class Turns:
    """A loop whose turns a test makes, on a clock that goes on by 100 µs with each datagram that is handed over."""

    def __init__(self, monkeypatch):
        self.now_us, self.readers, self.taken = 1, {}, []
        monkeypatch.setattr(udp, "now_us", lambda: self.now_us)

    def add_reader(self, number, callback):
        self.readers[number] = callback

    def remove_reader(self, number):
        del self.readers[number]

    def receive(self, batch, _):
        self.taken += [data for data, _ in batch]
        self.now_us += 100 * len(batch)

    def turn(self):
        """Let everything that waits have its turn; return how many datagrams are handed over."""
        before = len(self.taken)
        for number in select.select(list(self.readers), [], [], 1.0)[0]:
            self.readers[number]()
        return len(self.taken) - before


@pytest.fixture
def flooded(monkeypatch):
    """Return a function that makes a port, to which 20 datagrams have been sent, and its loop."""
    loop, ports = Turns(monkeypatch), []

    def make(**chosen):
        sock = listen(parse_host_port("127.0.0.1:0", lowest_port=0))
        ports.append(UdpPort(loop, sock, loop.receive, **chosen))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(20):
                sender.sendto(bytes([number]), sock.getsockname())
        return loop

    yield make
    for port in ports:
        port.close()


@pytest.mark.parametrize("emulated", [False, True])
def test_a_flood_at_a_master_leaves_the_loop_to_others_again_and_again(flooded, emulated):
    channel = Emulator(parse_channel("perfect"), np.random.default_rng(1)) if emulated else None
    loop = flooded(at_once=True, channel_in=channel)
    while len(loop.taken) < 20:
        assert 1 <= loop.turn() <= DRAIN_US // 100
    assert loop.taken == [bytes([number]) for number in range(20)]


def test_a_slave_takes_in_what_has_queued_up_as_one_batch(flooded):
    assert flooded().turn() == 20


HOUR_US = 3_600_000_000
TIMESTAMPNS = 35


class Clocks:
    """A wall clock that can be set, and a monotonic one; both stand still unless moved."""

    def __init__(self):
        self.us, self.set_by_us = 10_000_000, 0

    def time_ns(self):
        return 1000 * (self.us + self.set_by_us)

    def monotonic_ns(self):
        return 1000 * self.us


class Socket:
    """A queue of datagrams with the stamps of the wall clock at which they came."""

    def __init__(self, clocks):
        self.clocks, self.stamps_ns = clocks, []

    def setsockopt(self, *_):
        pass

    def come(self):
        self.stamps_ns.append(self.clocks.time_ns())

    def recvmsg(self, *_):
        if not self.stamps_ns:
            raise BlockingIOError
        return b"", [(socket.SOL_SOCKET, TIMESTAMPNS, struct.pack("=qq", *divmod(self.stamps_ns[0], 10**9)))], 0, None


@pytest.fixture
def clocks(monkeypatch):
    clocks = Clocks()
    monkeypatch.setattr(udp, "time", clocks)
    return clocks


def test_the_age_is_the_time_that_the_oldest_datagram_has_waited(clocks):
    sock = Socket(clocks)
    queue = ReceiveQueue(sock)
    for waited_us in (0, 50, 300_000):
        sock.come()
        clocks.us += waited_us
        queue.sample_age()
        sock.stamps_ns.clear()
    assert queue.take_ages() == [0, 50, 300_000]


@pytest.mark.parametrize("set_by_us", [HOUR_US, -HOUR_US, 40_000, -40_000])
def test_an_age_that_only_a_set_clock_explains_does_not_count(clocks, set_by_us):
    sock = Socket(clocks)
    queue = ReceiveQueue(sock)
    with pytest.raises(BlockingIOError):
        queue.sample_age()
    clocks.us += 20_000
    sock.come()
    clocks.us += 5000
    clocks.set_by_us = set_by_us
    queue.sample_age()
    assert queue.take_ages() == []
    sock.stamps_ns.clear()
    sock.come()
    clocks.us += 7000
    queue.sample_age()
    assert queue.take_ages() == [7000]


def test_a_datagram_that_waits_through_several_samples_counts_in_each(clocks):
    sock = Socket(clocks)
    queue = ReceiveQueue(sock)
    sock.come()
    for _ in range(3):
        clocks.us += 10_000
        queue.sample_age()
    assert queue.take_ages() == [10_000, 20_000, 30_000]
