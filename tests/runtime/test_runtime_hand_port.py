"""The socket of the udp operator."""

import asyncio
import json
import socket

from hapticnet.operator.remote import RemoteOperator
from hapticnet.runtime import hand_port
from hapticnet.runtime.hand_port import HandPort
from hapticnet.runtime.udp import HostPort, bound_address, listen


def test_positions_arrive_and_forces_go_back_to_the_sender():
    said = []

    async def exchange():
        hand = RemoteOperator()
        sock = listen(HostPort("127.0.0.1", 0))
        address = bound_address(sock)
        port = HandPort(hand, sock, said.append)
        await port.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.bind(("127.0.0.1", 0))
            client.settimeout(5.0)
            client.sendto(b'{"position_m": [0.00001]}', (address.host, address.port))
            client.sendto(b"garbage", (address.host, address.port))
            while hand.positions + hand.malformed < 2:
                await asyncio.sleep(0.001)
            hand.sample(1000)
            hand.feel(1000, (1.25,))
            for now_us in (1000, 2000):
                port.observe(now_us)
            answer = json.loads(client.recv(1000))
            place = client.getsockname()
        port.observe(3000)
        await port.stop()
        return hand, answer, place

    hand, answer, (host, number) = asyncio.run(exchange())
    assert answer == {"force_n": [1.25], "position_m": [0.00001], "t_us": 1000}
    assert (hand.positions, hand.malformed, hand.answers) == (1, 1, 1)
    assert said[0] == f"positions come from {host}:{number}, as JSON object"
    assert said[1].startswith(f"dropped a datagram from {host}:{number}: neither msgpack nor JSON")


def test_a_flood_is_read_little_by_little(monkeypatch):
    async def flood():
        hand = RemoteOperator()
        sock = listen(HostPort("127.0.0.1", 0))
        address = bound_address(sock)
        port = HandPort(hand, sock, print)
        monkeypatch.setattr(hand_port, "PERIOD_S", 60.0)
        await port.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            for _ in range(3 * hand_port.MOST_IN_A_PERIOD):
                client.sendto(b"[0.01]", (address.host, address.port))
            while hand.positions < hand_port.MOST_IN_A_PERIOD:
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.05)
            before = hand.positions
            port._resume.cancel()
            monkeypatch.setattr(hand_port, "PERIOD_S", 0.0)
            port._listen()
            while hand.positions < 3 * hand_port.MOST_IN_A_PERIOD:
                await asyncio.sleep(0.001)
        await port.stop()
        return before

    assert asyncio.run(flood()) == hand_port.MOST_IN_A_PERIOD


def test_a_port_that_was_never_started_closes_its_socket():
    sock = listen(HostPort("127.0.0.1", 0))
    asyncio.run(HandPort(RemoteOperator(), sock, print).stop())
    assert sock.fileno() == -1
