"""Run a device in real time: open its wire, wait for readings, and tick every millisecond until done or interrupted."""

import asyncio
from collections.abc import Callable
from typing import Final

from hapticnet.runtime.serial_port import Wire, open_wire
from hapticnet.runtime.timer import Ticker
from hapticnet.runtime.waiting import either, stop_on_signals

TICK_US: Final = 1000


async def run_device(wire: Wire | None, tick: Callable[[int], bool], *, duration_s: float | None = None) -> bool:
    """Open a device, wait for readings, then call `tick` with the time [µs] every millisecond.

    Parameters
    ----------
    wire
        The wire of the device, or None if it has none.
    tick
        Exchanges with the device; returns whether it is done. An exception ends the run and is raised here.
    duration_s
        Longest time [s] to run once the device is ready.

    Returns
    -------
    bool
        Whether the run was completed; False if SIGINT or SIGTERM ended it.

    Raises
    ------
    RefusedError
        If the device speaks a different protocol version.
    UnavailableError
        If there is no such port, or no device answers on it.
    """
    loop = asyncio.get_running_loop()
    signalled = stop_on_signals(loop)
    done = asyncio.Event()
    failure: list[Exception] = []
    port = await open_wire(wire, signalled) if wire is not None else None
    if wire is not None and port is None:
        return False

    def on_tick(now_us: int) -> None:
        try:
            if not done.is_set() and tick(now_us):
                done.set()
        except Exception as error:
            failure.append(error)
            done.set()
        if port is not None:
            port.flush(now_us)

    ticker = Ticker(loop, TICK_US, on_tick)
    try:
        await either(done, signalled, duration_s)
        if failure:
            raise failure[0]
        return not signalled.is_set()
    finally:
        ticker.stop()
        if port is not None:
            await port.stop()
