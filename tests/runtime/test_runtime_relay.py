"""The relay gives its seats to masters, not to strangers."""

import asyncio
import socket
from collections.abc import Awaitable, Callable

import numpy as np
import pytest

from hapticnet.channel.spec import parse_channel
from hapticnet.protocol.messages import HELLO_BYTES, unpack_cookie
from hapticnet.protocol.wire import Kind, pack, pack_body, unpack, unpack_body
from hapticnet.runtime import relay as relay_module
from hapticnet.runtime import relay_reception
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.relay import Relay
from hapticnet.runtime.relay_reception import HOST_AT_ONCE, UNPROVED_AT_ONCE, RelayReception, is_hello
from hapticnet.runtime.udp import UdpPort, bound_address, listen, parse_host_port

LOCAL = parse_host_port("127.0.0.1:0", lowest_port=0)
SLAVES_COOKIE = b"s" * 16


def hello(nonce: int, cookie: bytes = b"", version: int = 1) -> bytes:
    return pack(Kind.HELLO, 0, 0, pack_body((nonce, cookie, b"request", b"", bytes(HELLO_BYTES))), version)


POSITION = pack(Kind.POSITION, 70_000, 1, b"position")
FORCE = pack(Kind.FORCE, 70_000, 1, b"force")


class Client:
    """A source on a host of its own; all of 127.0.0.0/8 is this machine."""

    def __init__(self, front, host: str = "127.0.0.1") -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind((host, 0))
        self.sock.setblocking(False)
        self.front = (front.host, front.port)

    def send(self, data: bytes) -> None:
        self.sock.sendto(data, self.front)

    async def receive(self) -> bytes:
        return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(self.sock, 2000), 10)

    async def join(self, nonce: int) -> None:
        """Ask as a master does until there is a session."""
        self.send(hello(nonce))
        while True:
            answer = unpack(await self.receive())
            if answer.kind is Kind.WELCOME:
                return
            assert answer.kind is Kind.COOKIE
            self.send(hello(nonce, unpack_cookie(answer.body).cookie))


class Setting:
    """A relay, its target, and clients."""

    def __init__(self) -> None:
        self.heard = 0
        loop = asyncio.get_running_loop()
        target = listen(LOCAL)
        self.target = UdpPort(loop, target, self.answer)
        sock = listen(parse_host_port("0.0.0.0:0", lowest_port=0))
        self.front = parse_host_port(f"127.0.0.1:{bound_address(sock).port}")
        channel, rng = parse_channel("perfect"), np.random.default_rng(1)
        self.relay = Relay(
            loop, sock, bound_address(target), forward=channel, feedback=channel, rng=rng, entropy=SystemEntropy()
        )
        self.clients: list[Client] = []

    def answer(self, batch, _now) -> None:
        """Answer as a slave does."""
        for data, address in batch:
            self.heard += 1
            datagram = unpack(data)
            if datagram.kind is Kind.POSITION:
                self.target.send(FORCE, address)
                continue
            nonce, cookie = unpack_body(datagram.body, 2)
            if cookie == SLAVES_COOKIE:
                self.target.send(pack(Kind.WELCOME, 70_000, 0, pack_body((nonce, b"grant"))), address)
            else:
                self.target.send(pack(Kind.COOKIE, 0, 0, pack_body((nonce, SLAVES_COOKIE))), address)

    def client(self, host: str = "127.0.0.1") -> Client:
        self.clients.append(Client(self.front, host))
        return self.clients[-1]

    async def taken_in(self, count: int) -> None:
        """Wait until the relay has read that many datagrams of strangers."""
        while self.strange < count:
            await asyncio.sleep(0.001)

    @property
    def strange(self) -> int:
        report = self.relay.report()
        return sum(report[key] for key in ("clients", "turned_away", "ignored", "cookies", "throttled"))

    def close(self) -> None:
        self.relay.close()
        self.target.close()
        for client in self.clients:
            client.sock.close()


def play(script: Callable[[Setting], Awaitable[None]]) -> dict:
    """Run a script beside a relay; return the relay's report."""

    async def run() -> dict:
        setting = Setting()
        try:
            await asyncio.wait_for(script(setting), 60)
            return setting.relay.report()
        finally:
            setting.close()

    return asyncio.run(run())


def host(number: int) -> str:
    return f"127.{number >> 16}.{number >> 8 & 255}.{number & 255}"


def test_a_master_gets_in_and_its_datagrams_pass_both_ways():
    async def script(setting):
        master = setting.client()
        await master.join(1)
        master.send(POSITION)
        assert await master.receive() == FORCE

    report = play(script)
    assert (report["clients"], report["cookies"]) == (1, 0)
    assert (report["forward"]["delivered"], report["feedback"]["delivered"]) == (3, 3)


@pytest.mark.parametrize(
    "data", [b"", b"x", POSITION, b"x" * 1200, hello(1)[:399], hello(1)[:-1], bytes((0x95, 1, 1)) + bytes(400)]
)
def test_what_is_no_hello_opens_nothing_and_gets_no_answer(data):
    async def script(setting):
        for number in range(400):  # from 128 sources they once took every seat for 30 s
            setting.client(host(2 + number % 128)).send(data)
        await setting.taken_in(400)
        assert setting.relay.clients == 0
        assert setting.heard == 0
        await setting.client().join(1)

    report = play(script)
    assert (report["ignored"], report["clients"]) == (400, 1)


