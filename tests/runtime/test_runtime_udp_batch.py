"""A port that reads and sends many datagrams at once does what a plain one does."""

import asyncio
import socket

import pytest

from hapticnet.node.bank_tables import make_departures
from hapticnet.runtime.udp_batch import BatchPort, SocketAddresses


@pytest.mark.parametrize(
    "address", [("127.0.0.1", 47800), ("192.0.2.7", 1), ("::1", 65535, 0, 0), ("2001:db8::7", 9, 5, 0)]
)
def test_addresses_become_words_and_back(address):
    book = SocketAddresses()
    assert book.address(book.words(address)) == address


def test_a_link_local_address_keeps_its_link():
    book = SocketAddresses()
    host = f"fe80::1%{socket.if_indextoname(1)}"
    assert book.address(book.words((host, 7, 0, 1))) == (host, 7, 0, 1)


@pytest.fixture(params=["127.0.0.1", "::1"])
def pair(request):
    """Return two sockets of one family and their addresses."""
    family = socket.AF_INET6 if ":" in request.param else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as ours, socket.socket(family, socket.SOCK_DGRAM) as theirs:
        for each in (ours, theirs):
            each.bind((request.param, 0))
            each.setblocking(False)
            each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        theirs.settimeout(5.0)
        yield ours, theirs


def exchange(ours, theirs, sent, *, answer):
    """Send datagrams to a port; return what it reads, after it has answered with departures."""

    async def run():
        read, done = [], asyncio.Event()
        book = SocketAddresses()

        def receive(arrivals, count, _):
            for number in range(count):
                data = arrivals.octets[number, : arrivals.lengths[number]].tobytes()
                read.append((data, book.address(arrivals.addresses[number])))
            answer(port, arrivals, count)
            if len(read) == len(sent):
                done.set()

        port = BatchPort(asyncio.get_running_loop(), ours, receive)
        for data in sent:
            theirs.sendto(data, ours.getsockname())
        await asyncio.wait_for(done.wait(), 5.0)
        port.close()
        return read, port

    return asyncio.run(run())


def test_everything_that_queued_up_is_read_with_its_source(pair):
    ours, theirs = pair
    sent = [bytes([number]) * size for number, size in enumerate((1, 20, 0, 60))] * 80
    sent += [bytes(1200), bytes(1201), bytes(5000)]
    read, port = exchange(ours, theirs, sent, answer=lambda *_: None)
    assert [data for data, _ in read] == [data[:1201] for data in sent]  # longer ones are recognised as too long
    assert {address[:2] for _, address in read} == {theirs.getsockname()[:2]}
    assert port.send_errors == 0


def test_departures_go_to_their_addresses_and_a_bad_one_holds_up_no_other(pair):
    ours, theirs = pair
    departures = make_departures(8)

    def answer(port, arrivals, count):
        for number in range(count):
            departures.octets[number, :2] = number, 7
            departures.lengths[number] = 2
            departures.addresses[number] = arrivals.addresses[number]
        departures.addresses[1] = SocketAddresses().words(_no_address(ours))
        port.send_departures(departures, count)

    _, port = exchange(ours, theirs, [b"a", b"b", b"c"], answer=answer)
    assert [theirs.recv(99) for _ in range(2)] == [b"\0\7", b"\2\7"]
    assert port.send_errors == 1


def _no_address(sock):
    """Return an address that a datagram cannot be sent to: port 0."""
    return (sock.getsockname()[0], 0, *sock.getsockname()[2:])
