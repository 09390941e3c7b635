"""A map over processes ends whatever happens: a worker is killed, the caller gives up, or the caller is killed."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.experiment.workers import workers

PATIENCE_S = 60.0

PARENT = """
import os, time
from hapticnet.experiment.workers import workers

def nap(shared, item):
    os.write(1, b"%d\\n" % os.getpid())  # at once, or the lines of two processes mix
    time.sleep(600)

with workers(2, None) as run:
    list(run(nap, [1, 2]))
"""


def wait_until(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


def scaled(shared: float, item: float) -> float:
    return shared * item


def fatal(shared: int, item: int) -> int:
    if item == shared:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def nap(_shared: object, item: float) -> float:
    time.sleep(item)
    return item


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_order_and_do_not_depend_on_the_number_of_processes(jobs):
    with workers(jobs, 10) as run:
        assert list(run(scaled, range(20))) == [10 * item for item in range(20)]


@pytest.mark.parametrize("victim", [0, 7, 19])
def test_a_killed_worker_is_one_error(victim):
    with pytest.raises(UnavailableError, match="a worker process ended unexpectedly"), workers(2, victim) as run:
        list(run(fatal, range(20)))
    assert multiprocessing.active_children() == []


def give_up_after_one() -> None:
    with workers(2, None) as run:
        assert next(run(nap, [0.0, 600.0, 600.0])) == 0.0
        raise KeyboardInterrupt


@pytest.mark.parametrize("inherited", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_caller_that_gives_up_does_not_wait_for_the_workers(inherited):
    before = signal.signal(signal.SIGTERM, inherited)
    try:
        with pytest.raises(KeyboardInterrupt):
            give_up_after_one()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert multiprocessing.active_children() == []


def test_workers_end_with_a_killed_parent():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        try:
            children = [int(parent.stdout.readline()) for _ in range(2)]
        finally:
            parent.kill()
        assert wait_until(lambda: all(map(gone, children)))
