"""The relay gives its places to masters, not to strangers."""

import asyncio
import socket

import numpy as np
import pytest

from hapticnet.channel.spec import parse_channel
from hapticnet.runtime import relay as relay_module
from hapticnet.runtime.relay import Relay
from hapticnet.runtime.udp import bound_address, listen, parse_host_port

LOCAL = parse_host_port("127.0.0.1:0", lowest_port=0)


@pytest.fixture
def few_places(monkeypatch):
    monkeypatch.setattr(relay_module, "MOST_CLIENTS", 3)


def ask(front, text, clients):
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.setblocking(False)
    client.sendto(text, (front.host, front.port))
    clients.append(client)
    return client


async def exchange(play):
    """Run `play` beside a relay whose target echoes what is longer than one byte."""
    loop = asyncio.get_running_loop()
    with listen(LOCAL) as target:

        def echo():
            data, address = target.recvfrom(100)
            if len(data) > 1:
                target.sendto(data, address)

        loop.add_reader(target, echo)
        sock = listen(LOCAL)
        front = bound_address(sock)
        channel = parse_channel("perfect")
        rng = np.random.default_rng(1)
        relay = Relay(loop, sock, bound_address(target), forward=channel, feedback=channel, rng=rng)
        clients = []
        try:
            await play(relay, front, clients)
        finally:
            relay.close()
            loop.remove_reader(target)
            for client in clients:
                client.close()
        return relay


@pytest.mark.usefixtures("few_places")
def test_sources_without_an_answer_give_way_to_a_master():
    async def play(relay, front, clients):
        for _ in range(10):
            ask(front, b"x", clients)
            await asyncio.sleep(0.01)
        master = ask(front, b"hello", clients)
        assert await asyncio.wait_for(asyncio.get_running_loop().sock_recv(master, 100), 5) == b"hello"
        for _ in range(10):
            ask(front, b"x", clients)
            await asyncio.sleep(0.01)
        assert relay.clients == 3
        master.sendto(b"still here", (front.host, front.port))
        assert await asyncio.wait_for(asyncio.get_running_loop().sock_recv(master, 100), 5) == b"still here"

    relay = asyncio.run(exchange(play))
    report = relay.report()
    assert report["clients"] == 21
    assert (report["turned_away"], report["forward"]["delivered"], report["feedback"]["delivered"]) == (0, 22, 2)


@pytest.mark.usefixtures("few_places")
def test_active_masters_keep_their_places_and_idle_ones_give_way(monkeypatch):
    async def play(relay, front, clients):
        for _ in range(4):
            ask(front, b"hello", clients)
            await asyncio.sleep(0.05)
        assert (relay.clients, relay.turned_away) == (3, 1)
        monkeypatch.setattr(relay_module, "GIVES_WAY_US", 0)
        ask(front, b"hello", clients)
        await asyncio.sleep(0.05)
        assert (relay.clients, relay.turned_away) == (3, 1)

    asyncio.run(exchange(play))
