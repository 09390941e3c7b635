"""Both processes inside another program: in a thread, with signals left to the host."""

import asyncio
import signal
import threading

from hapticnet.runtime.master_run import run_master
from hapticnet.runtime.slave_run import run_slave
from hapticnet.runtime.udp import HostPort, bound_address, listen, open_toward
from tests.conftest import make_master, make_slave


def test_a_thread_runs_both_until_its_host_stops_them():
    handler = signal.getsignal(signal.SIGINT)
    ran = {}

    async def run() -> None:
        stop = asyncio.Event()
        slave, master = make_slave(), make_master()
        listening = listen(HostPort("127.0.0.1", 0))
        sock, address = open_toward(bound_address(listening))
        serving = asyncio.create_task(run_slave(slave, listening, stop=stop))
        asyncio.get_running_loop().call_later(0.5, stop.set)
        outcome = await run_master(master, sock, address, stop=stop)
        await serving
        ran.update(outcome=outcome, steps=slave.report()["sessions"][0]["steps"])

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    thread.join(30.0)
    assert ran["outcome"].connected
    assert ran["outcome"].end_reason == "stopped"
    assert ran["steps"] > 10
    assert signal.getsignal(signal.SIGINT) is handler