@pytest.mark.parametrize("version", [1, 2, 3, 127])
def test_requests_of_any_version_are_passed_on(version):
    assert is_hello(hello(1, version=version))
    reception = RelayReception(SystemEntropy())
    assert reception.greet(hello(1, version=version), ("127.0.0.1", 1), 0, must_prove=False) is True


def test_a_flood_of_requests_from_forged_hosts_opens_few_clients_and_a_newcomer_gets_in():
    async def script(setting):
        for number in range(2, 1002):
            setting.client(host(number)).send(hello(number))
        await setting.taken_in(1000)
        assert setting.relay.clients < UNPROVED_AT_ONCE + 100, "those that passed, and 5/s more"
        assert setting.relay.report()["cookies"] > 800
        master = setting.client()
        await master.join(1)
        master.send(POSITION)
        assert await master.receive() == FORCE

    play(script)


def test_a_cookie_is_worth_nothing_at_another_address():
    reception = RelayReception(SystemEntropy())
    for _ in range(UNPROVED_AT_ONCE):
        assert reception.greet(hello(1), ("127.0.0.1", 1), 0, must_prove=False) is True
    answer = reception.greet(hello(1), ("127.0.0.1", 1), 0, must_prove=False)
    assert isinstance(answer, bytes)
    assert len(answer) < HELLO_BYTES / 8
    proof = hello(1, unpack_cookie(unpack(answer).body).cookie)
    assert isinstance(reception.greet(proof, ("127.0.0.1", 2), 0, must_prove=False), bytes)
    assert reception.greet(proof, ("127.0.0.1", 1), 0, must_prove=True) is True


def test_a_host_opens_only_so_many_clients_a_second():
    reception = RelayReception(SystemEntropy())

    def prove(port: int, now_us: int, at: str) -> bool:
        answer = reception.greet(hello(1), (at, port), now_us, must_prove=True)
        assert isinstance(answer, bytes)
        proof = hello(1, unpack_cookie(unpack(answer).body).cookie)
        return reception.greet(proof, (at, port), now_us, must_prove=True) is True

    assert [prove(port, 0, "10.0.0.1") for port in range(HOST_AT_ONCE + 5)] == [True] * HOST_AT_ONCE + [False] * 5
    assert reception.throttled == 5
    assert prove(1, 0, "10.0.0.2")
    assert prove(1, 300_000, "10.0.0.1")


def test_masters_keep_their_seats_and_clients_without_a_session_give_way(monkeypatch):
    monkeypatch.setattr(relay_module, "MOST_CLIENTS", 3)

    async def script(setting):
        master = setting.client(host(2))
        await master.join(1)
        for number in range(3, 13):
            setting.client(host(number)).send(hello(1))
        await setting.taken_in(11)
        assert setting.relay.clients == 3, "without a cookie nobody gives way"
        other = setting.client(host(20))
        await other.join(1)
        master.send(POSITION)
        assert await master.receive() == FORCE

    report = play(script)
    assert report["turned_away"] == 0
    assert report["clients"] == 4


def test_seats_are_shared_between_hosts(monkeypatch):
    monkeypatch.setattr(relay_module, "MOST_CLIENTS", 4)

    async def script(setting):
        greedy = [setting.client(host(2)) for _ in range(4)]
        for nonce, client in enumerate(greedy):
            await client.join(nonce)
        other = setting.client(host(3))
        await other.join(1)
        for client in (other, *greedy[1:]):  # the first, silent for longest, gave way
            client.send(POSITION)
            assert await client.receive() == FORCE
        fifth = setting.client(host(2))
        fifth.send(hello(9))
        cookie = unpack_cookie(unpack(await fifth.receive()).body).cookie
        fifth.send(hello(9, cookie))
        while not setting.relay.turned_away:
            await asyncio.sleep(0.001)
        assert setting.relay.clients == 4

    assert play(script)["clients"] == 5


def test_a_master_that_is_silent_gives_way(monkeypatch):
    monkeypatch.setattr(relay_module, "MOST_CLIENTS", 1)
    monkeypatch.setattr(relay_module, "GIVES_WAY_US", -1)

    async def script(setting):
        for number in (2, 3):
            await setting.client(host(number)).join(1)

    assert play(script)["clients"] == 2


def test_who_gets_no_session_is_soon_forgotten(monkeypatch):
    monkeypatch.setattr(relay_module, "UNPROVED_AFTER_US", -1)

    async def script(setting):
        await setting.client(host(2)).join(1)
        setting.client(host(3)).send(hello(1))
        await setting.taken_in(2)
        setting.relay.forget_idle()
        assert setting.relay.clients == 1

    play(script)


def test_the_targets_name_is_not_looked_up_for_each_client(monkeypatch):
    looked_up = []
    look_up = relay_module.look_up
    monkeypatch.setattr(relay_module, "look_up", lambda target: looked_up.append(target) or look_up(target))

    async def script(setting):
        for nonce in range(5):
            await setting.client(host(2)).join(nonce)

    play(script)
    assert len(looked_up) == 1


def test_memory_for_hosts_is_bounded(monkeypatch):
    from hapticnet.protocol.buckets import MOST_KEYS

    reception = RelayReception(SystemEntropy())
    monkeypatch.setattr(relay_reception.CookieJar, "accepts", lambda *_: True)
    for number in range(MOST_KEYS + 100):
        assert reception.greet(hello(1), (host(number), 1), 0, must_prove=True) is True
    assert len(reception._hosts._buckets) == MOST_KEYS
