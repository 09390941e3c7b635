import select
import socket

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.runtime import udp
from hapticnet.runtime.udp import DRAIN_US, UdpPort, bound_address, listen, parse_host_port


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


def test_a_port_in_use_is_reported():
    with listen(parse_host_port("127.0.0.1:0", lowest_port=0)) as first:
        address = bound_address(first)
        with pytest.raises(UnavailableError, match=f"cannot listen on {address}: the port is in use"):
            listen(address)


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
