"""Sockets of one address: the kernel steers each datagram to the worker of its session."""

import socket

import numpy as np
import pytest

from hapticnet.errors import UnavailableError
from hapticnet.protocol.wire import SEALED, Kind, pack
from hapticnet.runtime.udp import HostPort, listen
from hapticnet.runtime.workers import group

WORKERS = 3


@pytest.fixture
def sockets():
    opened = group.open_group(HostPort("127.0.0.1", 0), WORKERS)
    yield opened
    for sock in opened:
        sock.close()


def arrived_at(sockets):
    """Return how many datagrams wait at each socket, and discard them."""
    return [group.discard_waiting(sock) for sock in sockets]


def send(data, sockets, count=1):
    """Send a datagram from a new port, so that a hash of the addresses would choose again each time."""
    for _ in range(count):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.sendto(data, sockets[0].getsockname())


@pytest.mark.parametrize("kind", [Kind.POSITION, Kind.CLOSE])
def test_a_datagram_reaches_the_worker_of_its_session_from_any_port(sockets, kind):
    rng = np.random.default_rng(1)
    numbers = [1 << 16, (1 << 32) - 1, *(int(rng.integers(1 << 16, 1 << 32)) for _ in range(200))]
    for number in numbers:
        send(pack(kind, number, 7, b"body", SEALED), sockets)
        assert arrived_at(sockets) == [int(number % WORKERS == worker) for worker in range(WORKERS)]


@pytest.mark.parametrize(
    "data", [pack(Kind.HELLO, 0, 0, b"x" * 400), b"", b"\x95", b"\x95\x01\x04\xce\x01\x02\x03"], ids=repr
)
def test_datagrams_of_no_session_and_garbage_spread_over_all(sockets, data):
    send(data, sockets, count=200)
    counts = arrived_at(sockets)
    assert sum(counts) == 200
    assert min(counts) > 20


def test_a_port_that_another_slave_has_is_in_use_also_if_that_one_has_workers(sockets):
    address = HostPort(*sockets[0].getsockname())
    with pytest.raises(UnavailableError, match="the port is in use"):
        group.open_group(address, 2)
    with pytest.raises(UnavailableError, match="the port is in use"):
        listen(address)


def test_a_system_that_cannot_steer_says_so_in_one_line(monkeypatch):
    monkeypatch.setattr(group, "SO_ATTACH_REUSEPORT_CBPF", 9999)
    with pytest.raises(UnavailableError, match=r"cannot distribute datagrams over workers \(ENOPROTOOPT.*--workers 1$"):
        group.open_group(HostPort("127.0.0.1", 0), 2)


def test_ipv6_sockets_share_an_address_too():
    sockets = group.open_group(HostPort("::1", 0), 2)
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
        sock.sendto(pack(Kind.POSITION, 65_537, 0, b""), sockets[0].getsockname())
    assert arrived_at(sockets) == [0, 1]
    for sock in sockets:
        sock.close()
