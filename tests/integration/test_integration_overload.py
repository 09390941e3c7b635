"""A process that cannot keep up says so on its console and in its report."""

import re
import signal
import socket
import time

from hapticnet.experiment.analysis import CONDITIONS
from hapticnet.experiment.demo import Played, disturbances
from tests.integration.conftest import PATIENCE_S


def test_a_slave_that_was_stopped_tells_what_waited_and_what_was_dropped(start, slave):
    server, address = slave
    host, port = address.split(":")
    master = start("master", "--connect", address, "--rate", "200", "--duration", "60")
    server.wait_for("joined")
    deadline, stops = time.monotonic() + PATIENCE_S, 0
    while not re.search(r"overloaded: the system dropped [\d,]+ datagrams that were not read in time", server.said()):
        assert time.monotonic() < deadline
        stops += 1  # what is dropped while it may still be starting is no overload
        server.process.send_signal(signal.SIGSTOP)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for _ in range(40_000):  # more than fit into its buffer
                sock.sendto(b"x" * 40, (host, int(port)))
        master.wait_for("link stale", stops)
        server.process.send_signal(signal.SIGCONT)
        master.wait_for("link recovered", stops)
    server.wait_for(r"overloaded: datagrams wait [\d.]+ ms until this process reads them")
    master.end()
    assert server.end() == 0
    overload = server.report()["overload"]
    assert overload["kernel_drops"] > 1000
    assert overload["queue_age_p99_us"] > 5000
    assert overload["missed_ticks"] is None
    assert overload["lines_left_out"] == 0


def test_a_master_that_was_stopped_tells_the_ticks_it_missed(start, slave):
    _, address = slave
    # Without a device, whose steps would seem slow if the process is stopped within them.
    master = start("master", "--connect", address, "--device", "none", "--duration", "60", "--json")
    master.wait_for("connected to")
    deadline = time.monotonic() + PATIENCE_S
    while "ticks were missed within a second" not in master.said():
        assert time.monotonic() < deadline
        for number in (signal.SIGSTOP, signal.SIGCONT):
            master.process.send_signal(number)
            time.sleep(0.1)
    assert master.end() == 0
    assert "this machine was too busy for 1000 Hz: " in master.said()
    overload = master.report()["overload"]
    assert overload["missed_ticks"] > 50
    assert overload["missed_share"] > 0.01
    assert overload["scheduling"] == "SCHED_OTHER"


def test_a_demo_on_a_busy_machine_says_so():
    fast = {"queue_age_p99_us": 80.0, "missed_ticks": 3, "missed_share": 0.001, "kernel_drops": 0}
    slow = {"queue_age_p99_us": 80.0, "missed_ticks": 300, "missed_share": 0.1, "kernel_drops": 0}

    def played(overload, scheduling):
        master = {"overload": overload, "scheduling": scheduling}
        return Played(CONDITIONS[0], {}, master, fast | {"kernel_drops": 7}, {}, {})

    assert disturbances([played(slow, "SCHED_FIFO 10")]) == (
        f"{CONDITIONS[0].name}: 300 ticks (10.0%) were missed; slave: the system dropped 7 datagrams"
    )
    assert disturbances([played(fast, "SCHED_OTHER (refused)")]) == (
        "no real-time scheduling; slave: the system dropped 7 datagrams"
    )


SLOW = """
import time

class Slow:
    shared = False
    def step(self, sample):
        time.sleep(0.02)
        return 100.0 * sample.position_m[0]

    def sample(self, t_us):
        time.sleep(0.005)
        return 0.01
"""


def test_a_scene_that_is_too_slow_is_named_by_the_slave_and_told_by_the_master(start, serve, tmp_path):
    (tmp_path / "own.py").write_text(SLOW)
    server, address = serve("--scene", f"{tmp_path}/own.py:Slow", "--json")
    master = start("master", "--connect", address, "--duration", "60", "--json")
    named = (
        r"warning slave: scene \S+own.py:Slow is too slow: a step takes \S+ ms, at most \S+ ms, and is due every 1 ms"
    )
    server.wait_for(named)
    master.wait_for(r"warning master: the slave says: scene \S+own.py:Slow is too slow")
    assert master.end() == 0
    assert server.end() == 1, "a check found a problem"
    assert "datagrams wait" not in server.said(), "it is not the queue"
    assert server.said().count("warning slave: scene ") == 1
    (times,) = server.report()["step_times"].values()
    assert times["p50_us"] > 19_000
    assert times["too_slow"]
    assert server.report()["sessions"][0]["superseded"] > server.report()["sessions"][0]["steps"]
    assert "own.py:Slow is too slow" in master.report()["notices"][0]


def test_an_operator_that_is_too_slow_is_named_by_the_master(start, slave, tmp_path):
    (tmp_path / "own.py").write_text(SLOW)
    server, address = slave
    operator = f"{tmp_path}/own.py:Slow"
    master = start("master", "--connect", address, "--operator", operator, "--json")
    master.wait_for(r"warning master: operator \S+own.py:Slow is too slow: a step takes")
    assert master.end() == 1
    assert "this machine was too busy" not in master.said()
    assert master.report()["step_times"][f"operator {operator}"]["too_slow"]
    assert server.end() == 0
