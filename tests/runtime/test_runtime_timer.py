"""Timers in real time; the limits are loose and only catch what does not work at all."""

import asyncio

import pytest

from hapticnet.runtime.clock import now_us
from hapticnet.runtime.realtime import loop_factory, run
from hapticnet.runtime.timer import Alarm, Ticker


def test_uvloop_is_used_where_it_is_installed():
    async def name() -> str:
        return type(asyncio.get_running_loop()).__module__

    assert run(name()).startswith("uvloop")


@pytest.mark.parametrize("make_loop", [None, loop_factory()], ids=["asyncio", "uvloop"])
def test_a_ticker_ticks_at_its_rate_and_never_early(make_loop):
    async def ticks() -> tuple[list[int], Ticker]:
        times: list[int] = []
        ticker = Ticker(asyncio.get_running_loop(), 5000, times.append)
        await asyncio.sleep(0.5)
        ticker.stop()
        await asyncio.sleep(0.02)
        return times, ticker

    with asyncio.Runner(loop_factory=make_loop) as runner:
        times, ticker = runner.run(ticks())
    assert len(times) + ticker.missed == pytest.approx(100, abs=12)
    assert ticker.lateness.count == len(times)
    assert times == sorted(times)


def test_a_ticker_keeps_a_new_period():
    async def ticks() -> int:
        count = 0

        def tick(_: int) -> None:
            nonlocal count
            count += 1

        ticker = Ticker(asyncio.get_running_loop(), 1_000_000, tick)
        ticker.set_period(2000)
        await asyncio.sleep(0.3)
        ticker.stop()
        return count + ticker.missed

    assert run(ticks()) == pytest.approx(150, abs=30)


def test_an_alarm_rings_once_at_the_time_it_was_last_set_to():
    async def rings() -> list[int]:
        times: list[int] = []
        start = now_us()
        alarm = Alarm(asyncio.get_running_loop(), lambda: times.append(now_us() - start))
        alarm.set(start + 10_000)
        alarm.set(start + 60_000)
        await asyncio.sleep(0.2)
        alarm.set(start)  # past: at once
        await asyncio.sleep(0.05)
        alarm.set(start + 300_000)
        alarm.set(None)
        await asyncio.sleep(0.15)
        alarm.stop()
        return times

    first, second = run(rings())
    assert 60_000 <= first < 200_000
    assert 200_000 <= second < 300_000
