"""Ages of datagrams in the queue of a socket, also when somebody sets the clock."""

import socket
import struct

import pytest

from hapticnet.runtime import receive_queue
from hapticnet.runtime.receive_queue import ReceiveQueue

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
    monkeypatch.setattr(receive_queue, "time", clocks)
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
