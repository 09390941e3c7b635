"""Signals to a process whose event loop runs, and to one whose loop is stuck."""

import signal
import subprocess
import sys
import time

import pytest

from hapticnet.runtime.waiting import PATIENCE_S

PROGRAM = """
import asyncio, sys, time
import uvloop
from hapticnet.runtime.waiting import stop_on_signals

async def main(is_stuck):
    stop = stop_on_signals(asyncio.get_running_loop())
    print("ready", flush=True)
    while is_stuck:
        pass
    await stop.wait()
    print("stopped", flush=True)

loop_factory = uvloop.new_event_loop if sys.argv[1] == "uvloop" else None
with asyncio.Runner(loop_factory=loop_factory) as runner:
    try:
        runner.run(main(sys.argv[2] == "stuck"))
    except KeyboardInterrupt:
        print("interrupted", flush=True)
if sys.argv[2] == "goes on":
    print("closed", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("loop", ["uvloop", "asyncio"])
@pytest.mark.parametrize(("state", "said"), [("runs", "stopped"), ("stuck", "interrupted")])
def test_a_second_signal_ends_a_loop_that_is_stuck(number, loop, state, said):
    with subprocess.Popen([sys.executable, "-c", PROGRAM, loop, state], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            if state == "stuck":
                time.sleep(PATIENCE_S + 0.1)
                assert process.poll() is None
                process.send_signal(number)
            assert process.communicate(timeout=30)[0] == f"{said}\n"
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("loop", ["uvloop", "asyncio"])
def test_a_signal_ends_a_program_that_goes_on_after_the_loop(number, loop):
    command = [sys.executable, "-c", PROGRAM, loop, "goes on"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            assert [process.stdout.readline() for _ in range(2)] == ["stopped\n", "closed\n"]
            process.send_signal(number)
            assert process.wait(30) == -number
        finally:
            process.kill()
