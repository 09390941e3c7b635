"""Signals to a process whose event loop runs, and to one whose loop is stuck."""

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

PROGRAM = """
import asyncio, sys, time
import uvloop
from hapticnet.errors import UserCodeError
from hapticnet.runtime import signals
from hapticnet.runtime.signals import Rescue, stop_on_signals

signals.PATIENCE_S = 0.3
rescue = Rescue(lambda: print("reported", flush=True))

async def main(state):
    stop = stop_on_signals(asyncio.get_running_loop(), None if state == "goes on" else rescue)
    print("ready", flush=True)
    while state == "stuck":
        pass
    while state == "deaf":
        try:
            time.sleep(0.01)
        except BaseException:
            pass
    if state == "waits":
        time.sleep(600)
    await stop.wait()
    print("stopped", flush=True)

loop_factory = uvloop.new_event_loop if sys.argv[1] == "uvloop" else None
with asyncio.Runner(loop_factory=loop_factory) as runner:
    try:
        runner.run(main(sys.argv[2]))
    except UserCodeError as error:
        print(error, flush=True)
if sys.argv[2] in ("goes on", "reports"):
    print("closed", flush=True)
    time.sleep(60 if sys.argv[2] == "goes on" else 0.5)
rescue.done()
"""


@contextmanager
def signalled(number, loop, state):
    """Start the program, and send it a signal as soon as its loop runs."""
    command = [sys.executable, "-c", PROGRAM, loop, state]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            yield process
        finally:
            process.kill()


BOTH = pytest.mark.parametrize(("number", "loop"), [(signal.SIGINT, "uvloop"), (signal.SIGTERM, "asyncio")])


@pytest.mark.parametrize(
    ("state", "said", "code"),
    [
        ("runs", "stopped\n", 0),
        ("stuck", "main .<string>, line 1\\d. did not return within 0.3 s\n", 0),
        ("deaf", "reported\n", 1),  # code that catches whatever interrupts it
        ("waits", "main .<string>, line 22. did not return within 0.3 s\n", 0),
    ],
)
@BOTH
def test_one_signal_ends_a_process_whatever_its_loop_is_stuck_in(number, loop, state, said, code):
    with signalled(number, loop, state) as process:
        assert re.fullmatch(said, process.communicate(timeout=60)[0])
        assert process.returncode == code


@pytest.mark.parametrize("state", ["goes on", "reports"])
@BOTH
def test_after_the_loop_a_signal_ends_a_program_unless_it_has_a_report_to_deliver(number, loop, state):
    with signalled(number, loop, state) as process:
        assert [process.stdout.readline() for _ in range(2)] == ["stopped\n", "closed\n"]
        process.send_signal(number)
        said = process.communicate(timeout=30)
        assert process.returncode == (-number if state == "goes on" else 0)
        assert state == "goes on" or said == ("", "")
