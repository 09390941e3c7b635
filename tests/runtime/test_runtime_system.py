"""Numbers that nobody must guess, and timers in real time."""

import asyncio
import secrets

import pytest

from hapticnet.protocol.settings import random_bytes
from hapticnet.runtime.system import SystemEntropy, loop_factory, now_us, run
from hapticnet.runtime.timer import Alarm, Ticker


def test_numbers_come_from_the_operating_system_and_lie_in_their_range(monkeypatch):
    asked = []
    monkeypatch.setattr(secrets, "randbelow", lambda below: (asked.append(below), below - 1)[1])
    assert SystemEntropy().integers(1 << 16, 1 << 32) == (1 << 32) - 1
    assert asked == [(1 << 32) - (1 << 16)]


def test_no_two_tickets_are_alike():
    entropy = SystemEntropy()
    assert len({random_bytes(entropy, 16) for _ in range(1000)}) == 1000


def test_uvloop_is_used_where_it_is_installed():
    async def name() -> str:
        return type(asyncio.get_running_loop()).__module__

    assert run(name()).startswith("uvloop")


@pytest.mark.parametrize("make_loop", [None, loop_factory()], ids=["asyncio", "uvloop"])
def test_a_ticker_ticks_at_its_rate_and_never_early(make_loop):
    async def ticks() -> tuple[list[int], Ticker, int]:
        times: list[int] = []
        start = now_us()
        ticker = Ticker(asyncio.get_running_loop(), 5000, times.append)
        while len(times) < 100:
            await asyncio.sleep(0.02)
        ticker.stop()
        elapsed = now_us() - start
        await asyncio.sleep(0.02)
        return times, ticker, elapsed

    with asyncio.Runner(loop_factory=make_loop) as runner:
        times, ticker, elapsed = runner.run(asyncio.wait_for(ticks(), 20))
    # Every elapsed period is a tick or a missed one; the last tick may still be pending.
    assert len(times) + ticker.missed in (elapsed // 5000 - 1, elapsed // 5000)
    assert ticker.lateness.count == len(times)
    assert times == sorted(times)


def test_an_alarm_rings_once_at_the_time_it_was_last_set_to():
    async def rings() -> list[int]:
        times: list[int] = []
        alarm = Alarm(asyncio.get_running_loop(), lambda: times.append(now_us()))
        start = now_us()
        alarm.set(start + 10_000)
        alarm.set(start + 60_000)
        while not times:
            await asyncio.sleep(0.01)
        past = now_us()
        alarm.set(past - 1000)  # at once
        while len(times) < 2:
            await asyncio.sleep(0.01)
        alarm.set(now_us() + 300_000)
        alarm.set(None)
        await asyncio.sleep(0.4)
        alarm.stop()
        return [times[0] - start, times[1] - past, *times[2:]]

    first, second = run(asyncio.wait_for(rings(), 20))
    assert first >= 60_000
    assert second >= 0
