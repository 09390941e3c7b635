"""A busy machine is told once in a while, in one line for each sign, and stands in the report."""

import asyncio
import socket
from types import SimpleNamespace

import pytest

from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.overload import TELL_EVERY_US, Overload, signs
from hapticnet.runtime.system import OTHER
from hapticnet.runtime.udp import SAMPLE_EVERY, UdpPort, bound_address, listen, parse_host_port

FIFO = "SCHED_FIFO 10"
SECOND_US = 1_000_000


class Queue:
    def __init__(self):
        self.age = Distribution()
        self.ages_us: list[float] = []
        self.drops = 0

    def wait(self, *ages_us: float) -> None:
        self.ages_us += ages_us
        for age_us in ages_us:
            self.age.add(age_us)

    def take_ages(self):
        ages, self.ages_us = self.ages_us, []
        return ages

    def count_drops(self):
        return self.drops


class Ticker:
    def __init__(self):
        self.lateness = Distribution()
        self.missed = 0

    def tick(self, count: int, missed: int) -> None:
        self.missed += missed
        for _ in range(count - missed):
            self.lateness.add(50.0)


@pytest.fixture
def said():
    return []


@pytest.fixture
def queue():
    return Queue()


@pytest.fixture
def ticker():
    return Ticker()


@pytest.fixture
def overload(said, queue, ticker):
    made = Overload(FIFO, said.append)
    made.attach(SimpleNamespace(queue=queue), ticker)
    made.check(0)
    return made


def test_a_machine_that_keeps_up_says_nothing(overload, queue, ticker, said):
    for second in range(1, 20):
        queue.wait(*[100.0] * 60)
        ticker.tick(1000, 9)
        overload.check(second * SECOND_US)
    assert said == []
    assert signs(overload.report()) == []


def test_what_happens_while_the_process_starts_is_no_overload(said, ticker, queue):
    overload = Overload(FIFO, said.append)
    overload.attach(SimpleNamespace(queue=queue), ticker)
    queue.wait(9e6, 9e6)
    queue.drops = 7
    ticker.tick(100, 50)
    overload.check(0)
    overload.check(SECOND_US)
    assert said == []


def test_datagrams_that_wait_are_told_but_not_a_single_one(overload, queue, said):
    queue.wait(*[100.0] * 60, 80_000.0)
    overload.check(SECOND_US)
    assert said == []
    queue.wait(*[100.0] * 60, 12_300.0, 80_000.0)
    overload.check(2 * SECOND_US)
    assert said == ["overloaded: datagrams wait 12.3 ms until this process reads them"]


def test_what_the_system_drops_is_told_and_summed_up_between_two_lines(overload, queue, said):
    queue.drops = 5
    overload.check(SECOND_US)
    queue.drops = 1205
    overload.check(2 * SECOND_US)
    queue.drops = 1305
    overload.check(SECOND_US + TELL_EVERY_US)
    overload.check(2 * SECOND_US + 2 * TELL_EVERY_US)
    assert said == [
        "overloaded: the system dropped 5 datagrams that were not read in time",
        "overloaded: the system dropped 1,300 datagrams that were not read in time",
    ]


def test_missed_ticks_are_told_once_in_a_while(overload, ticker, said):
    for second in range(1, 31):
        ticker.tick(1000, 11)
        overload.check(second * SECOND_US)
    assert said == ["overloaded: 11 of 1,000 ticks were missed within a second"] * 3


@pytest.mark.parametrize(
    ("scheduling", "lines"),
    [
        (FIFO, []),
        (OTHER, []),  # as the user wished
        (
            f"{OTHER} (SCHED_FIFO refused: why)",
            ["no real-time scheduling, so a busy machine disturbs it: SCHED_FIFO refused: why"],
        ),
    ],
)
def test_scheduling_that_was_refused_is_told_at_the_start(scheduling, lines, said):
    assert Overload(scheduling, said.append).report()["scheduling"] == scheduling
    assert said == lines


def test_the_report_covers_the_whole_run(overload, queue, ticker):
    queue.wait(*[100.0] * 90, *[8000.0] * 10)
    queue.drops = 12
    ticker.tick(1000, 20)
    report = overload.report()
    assert report["queue_age_p50_us"] == pytest.approx(100.0, rel=0.02)
    assert (report["kernel_drops"], report["missed_ticks"], report["missed_share"]) == (12, 20, 0.02)
    assert signs(report) == [
        "20 ticks (2.0%) were missed",
        "1 % of the datagrams waited more than 8.0 ms to be read",
        "the system dropped 12 datagrams",
    ]


def test_a_port_that_is_not_watched_has_nothing_to_report(said):
    assert signs(Overload(FIFO, said.append).report()) == []


def test_a_port_knows_how_long_datagrams_waited_and_how_many_were_dropped():
    read = []

    async def play() -> UdpPort:
        with listen(parse_host_port("127.0.0.1:0", lowest_port=0)) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 100_000)
            port = UdpPort(asyncio.get_running_loop(), sock, lambda batch, _: read.extend(batch))
            address = bound_address(sock)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                for _ in range(2000):  # more than fit; nobody reads yet
                    sender.sendto(b"x", (address.host, address.port))
                for _ in range(2 * SAMPLE_EVERY):
                    await asyncio.sleep(0)
                    sender.sendto(b"x", (address.host, address.port))
                await asyncio.sleep(0)
            port.close()
        return port

    port = asyncio.run(play())
    assert 0 < port.queue.count_drops() < 2000
    assert port.queue.age.count >= 2
    assert len(port.queue.take_ages()) == port.queue.age.count
    assert port.queue.take_ages() == []
    assert 0.0 < port.queue.age.largest < 60e6
